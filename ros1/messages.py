"""Mappings as rosbridge shapes them to native ROS 1 messages and back, and getters for single fields.

rospy checks a message only when it is serialized, which it is only when somebody listens; so every value is checked
and converted here, by the type of its field.
"""

from __future__ import annotations

import base64
import functools
import math
import operator
import re
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import genpy
import roslib.message

from ..core.field_path import ABSENT, Keyed, Step, key_field, number_of_text, parse_field_path
from ..core.middleware import Message, split_type_name
from ..core.parameters import ConfigError, describe

Getter = Callable[[Any], Any]

_FLOAT32_MAX = 3.4028234663852886e38

_INTEGER_RANGES: Mapping[str, Tuple[int, int]] = {
    **{f"int{bits}": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": (0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    "byte": (-128, 127),
    "char": (0, 255),
}

_BYTES = ("uint8", "char")
"""Arrays of these are base64 text in a mapping. (A `byte` is an int8 in ROS 1.)"""

_TIMES = {"time": genpy.Time, "duration": genpy.Duration}

_ROS2_NAMES = {"sec": "secs", "nanosec": "nsecs"}

_ARRAY = re.compile(r"(?P<element>.+)\[(?P<size>\d*)\]\Z")


def message_class(type_name: str) -> Any:
    """Returns the message class of `pkg/Type` or `pkg/msg/Type`.

    Raises:
        ConfigError: there is none.
    """
    return _find_class(type_name, "msg", roslib.message.get_message_class)


def service_class(type_name: str) -> Any:
    """Returns the service class of `pkg/Type` or `pkg/srv/Type`.

    Raises:
        ConfigError: there is none.
    """
    return _find_class(type_name, "srv", roslib.message.get_service_class)


def to_mapping(message: Any) -> Dict[str, Any]:
    """Returns a native message as a mapping: levels are ints, byte arrays base64 text, NaN as it is."""
    native_class: Any = type(message)
    return {name: read(getattr(message, name)) for name, read in _readers(native_class)}


def to_native(native_class: Any, mapping: Message) -> Any:
    """Returns a native message; fields that `mapping` leaves out keep their defaults.

    Raises:
        ValueError: a field that the type does not have, or a value that does not fit its field.
    """
    message = native_class()
    writers = _writers(native_class)
    for name, value in _require_mapping(mapping).items():
        native_name = name if name in writers else _ROS2_NAMES.get(name, name)
        if native_name not in writers:
            raise ValueError(f"{native_class.__name__} has no field {name}; there are {', '.join(writers)}")
        try:
            setattr(message, native_name, writers[native_name](value))
        except ValueError as error:
            raise ValueError(f"{native_class.__name__}.{name}: {error}") from None
    return message


def field_getter(topic: str, type_name: str, field: str) -> Getter:
    """Returns a function that reads `field`, a path as in `core/field_path.py`, from a native message.

    It gives None where an array is shorter than the index, ABSENT where no element has the key. An empty field: the
    whole message as a mapping.

    Args:
        topic: the resolved topic, for the error.
        type_name: type of its messages.
        field: path of the field.

    Raises:
        ConfigError: the type is not known, or has no such field.
    """
    native_class = message_class(type_name)
    try:
        path = parse_field_path(field)
    except ValueError as error:
        raise ConfigError(f"{topic}: found the field {field!r} of {type_name}, {error}") from None
    if not path:
        return to_mapping
    try:
        steps = _bind(native_class, path)
    except ValueError as error:
        raise ConfigError(f"{topic}: {type_name} has no field {field}; {error}") from None
    if len(steps) == 1:
        return steps[0]

    def get(message: Any) -> Any:
        try:
            for step in steps:
                message = step(message)
                if message is ABSENT:
                    break
        except IndexError:
            return None
        return message

    return get


def is_stamped(native_class: Any) -> bool:
    """Says whether messages of this class have a header, and so a stamp."""
    return _field_types(native_class).get("header") == _FieldType("std_msgs/Header", False, None)


class _FieldType(NamedTuple):
    element: str
    """The type, of one element where it is an array."""
    is_array: bool
    size: Optional[int]
    """Number of elements of an array that always has the same."""

    @property
    def message(self) -> Optional[Any]:
        """The class of the message that this is, or of each element; None for a plain value."""
        if self.element in _TIMES:
            return _TIMES[self.element]
        return roslib.message.get_message_class(self.element) if "/" in self.element else None


def _find_class(type_name: str, kind: str, get_class: Callable[[str], Any]) -> Any:
    split = split_type_name(type_name)
    if split is None:
        raise ConfigError(f"found the type {type_name!r}, allowed is package/Type, for instance std_msgs/Float32")
    package, name = split
    found = get_class(f"{package}/{name}")
    if found is None:
        raise ConfigError(f"found the type {type_name}, but there is no package {package} with a {kind} {name} here")
    return found


def _field_type(text: str) -> _FieldType:
    array = _ARRAY.match(text)
    if array:
        return _FieldType(array["element"], True, int(array["size"]) if array["size"] else None)
    return _FieldType(text, False, None)


@functools.lru_cache(maxsize=None)
def _field_types(native_class: Any) -> Mapping[str, _FieldType]:
    if native_class in _TIMES.values():
        kind = "uint32" if native_class is genpy.Time else "int32"
        return {name: _FieldType(kind, False, None) for name in _ROS2_NAMES.values()}
    return {name: _field_type(text) for name, text in zip(native_class.__slots__, native_class._slot_types)}


def _bind(native_class: Any, path: Sequence[Step]) -> List[Getter]:
    """Returns what to call in turn to read `path`; raises ValueError with the reason when there is no such field."""
    steps: List[Getter] = []
    above = native_class._type
    found = _FieldType(native_class._type, False, None)
    for step in path:
        if isinstance(step, str):
            types = {} if found.is_array or not found.message else _field_types(found.message)
            name = step if step in types else _ROS2_NAMES.get(step, step)
            if name not in types:
                there = f"has {', '.join(types)}" if types else "is a plain value or a list, without fields"
                raise ValueError(f"{above} {there}")
            steps.append(operator.attrgetter(name))
            found = types[name]
        elif not found.is_array:
            raise ValueError(f"{above} is no array but a {found.element}")
        else:
            if isinstance(step, int):
                if found.size is not None and step >= found.size:
                    raise ValueError(f"{above} has {found.size} elements, the last is [{found.size - 1}]")
                steps.append(operator.itemgetter(step))
            else:
                steps.append(_element_getter(above, found, step.key))
            found = _FieldType(found.element, False, None)
        above = step if isinstance(step, str) else f"an element of {above}"
    if isinstance(path[-1], Keyed) and "key" in _field_types(found.message):
        return [*steps, operator.attrgetter("value"), number_of_text]
    read = _reader(found)
    return steps if read is _as_it_is else [*steps, read]


def _element_getter(above: str, array: _FieldType, key: str) -> Getter:
    field = key_field(_field_types(array.message)) if array.message else None
    if field is None:
        raise ValueError(f"the elements of {above} have neither name nor key")
    name_of = operator.attrgetter(field)

    def get(elements: Any) -> Any:
        return next((element for element in elements if name_of(element) == key), ABSENT)

    return get


def _as_it_is(value: Any) -> Any:
    return value


@functools.lru_cache(maxsize=None)
def _readers(native_class: Any) -> Tuple[Tuple[str, Getter], ...]:
    return tuple((name, _reader(field_type)) for name, field_type in _field_types(native_class).items())


def _reader(field_type: _FieldType) -> Getter:
    """Returns how to make of a native value what belongs into a mapping."""
    if field_type.is_array and field_type.element in _BYTES:
        return _bytes_as_text
    read_one = to_mapping if field_type.message else _as_it_is
    if field_type.is_array:
        return lambda values: [read_one(value) for value in values]
    return read_one


def _bytes_as_text(values: Any) -> str:
    return base64.b64encode(bytes(values)).decode("ascii")


@functools.lru_cache(maxsize=None)
def _writers(native_class: Any) -> Mapping[str, Callable[[Any], Any]]:
    return {name: _writer(field_type) for name, field_type in _field_types(native_class).items()}


def _writer(field_type: _FieldType) -> Callable[[Any], Any]:
    write_one = _element_writer(field_type)
    if not field_type.is_array:
        return write_one

    def write(found: Any) -> Any:
        values = _bytes_from(found) if field_type.element in _BYTES else found
        if isinstance(values, (str, Mapping)) or not hasattr(values, "__iter__"):
            raise ValueError(f"found {describe(found)}, needed is a list")
        elements = [write_one(value) for value in values]
        if field_type.size is not None and len(elements) != field_type.size:
            raise ValueError(f"found {len(elements)} elements, needed are {field_type.size}")
        return bytes(elements) if field_type.element in _BYTES else elements

    return write


def _element_writer(field_type: _FieldType) -> Callable[[Any], Any]:
    element = field_type.element
    native_class = field_type.message
    if native_class:
        return lambda mapping: to_native(native_class, mapping)
    if element in _INTEGER_RANGES:
        return lambda found: _integer(found, element)
    if element == "bool":
        return lambda found: _instance(found, bool, "true or false")
    if element == "float32":
        return _float32
    if element == "float64":
        return _float
    return _text


def _integer(found: Any, element: str) -> int:
    low, high = _INTEGER_RANGES[element]
    if isinstance(found, bool) or not hasattr(found, "__index__") or not low <= operator.index(found) <= high:
        raise ValueError(f"found {describe(found)}, needed is a whole number from {low} to {high}")
    return operator.index(found)


def _float(found: Any) -> float:
    if isinstance(found, (bool, str)) or not hasattr(found, "__float__"):
        raise ValueError(f"found {describe(found)}, needed is a number")
    try:
        return float(found)
    except OverflowError:
        return math.inf if found > 0 else -math.inf


def _float32(found: Any) -> float:
    """Returns a number that 32 bits can hold; one that is too large becomes an infinity."""
    number = _float(found)
    return number if not abs(number) > _FLOAT32_MAX else math.copysign(math.inf, number)


def _text(found: Any) -> str:
    if not isinstance(found, str):
        raise ValueError(f"found {describe(found)}, needed is a text")
    return found


def _instance(found: Any, kind: type, needed: str) -> Any:
    if not isinstance(found, kind):
        raise ValueError(f"found {describe(found)}, needed is {needed}")
    return found


def _bytes_from(found: Any) -> Any:
    if not isinstance(found, str):
        return found
    try:
        return base64.b64decode(found, validate=True)
    except ValueError as error:
        raise ValueError(f"found a text that is no base64: {error}") from None


def _require_mapping(found: Any) -> Message:
    # A dict is known at once; typing's Mapping takes its time, and a report has a mapping per key-value.
    if not isinstance(found, dict) and not isinstance(found, Mapping):
        raise ValueError(f"found {describe(found)}, needed is a mapping of fields to values")
    return found
