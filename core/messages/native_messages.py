"""Converts the port's mappings to a middleware's native messages and back, and reads single fields of native messages.

ROS 1 and ROS 2 both have a class per message type and an attribute per field; a `Dialect` describes their differences.
Neither checks a value when it is assigned: rospy checks on serialization, which happens only with a subscriber, and
rclpy passes wrong values to C. So every value is checked and converted here, by the type of its field.
"""

from __future__ import annotations

import base64
import functools
import importlib
import math
import operator
import os
import re
import sys
from array import array
from typing import Any, Dict, Mapping, Optional, Sequence, Tuple

from ..values.errors import ConfigError, MessageError
from ..values.field_path import Getter, parse_field_path
from ..values.formatting import describe
from ..values.names import split_type_name
from ..values.where import filtered, parse_selection
from .dialect import Dialect, FieldType, Message
from .native_fields import as_it_is, bind_path, check_path

_INTEGER_RANGES: Mapping[str, Tuple[int, int]] = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "octet": (0, 255),
}

_BYTES = ("uint8", "octet")
"""Kinds whose arrays are base64 text in a mapping."""


def find_generated(line: str, package: str, kind: str, name: str) -> Any:
    """Returns a class that genpy or rosidl generated; None if there is none. For `Dialect.find_class`.

    Clients choose type names, and importing runs code: a module must not be imported to find out that it has no
    messages. So the text of `<package>/msg/__init__.py` is searched for the line that the generator writes there: a
    regular expression with {package}, {kind} (`msg` or `srv`) and {name}.
    """
    pattern = re.compile(f"^{line.format(package=package, kind=kind, name=name)}", re.MULTILINE)
    for folder in sys.path:
        try:
            with open(os.path.join(folder, package, kind, "__init__.py"), encoding="utf-8") as stream:
                if pattern.search(stream.read()):
                    return getattr(importlib.import_module(f"{package}.{kind}"), name, None)
        except (OSError, ValueError):
            continue
        except ImportError:
            return None
    return None


class NativeMessages:
    """Converts and reads the messages of one middleware. Caches the converters of each class."""

    def __init__(self, dialect: Dialect) -> None:
        """Loads no class before it is used."""
        self._dialect = dialect
        types, cached = dialect.field_types, functools.lru_cache(maxsize=None)
        self._readers = cached(lambda cls: tuple((name, self._reader(of)) for name, of in types(cls).items()))
        self._writers = cached(lambda cls: {name: self._writer(of) for name, of in types(cls).items()})

    def message_class(self, type_name: str) -> Any:
        """Returns the message class of `pkg/Type` or `pkg/msg/Type`; raises ConfigError if there is none here."""
        return self._find_class(type_name, "msg")

    def service_class(self, type_name: str) -> Any:
        """Returns the service class of `pkg/Type` or `pkg/srv/Type`; raises as `message_class` does."""
        return self._find_class(type_name, "srv")

    def is_stamped(self, native_class: Any) -> bool:
        """Returns whether messages of this class have a header, and so a stamp."""
        header = self._dialect.field_types(native_class).get("header")
        return header is not None and header.element == "std_msgs/Header" and not header.is_array

    def to_mapping(self, message: Any) -> Dict[str, Any]:
        """Returns a native message as a mapping: octets as ints, byte arrays as base64 text, NaN unchanged."""
        native_class: Any = type(message)
        return {name: read(getattr(message, name)) for name, read in self._readers(native_class)}

    def to_native(self, native_class: Any, mapping: Message) -> Any:
        """Returns a native message; fields that `mapping` leaves out keep their defaults.

        Raises MessageError for a field that the type does not have, or a value that does not match its field.
        """
        message = self._dialect.new(native_class)
        writers = self._writers(native_class)
        for name, value in _require_mapping(mapping).items():
            native_name = name if name in writers else self._dialect.other_names.get(name, name)
            if native_name not in writers:
                raise MessageError(f"{_short_name(native_class)} has no field {name}; available: {', '.join(writers)}")
            try:
                self._dialect.assign(message, native_name, writers[native_name](value))
            except ValueError as error:
                raise MessageError(f"{_short_name(native_class)}.{name}: {error}") from None
        return message

    def field_getter(self, topic: str, type_name: str, field: str) -> Getter:
        """Returns a function that reads `field`, a path as in `field_path.py`, from a native message of a type.

        The function returns what `mapping_getter` of `field_path.py` does, or ABSENT if the condition behind the path
        does not hold (`where.py`). For an empty field it returns the whole message as a mapping. Raises ConfigError,
        with the resolved topic, if the type is not installed, or has no such field or constant.
        """
        native_class = self.message_class(type_name)
        try:
            path, comparisons = parse_selection(field)
            parse_field_path(path)
        except ValueError as error:
            raise ConfigError(f"{topic}: field {describe(field)} of {type_name}: {error}") from None

        def bind(one: str) -> Getter:
            try:
                return bind_path(self._dialect, self._reader, native_class, parse_field_path(one))
            except ValueError as error:
                raise ConfigError(f"{topic}: {type_name} has no field {one[:100]}; {error}") from None

        def constant(one: str, name: str) -> Getter:
            for owner in (check_path(self._dialect, native_class, parse_field_path(one)).owner, native_class):
                value = self._dialect.constant(owner, name)
                number = value[0] if isinstance(value, bytes) and len(value) == 1 else value
                if isinstance(number, (int, float)):
                    return lambda message: number
            raise ConfigError(f"{topic}: {type_name} has no constant {name} for {one[:100]}")

        if not comparisons:
            return bind(path) if path else self.to_mapping
        return filtered(comparisons, bind(path) if path else (lambda message: 1.0), bind, constant)

    def _find_class(self, type_name: str, kind: str) -> Any:
        split = split_type_name(type_name)
        if split is None:
            raise ConfigError(f"expected a type such as std_msgs/Float32, got {type_name!r}")
        package, name = split
        found = self._dialect.find_class(package, kind, name)
        if found is None:
            raise ConfigError(f"unknown type {type_name}: there is no package {package} with a {kind} {name} here")
        return found

    def _reader(self, field_type: FieldType) -> Getter:
        """Returns the native-to-mapping converter of a field."""
        is_octet = field_type.kind == "octet"
        if field_type.is_array and field_type.kind in _BYTES:
            return (lambda values: bytes_as_text(b"".join(values))) if is_octet else bytes_as_text
        read_one: Getter = operator.itemgetter(0) if is_octet else self.to_mapping if field_type.message else as_it_is
        if not field_type.is_array:
            return read_one
        plain = self._dialect.plain
        return lambda values: [read_one(value) for value in plain(values)]

    def _writer(self, field_type: FieldType) -> Getter:
        """Returns the mapping-to-native converter of a field."""
        native_class = field_type.message
        write_one = _PLAIN_WRITERS.get(field_type.kind, _text_writer)
        if native_class:
            write_one = functools.partial(self.to_native, native_class)
        if not field_type.is_array:
            return write_one
        byte_array = self._dialect.byte_array

        def write(found: Any) -> Any:
            values = _bytes_from(found) if field_type.kind in _BYTES else found
            if isinstance(values, (str, Mapping)) or not hasattr(values, "__iter__"):
                raise MessageError(f"expected a list, got {describe(found)}")
            elements = _plain_elements(field_type.kind, values)
            if elements is None:
                elements = [write_one(value) for value in values]
            if field_type.size is not None and len(elements) != field_type.size:
                raise MessageError(f"expected {field_type.size} elements, got {len(elements)}")
            if field_type.most is not None and len(elements) > field_type.most:
                raise MessageError(f"expected at most {field_type.most} elements, got {len(elements)}")
            return byte_array(elements) if field_type.kind == "uint8" else elements

        return write


