"""Reads JSON from outside, which may be nested 64 levels deep."""

from __future__ import annotations

import json
import re
from typing import Any

_LEVELS = 64
_BESIDE_BRACKETS = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"?|[^][{}"]+', re.DOTALL)
"""A string, whose end may be missing, or anything else that is no bracket."""
_SQUARE = str.maketrans("{}", "[]")


def read_json(text: object) -> Any:
    """Returns the value in a JSON text or its UTF-8 bytes; raises ValueError if there is none, or if it is too deep."""
    text = text.decode("utf-8") if isinstance(text, bytes) else text
    if not isinstance(text, str):
        raise ValueError("not a text")
    try:
        return json.loads(shallow_json(text))
    except RecursionError as error:
        raise ValueError(str(error)) from None


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
