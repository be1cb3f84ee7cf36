"""How the messages of a middleware are described, for the code that converts and reads them."""

from __future__ import annotations

from typing import Any, Callable, NamedTuple, Sequence

from .definitions import Field


class Dialect(NamedTuple):
    """How the messages of one middleware differ from those of others."""

    find_class: Callable[[str, str, str], Any]
    """Returns the class of a package, a kind (`msg` or `srv`) and a name; None if there is none."""
    fields: Callable[[Any], Sequence[Field]]
    """Returns the fields of a message class. Their kinds are those of `NUMBERS`, octet, which is an int in a mapping
    and `bytes` of length one in a message, and messages; anything else is text."""
    class_of: Callable[[str], Any]
    """Returns the class of the messages of a kind; None for a plain value."""
    byte_array: Callable[[Sequence[int]], Any]
    """Converts uint8 numbers, as a list or bytes, to the value of a field."""
    plain: Callable[[Any], Any] = lambda array: array
    """Converts an array of a message to a list of Python's numbers."""
    new: Callable[[Any], Any] = lambda native_class: native_class()
    """Returns a message of a class with default values."""
    assign: Callable[[Any, str, Any], None] = setattr
    """Sets a field of a message."""
