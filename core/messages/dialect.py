"""How the messages of a middleware are described, for the code that converts and reads them."""

from __future__ import annotations

from typing import Any, Callable, Mapping, NamedTuple, Optional, Sequence

Message = Mapping[str, Any]
"""A message, request or response in rosbridge's form."""


class FieldType(NamedTuple):
    """The type of one field of a message."""

    element: str
    """The middleware's name of the type, or of the type of an array's elements: `double`, `std_msgs/Header`."""
    kind: str
    """The type independent of the middleware: bool, int8 to int64, uint8 to uint64, float32, float64, or octet, which
    is an int in a mapping and `bytes` of length one in a message. Anything else is text, unless it is a message."""
    message: Optional[Any] = None
    """The message class of the field or of its elements; None for a plain value."""
    is_array: bool = False
    size: Optional[int] = None
    """Number of elements of an array of fixed size."""
    most: Optional[int] = None
    """Largest number of elements of a bounded array."""


class Dialect(NamedTuple):
    """How the messages of one middleware differ from those of others."""

    find_class: Callable[[str, str, str], Any]
    """Returns the class of a package, a kind (`msg` or `srv`) and a name; None if there is none."""
    type_name: Callable[[Any], str]
    """Returns the type of a message class, `std_msgs/Float32`."""
    field_types: Callable[[Any], Mapping[str, FieldType]]
    """Returns the type of every field of a message class, by name."""
    other_names: Mapping[str, str]
    """Names of fields in other middlewares to their names here."""
    byte_array: Callable[[Sequence[int]], Any]
    """Converts uint8 numbers, as a list or bytes, to the value of a field."""
    plain: Callable[[Any], Any]
    """Converts an array of a message, or one of its elements, to plain Python."""
    new: Callable[[Any], Any] = lambda native_class: native_class()
    """Returns a message of a class with default values."""
    assign: Callable[[Any, str, Any], None] = setattr
    """Sets a field of a message."""
    constant: Callable[[Any, str], Any] = lambda native_class, name: getattr(native_class, name, None)
    """Returns a constant of a message class by its name; what is no number, or `bytes` of length one, is none."""
