"""Converts the port's mappings to a middleware's native messages and back.

ROS 1 and ROS 2 both have a class per message type and an attribute per field; a `Dialect` describes their differences.
Neither checks a value when it is assigned: rospy checks on serialization, which happens only with a subscriber, and
rclpy passes wrong values to C. So every value is checked and converted here, by the type of its field.
"""

from __future__ import annotations

import base64
import contextlib
import functools
import importlib
import math
import operator
import os
import re
import sys
from array import array
from typing import Any, Mapping, Sequence

from ..values import ConfigError, Getter, Message, MessageError, describe, split_type_name
from .definitions import NUMBERS, OTHER_NAMES, SEQUENCE, Field
from .dialect import Dialect

_INTEGER_RANGES: Mapping[str, tuple[int, int]] = {
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
    """Converts the messages of one middleware. Caches the converters of each class."""

    def __init__(self, dialect: Dialect) -> None:
        """Loads no class before it is used."""
        self._dialect = dialect
        fields, cached = dialect.fields, functools.lru_cache(maxsize=None)
        self._readers = cached(lambda cls: [(field.name, self._reader(field)) for field in fields(cls)])
        self._writers = cached(lambda cls: {field.name: self._writer(field) for field in fields(cls)})

    def message_class(self, type_name: str) -> Any:
        """Returns the message class of `pkg/Type` or `pkg/msg/Type`; raises ConfigError if there is none here."""
        return self._find_class(type_name, "msg")

    def service_class(self, type_name: str) -> Any:
        """Returns the service class of `pkg/Type` or `pkg/srv/Type`; raises as `message_class` does."""
        return self._find_class(type_name, "srv")

    def is_stamped(self, native_class: Any) -> bool:
        """Returns whether messages of this class have a header, and so a stamp."""
        return ("header", "std_msgs/Header", None) in [field[:3] for field in self._dialect.fields(native_class)]

    def to_mapping(self, message: Any) -> dict[str, Any]:
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
            native_name = name if name in writers else OTHER_NAMES.get(name, name)
            if native_name not in writers:
                raise MessageError(f"{_short_name(native_class)} has no field {name}; available: {', '.join(writers)}")
            try:
                self._dialect.assign(message, native_name, writers[native_name](value))
            except ValueError as error:
                raise MessageError(f"{_short_name(native_class)}.{name}: {error}") from None
        return message

    def _find_class(self, type_name: str, kind: str) -> Any:
        split = split_type_name(type_name)
        if split is None:
            raise ConfigError(f"expected a type such as std_msgs/Float32, got {type_name!r}")
        package, name = split
        found = self._dialect.find_class(package, kind, name)
        if found is None:
            raise ConfigError(f"unknown type {type_name}: there is no package {package} with a {kind} {name} here")
        return found

    def _reader(self, field: Field) -> Getter:
        """Returns the native-to-mapping converter of a field."""
        is_octet = field.kind == "octet"
        if field.size is not None and field.kind in _BYTES:
            return (lambda values: bytes_as_text(b"".join(values))) if is_octet else bytes_as_text
        is_message = self._dialect.class_of(field.kind) is not None
        read_one: Getter = operator.itemgetter(0) if is_octet else self.to_mapping if is_message else _as_it_is
        if field.size is None:
            return read_one
        plain = self._dialect.plain
        return lambda values: [read_one(value) for value in plain(values)]

    def _writer(self, field: Field) -> Getter:
        """Returns the mapping-to-native converter of a field."""
        native_class = self._dialect.class_of(field.kind)
        write_one = _PLAIN_WRITERS.get(field.kind, _text_writer)
        if native_class is not None:
            write_one = functools.partial(self.to_native, native_class)
        if field.size is None:
            return write_one
        size, most = field.size, field.most
        byte_array = self._dialect.byte_array

        def write(given: Any) -> Any:
            values = _bytes_from(given) if field.kind in _BYTES else given
            if isinstance(values, (str, Mapping)) or not hasattr(values, "__iter__"):
                raise MessageError(f"expected a list, got {describe(given)}")
            elements: Sequence[Any]
            if field.kind == "uint8" and isinstance(values, bytes):
                elements = values
            else:
                elements = _numbers(field.kind, values) or [write_one(value) for value in values]
            if size not in (SEQUENCE, len(elements)):
                raise MessageError(f"expected {size} elements, got {len(elements)}")
            if most is not None and len(elements) > most:
                raise MessageError(f"expected at most {most} elements, got {len(elements)}")
            return byte_array(elements) if field.kind == "uint8" else elements

        return write


def _as_it_is(value: Any) -> Any:
    return value


def bytes_as_text(values: Any) -> str:
    """Returns an array of bytes, or of numbers from 0 to 255, as base64 text."""
    return base64.b64encode(bytes(values)).decode("ascii")


def _numbers(kind: str, values: Any) -> Sequence[Any]:
    """Returns the numbers of an array without a call for each, as a cloud has a million; none if that is needed."""
    if isinstance(values, (list, tuple)) and set(map(type, values)) in ({int}, {float}):
        with contextlib.suppress(KeyError, OverflowError, TypeError, ValueError):
            return array(NUMBERS[kind], values).tolist()
    return ()


def _integer(kind: str, value: Any) -> int:
    low, high = _INTEGER_RANGES[kind]
    if isinstance(value, bool) or not hasattr(value, "__index__") or not low <= operator.index(value) <= high:
        raise MessageError(f"expected a whole number from {low} to {high}, got {describe(value)}")
    return operator.index(value)


def _float(value: Any) -> float:
    if value is None:
        return math.nan  # as in rosbridge's form
    if isinstance(value, (bool, str)) or not hasattr(value, "__float__"):
        raise MessageError(f"expected a number, got {describe(value)}")
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _float32(value: Any) -> float:
    """Returns a number rounded to 32 bits; one that is too large becomes an infinity."""
    return array("f", [_float(value)])[0]


def _short_name(native_class: Any) -> str:
    """Returns the type of a class without its package; a class may be the text of its type."""
    return str(getattr(native_class, "__name__", native_class)).rpartition("/")[2]


def _checked(kind: type, words: str, value: Any) -> Any:
    if not isinstance(value, kind):
        raise MessageError(f"expected {words}, got {describe(value)}")
    return value


_PLAIN_WRITERS: Mapping[str, Getter] = {
    **{kind: functools.partial(_integer, kind) for kind in _INTEGER_RANGES},
    "octet": lambda value: bytes([_integer("octet", value)]),
    "bool": functools.partial(_checked, bool, "true or false"),
    "float32": _float32,
    "float64": _float,
}
_text_writer = functools.partial(_checked, str, "text")


def _bytes_from(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    try:
        return base64.b64decode(value, validate=True)
    except ValueError as error:
        raise MessageError(f"expected base64 text: {error}") from None


def _require_mapping(value: Any) -> Message:
    # `dict` first: isinstance with typing's Mapping is slow, and a report has a mapping per key-value.
    if not isinstance(value, dict) and not isinstance(value, Mapping):
        raise MessageError(f"expected a mapping of fields to values, got {describe(value)}")
    return value
