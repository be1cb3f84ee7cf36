"""Conversion of messages, with plain Python classes as a middleware's own: what both ROS adapters have in common."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any, Callable, ClassVar, Sequence

import pytest

from robot_health_monitor.core import ConfigError
from robot_health_monitor.core.messages.definitions import SEQUENCE, Field
from robot_health_monitor.core.messages.dialect import Dialect
from robot_health_monitor.core.messages.native_messages import NativeMessages

Fields = Sequence[Field]


class Time:
    FIELDS: ClassVar[Fields] = [Field("secs", "uint32"), Field("nsecs", "uint32")]

    def __init__(self) -> None:
        self.secs = 0
        self.nsecs = 0


class Header:
    FIELDS: ClassVar[Fields] = [
        Field("stamp", "demo/Time"),
        Field("frame_id", "string"),
    ]

    def __init__(self) -> None:
        self.stamp = Time()
        self.frame_id = "map"


class KeyValue:
    FIELDS: ClassVar[Fields] = [Field("key", "string"), Field("value", "string")]

    def __init__(self) -> None:
        self.key = ""
        self.value = ""


class Status:
    FIELDS: ClassVar[Fields] = [
        Field("level", "octet"),
        Field("name", "string"),
        Field("values", "demo/KeyValue", SEQUENCE),
    ]

    def __init__(self) -> None:
        self.level = b"\0"
        self.name = ""
        self.values: list[KeyValue] = []


class Report:
    FIELDS: ClassVar[Fields] = [
        Field("header", "std_msgs/Header"),
        Field("status", "demo/Status", SEQUENCE),
    ]

    def __init__(self) -> None:
        self.header = Header()
        self.status: list[Status] = []


class Arrays:
    FIELDS: ClassVar[Fields] = [
        Field("header", "demo/Header"),
        Field("numbers", "float64", SEQUENCE),
        Field("three", "float64", 3),
        Field("few", "int32", SEQUENCE, 2),
        Field("bytes", "uint8", SEQUENCE),
        Field("octets", "octet", SEQUENCE),
        Field("small", "int8", SEQUENCE),
    ]

    def __init__(self) -> None:
        self.header = Header()
        self.numbers: Any = []
        self.three: Any = [0.0, 0.0, 0.0]
        self.few: Any = []
        self.bytes: Any = bytearray()
        self.octets: Any = []
        self.small: Any = []


class Stamped:
    FIELDS: ClassVar[Fields] = [Field("header", "std_msgs/Header", SEQUENCE)]


class Reset:
    """A service."""


CLASSES = {
    **{("demo", "msg", one.__name__): one for one in (Time, Header, KeyValue, Status, Report, Arrays)},
    ("demo", "srv", "Reset"): Reset,
}


def fields(native_class: Any) -> Fields:
    found: Fields = native_class.FIELDS
    return found


KINDS = {"std_msgs/Header": Header, **{f"demo/{name}": one for (_, _, name), one in CLASSES.items()}}


def native_messages(
    describe: Callable[[Any], Fields] = fields, plain: Callable[[Any], Any] = lambda array: array
) -> NativeMessages:
    return NativeMessages(
        Dialect(
            find_class=lambda package, kind, name: CLASSES.get((package, kind, name)),
            fields=describe,
            class_of=KINDS.get,
            byte_array=bytearray,
            plain=plain,
        )
    )


messages = native_messages()


def one_field(kind: str) -> Any:
    """Returns a message class with one field, `data`, of this kind."""

    class One:
        FIELDS: ClassVar[Fields] = [Field("data", kind)]

        def __init__(self) -> None:
            self.data: Any = None

    return One


def test_a_class_is_found_by_either_spelling_of_its_type() -> None:
    assert messages.message_class("demo/Status") is Status
    assert messages.message_class("demo/msg/Status") is Status
    assert messages.service_class("demo/Reset") is Reset
    assert messages.service_class("demo/srv/Reset") is Reset


@pytest.mark.parametrize(
    ("find", "type_name", "reason"),
    [
        (messages.message_class, "demo/Reset", "there is no package demo with a msg Reset here"),
        (messages.service_class, "demo/Status", "there is no package demo with a srv Status here"),
    ],
)
def test_a_type_that_is_not_here_is_an_error(find: Callable[[str], Any], type_name: str, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        find(type_name)
    assert str(caught.value) == f"unknown type {type_name}: {reason}"


@pytest.mark.parametrize("type_name", ["Status", "", "a/b/c", "demo/Status[]"])
def test_an_invalid_type_name_is_an_error(type_name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        messages.message_class(type_name)
    assert str(caught.value) == (f"expected a type such as std_msgs/Float32, got {type_name!r}")


def test_a_message_within_messages_is_written_and_reads_the_same() -> None:
    mapping = {
        "header": {"stamp": {"secs": 7, "nsecs": 8}, "frame_id": "base"},
        "status": [{"level": 2, "name": "motor", "values": [{"key": "T", "value": "81"}]}],
    }
    native = messages.to_native(Report, mapping)
    assert (native.header.stamp.secs, native.header.stamp.nsecs, native.header.frame_id) == (7, 8, "base")
    (status,) = native.status
    assert (type(status), status.level, status.name) == (Status, b"\2", "motor")
    assert [(type(one), one.key, one.value) for one in status.values] == [(KeyValue, "T", "81")]
    assert messages.to_mapping(native) == mapping


def test_fields_that_are_left_out_keep_their_defaults() -> None:
    native = messages.to_native(Header, {"stamp": {"nsecs": 5}})
    assert (native.frame_id, native.stamp.secs, native.stamp.nsecs) == ("map", 0, 5)


def test_a_field_may_have_the_name_that_it_has_elsewhere() -> None:
    native = messages.to_native(Time, {"sec": 7, "nanosec": 8})
    assert (native.secs, native.nsecs) == (7, 8)


INTEGERS = [
    ("int8", -128, 127),
    ("uint8", 0, 255),
    ("int16", -32768, 32767),
    ("uint16", 0, 65535),
    ("int32", -2147483648, 2147483647),
    ("uint32", 0, 4294967295),
    ("int64", -9223372036854775808, 9223372036854775807),
    ("uint64", 0, 18446744073709551615),
]


@pytest.mark.parametrize(("kind", "low", "high"), INTEGERS)
def test_whole_numbers_reach_from_the_lowest_to_the_highest_of_their_kind(kind: str, low: int, high: int) -> None:
    one = one_field(kind)
    assert messages.to_native(one, {"data": low}).data == low
    assert messages.to_native(one, {"data": high}).data == high
    for beyond in (low - 1, high + 1):
        with pytest.raises(ValueError) as caught:
            messages.to_native(one, {"data": beyond})
        assert str(caught.value) == f"One.data: expected a whole number from {low} to {high}, got {beyond}"


def test_an_octet_is_one_byte_in_a_message_and_an_int_in_a_mapping() -> None:
    one = one_field("octet")
    native = messages.to_native(one, {"data": 255})
    assert native.data == b"\xff"
    assert messages.to_mapping(native) == {"data": 255}
    assert messages.to_native(one, {"data": 0}).data == b"\0"


def test_a_number_like_one_of_numpy_becomes_one_of_python() -> None:
    class Seven:
        def __index__(self) -> int:
            return 7

        def __float__(self) -> float:
            return 7.0

    for kind, number_type in (("int8", int), ("float32", float), ("float64", float)):
        number = messages.to_native(one_field(kind), {"data": Seven()}).data
        assert (number, type(number)) == (7, number_type)


@pytest.mark.parametrize(
    ("kind", "value", "needed"),
    [
        ("int8", 1.0, "expected a whole number from -128 to 127, got 1.0"),
        ("int8", True, "expected a whole number from -128 to 127, got true"),
        ("int8", "1", "expected a whole number from -128 to 127, got '1'"),
        ("octet", 256, "expected a whole number from 0 to 255, got 256"),
        ("octet", b"\1", "expected a whole number from 0 to 255, got b'\\x01'"),
        ("bool", 1, "expected true or false, got 1"),
        ("float32", True, "expected a number, got true"),
        ("float64", "1.5", "expected a number, got '1.5'"),
        ("float64", [], "expected a number, got []"),
        ("string", 1, "expected text, got 1"),
        ("string", None, "expected text, got nothing"),
    ],
)
def test_a_value_that_does_not_fit_its_kind_is_refused(kind: str, value: Any, needed: str) -> None:
    with pytest.raises(ValueError) as caught:
        messages.to_native(one_field(kind), {"data": value})
    assert str(caught.value) == f"One.data: {needed}"


@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_nothing_is_nan_in_a_float_field(kind: str) -> None:
    """rosbridge writes NaN as null."""
    assert math.isnan(messages.to_native(one_field(kind), {"data": None}).data)


def test_a_text_like_one_of_numpy_is_no_number() -> None:
    class Text(str):
        def __float__(self) -> float:
            return 1.5

    with pytest.raises(ValueError, match=r"^One.data: expected a number, got '1.5'$"):
        messages.to_native(one_field("float64"), {"data": Text("1.5")})


@pytest.mark.parametrize("value", [True, False])
def test_a_bool_stays_one(value: bool) -> None:
    assert messages.to_native(one_field("bool"), {"data": value}).data is value


@pytest.mark.parametrize(
    ("kind", "number", "written"),
    [
        ("float32", 3.4028234663852886e38, 3.4028234663852886e38),
        ("float32", 3.4028235677973362e38, 3.4028234663852886e38),  # IEEE 754: the nearest one
        ("float32", 3.4028235677973366e38, math.inf),  # halfway to 2**128
        ("float32", -1e39, -math.inf),
        ("float32", 10**400, math.inf),
        ("float64", 1e39, 1e39),
        ("float64", 10**400, math.inf),
        ("float64", -(10**400), -math.inf),
    ],
)
def test_a_number_too_large_for_its_kind_becomes_infinity(kind: str, number: Any, written: float) -> None:
    assert messages.to_native(one_field(kind), {"data": number}).data == written


@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_nan_is_written_and_read_as_it_is(kind: str) -> None:
    native = messages.to_native(one_field(kind), {"data": math.nan})
    assert math.isnan(native.data)
    assert math.isnan(messages.to_mapping(native)["data"])


def test_arrays_of_bytes_are_base64_text_in_a_mapping() -> None:
    native = messages.to_native(Arrays, {"bytes": "AP8=", "octets": "AP8=", "small": [-128, 127]})
    assert native.bytes == bytearray(b"\x00\xff")
    assert type(native.bytes) is bytearray
    assert native.octets == [b"\x00", b"\xff"]
    assert native.small == [-128, 127]
    read = messages.to_mapping(native)
    assert (read["bytes"], read["octets"], read["small"]) == ("AP8=", "AP8=", [-128, 127])


def test_bytes_may_also_be_given_as_they_are_or_as_a_list() -> None:
    for given in (b"\x00\xff", [0, 255]):
        native = messages.to_native(Arrays, {"bytes": given, "octets": given})
        assert native.bytes == bytearray(b"\x00\xff")
        assert native.octets == [b"\x00", b"\xff"]


@pytest.mark.parametrize(
    ("mapping", "reason"),
    [
        ({"numbers": 1.0}, "Arrays.numbers: expected a list, got 1.0"),
        ({"numbers": "1.0"}, "Arrays.numbers: expected a list, got '1.0'"),
        ({"numbers": {"a": 1.0}}, "Arrays.numbers: expected a list, got a mapping"),
        ({"numbers": [1.0, "a"]}, "Arrays.numbers: expected a number, got 'a'"),
        ({"three": [1.0]}, "Arrays.three: expected 3 elements, got 1"),
        ({"three": [1.0] * 4}, "Arrays.three: expected 3 elements, got 4"),
        ({"few": [1, 2, 3]}, "Arrays.few: expected at most 2 elements, got 3"),
        ({"bytes": [256]}, "Arrays.bytes: expected a whole number from 0 to 255, got 256"),
        ({"header": 1}, "Arrays.header: expected a mapping of fields to values, got 1"),
        (
            {"header": {"stamp": {"secs": -1}}},
            "Arrays.header: Header.stamp: Time.secs: expected a whole number",
        ),
        ({"header": {"seq": 1}}, "Arrays.header: Header has no field seq; available: stamp, frame_id"),
        ({"bytes": "no base64!"}, "Arrays.bytes: expected base64 text: "),
    ],
)
def test_wrong_values_are_refused_with_the_field(mapping: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError) as caught:
        messages.to_native(Arrays, mapping)
    assert str(caught.value).startswith(reason)


def test_arrays_with_as_many_elements_as_are_allowed_are_written() -> None:
    native = messages.to_native(Arrays, {"three": (1.0, 2.0, 3), "few": [1, 2], "numbers": []})
    assert (native.three, native.few, native.numbers) == ([1.0, 2.0, 3.0], [1, 2], [])


def test_arrays_are_made_plain_as_the_dialect_has_it() -> None:
    class Foreign:
        """An array as another library has it."""

        def __len__(self) -> int:
            return 2

        def __getitem__(self, index: int) -> Decimal:
            return [Decimal(5), Decimal(6)][index]

    def plain(array: Any) -> Any:
        return [float(array[index]) for index in range(len(array))]

    own = native_messages(plain=plain)
    native = Arrays()
    native.numbers = native.three = Foreign()
    assert own.to_mapping(native)["numbers"] == [5.0, 6.0]


def test_only_a_header_of_std_msgs_makes_a_message_stamped() -> None:
    assert messages.is_stamped(Report)
    assert not messages.is_stamped(Arrays)
    assert not messages.is_stamped(Stamped)
    assert not messages.is_stamped(Time)


def test_a_class_is_looked_at_once_however_many_messages_follow() -> None:
    looked_at: list[Any] = []

    def describe(native_class: Any) -> Fields:
        looked_at.append(native_class)
        return fields(native_class)

    own = native_messages(describe)
    own.to_mapping(own.to_native(Report, {"status": [{"name": "left"}]}))
    assert Status in looked_at
    looked_at.clear()
    own.to_mapping(own.to_native(Report, {"status": [{"name": "left"}, {"name": "right"}]}))
    assert looked_at == []