def bytes_as_text(values: Any) -> str:
    """Returns an array of bytes, or of numbers from 0 to 255, as base64 text."""
    return base64.b64encode(bytes(values)).decode("ascii")


def _plain_elements(kind: str, values: Any) -> Optional[Sequence[Any]]:
    """Returns the elements of an array without a call for each, as a picture has a million; None if that is needed."""
    if kind == "uint8" and isinstance(values, bytes):
        return values
    if not isinstance(values, (list, tuple)):
        return None
    types = set(map(type, values))
    if kind in _INTEGER_RANGES and kind != "octet" and types == {int}:
        low, high = _INTEGER_RANGES[kind]
        return list(values) if low <= min(values) and max(values) <= high else None
    if kind == "float64" and types == {float}:
        return list(values)
    if kind == "float32" and types == {float}:
        return array("f", values).tolist()
    return None


def _integer(kind: str, found: Any) -> int:
    low, high = _INTEGER_RANGES[kind]
    if isinstance(found, bool) or not hasattr(found, "__index__") or not low <= operator.index(found) <= high:
        raise MessageError(f"expected a whole number from {low} to {high}, got {describe(found)}")
    return operator.index(found)


def _float(found: Any) -> float:
    if found is None:
        return math.nan  # as in rosbridge's form
    if isinstance(found, (bool, str)) or not hasattr(found, "__float__"):
        raise MessageError(f"expected a number, got {describe(found)}")
    try:
        return float(found)
    except OverflowError:
        return math.inf if found > 0 else -math.inf


def _float32(found: Any) -> float:
    """Returns a number rounded to 32 bits; one that is too large becomes an infinity."""
    return array("f", [_float(found)])[0]


def _short_name(native_class: Any) -> str:
    """Returns the type of a class without its package; a class may be the text of its type."""
    return str(getattr(native_class, "__name__", native_class)).rpartition("/")[2]


def _checked(kind: type, words: str, found: Any) -> Any:
    if not isinstance(found, kind):
        raise MessageError(f"expected {words}, got {describe(found)}")
    return found


_PLAIN_WRITERS: Mapping[str, Getter] = {
    **{kind: functools.partial(_integer, kind) for kind in _INTEGER_RANGES},
    "octet": lambda found: bytes([_integer("octet", found)]),
    "bool": functools.partial(_checked, bool, "true or false"),
    "float32": _float32,
    "float64": _float,
}
_text_writer = functools.partial(_checked, str, "text")


def _bytes_from(found: Any) -> Any:
    if not isinstance(found, str):
        return found
    try:
        return base64.b64decode(found, validate=True)
    except ValueError as error:
        raise MessageError(f"expected base64 text: {error}") from None


def _require_mapping(found: Any) -> Message:
    # `dict` first: isinstance with typing's Mapping is slow, and a report has a mapping per key-value.
    if not isinstance(found, dict) and not isinstance(found, Mapping):
        raise MessageError(f"expected a mapping of fields to values, got {describe(found)}")
    return found
