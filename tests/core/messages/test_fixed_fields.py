"""Numbers at a fixed place, read from bytes that are written here by hand."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from robot_health_monitor.core.messages.definitions import SEQUENCE, TIMES, Definition, Definitions, Field
from robot_health_monitor.core.messages.fixed_fields import Getter, number_getter
from robot_health_monitor.core.values.elements import Stamp
from robot_health_monitor.core.values.errors import MessageError


def fields(*kinds: tuple[str, str]) -> Definition:
    return Definition([Field(name, kind) for name, kind in kinds])


TYPES: Definitions = {
    "Float32": fields(("data", "float32")),
    "Mixed": fields(("flag", "bool"), ("small", "uint16"), ("real", "float64"), ("level", "uint8")),
    "Nested": fields(("byte", "uint8"), ("inner", "Mixed"), ("last", "int32")),
    "Named": fields(("count", "int64"), ("name", "string"), ("after", "float32")),
    "Listed": Definition([Field("values", "float32", 3), Field("after", "float32")]),
    "Counted": Definition([Field("values", "float32", SEQUENCE), Field("after", "float32")]),
    "Wide": fields(("text", "wstring"), ("after", "float32")),
    **TIMES,
    "Stamped": fields(
        ("seq", "uint8"),
        ("stamp", "builtin_interfaces/Time"),
        ("frame_id", "string"),
        ("late", "builtin_interfaces/Time"),
        ("span", "builtin_interfaces/Duration"),
    ),
    "Empty": fields(),
    "Endless": fields(("again", "Endless")),
}


def cdr_getter(name: str, field: str) -> Getter | None:
    return number_getter(TYPES, name, field, is_cdr=True)


def ros1_getter(name: str, field: str) -> Getter | None:
    return number_getter(TYPES, name, field, is_cdr=False)


def test_a_float32_follows_the_header_of_cdr() -> None:
    get = cdr_getter("Float32", "data")
    assert get is not None
    assert get(b"\x00\x01\x00\x00" + struct.pack("<f", 19.5)) == 19.5
    assert get(b"\x00\x00\x00\x00" + struct.pack(">f", 19.5)) == 19.5
    assert math.isnan(get(b"\x00\x01\x00\x00" + struct.pack("<f", math.nan)))


def test_cdr_aligns_each_number_to_its_size() -> None:
    # flag at 0, small at 2, real at 8, level at 16
    body = b"\x01\xaa" + struct.pack("<H", 7) + b"\xaa" * 4 + struct.pack("<d", 2.5) + b"\x03"
    data = b"\x00\x01\x00\x00" + body
    found = {field: cdr_getter("Mixed", field) for field in ("flag", "small", "real", "level")}
    assert {field: get and get(data) for field, get in found.items()} == {
        "flag": True,
        "small": 7,
        "real": 2.5,
        "level": 3,
    }


def test_a_number_in_an_inner_message_has_its_path() -> None:
    # byte at 0, inner.flag at 1, inner.small at 2, inner.real at 8, inner.level at 16, last at 20
    body = b"\x09\x01" + struct.pack("<H", 7) + b"\xaa" * 4 + struct.pack("<d", 2.5) + b"\x03\xaa\xaa\xaa"
    data = b"\x00\x01\x00\x00" + body + struct.pack("<i", -4)
    inner, last = cdr_getter("Nested", "inner.real"), cdr_getter("Nested", "last")
    assert inner is not None and inner(data) == 2.5
    assert last is not None and last(data) == -4


@pytest.mark.parametrize(("get", "body"), [(cdr_getter, b"\0\1\0\0\7\0\0\0"), (ros1_getter, b"\7")])
def test_a_time_is_read_from_the_bytes_also_behind_a_string(get: Any, body: bytes) -> None:
    body += struct.pack("<iI", 1_700_000_000, 250_000_000) + struct.pack("<I", 4) + b"map\0"
    body += struct.pack("<iI", 5, 500_000_000)
    stamp, late = get("Stamped", "stamp"), get("Stamped", "late")
    assert (type(stamp(body)), stamp(body)) == (Stamp, 1_700_000_000.25)
    assert late(body) == 5.5
    assert get("Stamped", "stamp.sec") is None  # a part of a time needs the message


def test_a_negative_time_in_the_bytes_is_a_bad_datum() -> None:
    get = cdr_getter("Stamped", "stamp")
    assert get is not None
    assert get(b"\0\1\0\0\7\0\0\0" + struct.pack("<iI", -1, 0)) == "not a time stamp: -1 s"


@pytest.mark.parametrize("field", ["span", "stamp.none", "none.sec", "frame_id.sec"])
def test_a_duration_and_an_unknown_field_are_no_times(field: str) -> None:
    assert cdr_getter("Stamped", field) is None


def test_a_time_behind_an_array_cannot_be_read_from_the_bytes() -> None:
    behind = Definition([Field("values", "float32", SEQUENCE), Field("stamp", "builtin_interfaces/Time")])
    assert number_getter({**TYPES, "Behind": behind}, "Behind", "stamp", is_cdr=True) is None


def test_ros1_has_no_padding() -> None:
    data = b"\x01" + struct.pack("<H", 7) + struct.pack("<d", 2.5) + b"\x03"
    real, level = ros1_getter("Mixed", "real"), ros1_getter("Mixed", "level")
    assert real is not None and real(data) == 2.5
    assert level is not None and level(data) == 3


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("Named", "name"),
        ("Listed", "values"),
        ("Listed", "values[0]"),
        ("Counted", "after"),
        ("Wide", "after"),
        ("Empty", "none"),
        ("Float32", "none"),
    ],
)
def test_what_is_no_number_or_follows_an_array_of_any_length_has_no_getter(name: str, field: str) -> None:
    assert cdr_getter(name, field) is None
    assert ros1_getter(name, field) is None


def test_a_number_before_a_string_has_a_fixed_place() -> None:
    get = ros1_getter("Named", "count")
    assert get is not None and get(struct.pack("<q", -5) + b"\x00\x00\x00\x00") == -5


def test_a_number_may_follow_a_string_and_an_array_of_fixed_size() -> None:
    named, listed = ros1_getter("Named", "after"), ros1_getter("Listed", "after")
    assert named is not None and named(bytes(8) + b"\x03\0\0\0abc" + struct.pack("<f", 2.5)) == 2.5
    assert listed is not None and listed(bytes(12) + struct.pack("<f", 2.5)) == 2.5
    aligned = cdr_getter("Named", "after")
    # count at 0, length at 8, "ab" and its zero at 12, after at 16
    body = bytes(8) + b"\x03\0\0\0ab\0\xaa" + struct.pack("<f", 2.5)
    assert aligned is not None and aligned(b"\x00\x01\x00\x00" + body) == 2.5


def test_a_string_that_ends_behind_its_message_is_refused() -> None:
    get = ros1_getter("Named", "after")
    assert get is not None
    with pytest.raises(MessageError):
        get(bytes(8) + b"\xff\xff\xff\xff")


def test_types_that_contain_themselves_have_no_getter() -> None:
    assert cdr_getter("Endless", "again") is None


@pytest.mark.parametrize("data", [b"", b"\x00\x01", b"\x00\x01\x00\x00\x00", b"\x00\x07\x00\x00\x00\x00\x00\x00"])
def test_other_bytes_are_refused(data: bytes) -> None:
    get = cdr_getter("Float32", "data")
    assert get is not None
    with pytest.raises(MessageError):
        get(data)


def test_a_ros1_message_that_is_too_short_is_refused() -> None:
    get = ros1_getter("Float32", "data")
    assert get is not None
    with pytest.raises(MessageError):
        get(b"\x00")
