"""Names that were renamed: the former one works until the next major version, with a warning.

docs/reference/stability.md has the policy. Keys of configurations have `Parameter.former`, options of commands
`Parser.add_former_name`; a module of the library has

    __getattr__ = former_names(__name__, {"OldName": "NewName"})
"""

from __future__ import annotations

import contextlib
import sys
import warnings
from typing import Any, Callable, Iterator, Mapping, Optional

from .errors import Path
from .formatting import printable


class RenamedWarning(FutureWarning):
    """A former name is in use. `str()` is one line: the name with the path of the key, and its present name."""

    def __init__(self, former: str, present: str, path: Path = ()) -> None:
        """`path` is that of the mapping with the key `former`; empty: what was renamed is no key."""
        self.path = (*path, former)
        """Keys from the root of the configuration down to the former name."""
        self.problem = f"renamed to {present}; the next major version refuses the former name"
        super().__init__(f"{'.'.join(self.path)}: {self.problem}")


def warn_renamed(former: str, present: str, path: Path = ()) -> None:
    """Issues a `RenamedWarning` at the line that called the caller of this function."""
    warnings.warn(RenamedWarning(former, present, path), stacklevel=3)


def former_names(module: str, present: Mapping[str, str]) -> Callable[[str], Any]:
    """Returns the `__getattr__` of a module whose names were changed: their present names, by their former ones."""

    def find(name: str) -> Any:
        if name not in present:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warn_renamed(f"{module}.{name}", present[name])
        return getattr(sys.modules[module], present[name])

    return find


@contextlib.contextmanager
def shown_in_one_line(program: str) -> Iterator[None]:
    """Shows each `RenamedWarning` as one line, `PROGRAM: WARN: ...`, without a place in the code."""
    usual = warnings.formatwarning

    def show(message: Any, category: Any, filename: str, lineno: int, line: Optional[str] = None) -> str:
        if isinstance(message, RenamedWarning):
            return f"{program}: WARN: {printable(str(message))}\n"
        return usual(message, category, filename, lineno, line)

    warnings.formatwarning = show
    try:
        yield
    finally:
        warnings.formatwarning = usual
