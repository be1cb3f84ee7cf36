"""How deep a JSON text from outside may be nested."""

from __future__ import annotations

import re

_LEVELS = 64
_BESIDE_BRACKETS = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"?|[^][{}"]+', re.DOTALL)
"""A string, whose end may be missing, or anything else that is no bracket."""
_SQUARE = str.maketrans("{}", "[]")


def shallow_json(text: str, levels: int = _LEVELS) -> str:
    """Returns a JSON text, which need not be valid, to be parsed; takes time proportional to its length.

    Raises RecursionError if its lists and objects are nested more than `levels` deep. Python 3.8 may end the process
    instead of raising it, "Cannot recover from stack overflow", where garbage is collected at the deepest point.
    """
    if text.count("[") + text.count("{") > levels:
        brackets = _BESIDE_BRACKETS.sub("", text).translate(_SQUARE)
        for _ in range(levels):
            brackets = brackets.replace("[]", "")
        # What is left was around more levels, or its ends are missing.
        if "[]" in brackets or brackets.count("[") > levels:
            raise RecursionError(f"nested more than {levels} levels deep")
    return text
