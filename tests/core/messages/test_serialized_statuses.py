"""Statuses read from bytes that are written here by hand, after the layouts of ROS 1 and CDR."""

from __future__ import annotations

import random
import struct
from typing import Any, Sequence, Tuple

import pytest

from robot_health_monitor.core.messages.raw_messages import ros1_format, ros2_format
from robot_health_monitor.core.messages.serialized import SerializedType
from robot_health_monitor.core.messages.standard_messages import definition
from robot_health_monitor.core.values.elements import BadDatum, DriverStatus, Elements
from robot_health_monitor.core.values.field_path import ABSENT, mapping_getter

Status = Tuple[int, bytes, bytes, Sequence[Tuple[bytes, bytes]]]


def type_of(is_cdr: bool) -> SerializedType:
    text = definition("diagnostic_msgs/DiagnosticArray")
    if is_cdr:
        text = text.replace("uint32 seq\n", "")
    return SerializedType("/a", (ros2_format if is_cdr else ros1_format)("diagnostic_msgs/DiagnosticArray", text))


class Bytes:
    """Writes a message; `order` is struct's. CDR aligns numbers, and ends texts with a zero."""

    def __init__(self, form: str) -> None:
        self.is_cdr = form != "ros1"
        self.order = ">" if form == "cdr_be" else "<"
        self.data = bytes([0, self.order == "<", 0, 0]) if self.is_cdr else b""

    def number(self, value: int) -> None:
        self.data += bytes(-len(self.data) % 4 if self.is_cdr else 0) + struct.pack(f"{self.order}I", value)

    def text(self, value: bytes) -> None:
        value += b"\0" if self.is_cdr else b""
        self.number(len(value))
        self.data += value


def serialized(form: str, statuses: Sequence[Status], frame_id: bytes = b"map") -> bytes:
    out = Bytes(form)
    for number in (1, 2) if out.is_cdr else (7, 1, 2):
        out.number(number)
    out.text(frame_id)
    out.number(len(statuses))
    for level, name, said, values in statuses:
        out.data += bytes([level])
        out.text(name)
        out.text(said)
        out.text(b"hw")
        out.number(len(values))
        for key, value in values:
            out.text(key)
            out.text(value)
    return out.data


def read(form: str, data: bytes, field: str = 'status["*"]') -> Any:
    return type_of(form != "ros1").field_getter(field)(data)


FORMS = pytest.mark.parametrize("form", ["ros1", "cdr_le", "cdr_be"])
MOTORS: list[Status] = [
    (0, b"motor: left", b"running", [(b"temperature", b"40.5"), (b"e", b"")]),
    (2, b"motor: right", b"", []),
    (1, b"scanner", "verschmutzt, 30 %: prüfen".encode(), [(b"lens", b"dirty")]),
]


@FORMS
def test_each_status_has_its_name_level_and_message(form: str) -> None:
    found = read(form, serialized(form, MOTORS))
    assert type(found) is Elements
    assert found == [
        ("motor: left", DriverStatus(0, "running")),
        ("motor: right", DriverStatus(2, "")),
        ("scanner", DriverStatus(1, "verschmutzt, 30 %: prüfen")),
    ]


@FORMS
def test_texts_of_every_length_are_read(form: str) -> None:
    statuses = [(number % 4, b"n" * number, b"m" * (number // 2), [(b"k" * number, b"v")]) for number in range(20)]
    found = read(form, serialized(form, statuses, frame_id=b"f" * 5))
    assert found == [("n" * number, DriverStatus(number % 4, "m" * (number // 2))) for number in range(20)]


@FORMS
def test_a_pattern_selects_by_name(form: str) -> None:
    assert [name for name, _ in read(form, serialized(form, MOTORS), 'status["motor*"]')] == [
        "motor: left",
        "motor: right",
    ]
    assert read(form, serialized(form, MOTORS), 'status["arm*"]') is ABSENT
    assert read(form, serialized(form, [])) is ABSENT


@FORMS
def test_statuses_of_this_package_are_left_out(form: str) -> None:
    own: list[Status] = [
        (2, b"alert_system: battery_level", b"low", []),
        (2, b"renamed: battery_level", b"low", [(b"value", b"7"), (b"fingerprint", b"00aa"), (b"unit", b"%")]),
    ]
    assert [name for name, _ in read(form, serialized(form, [*own, *MOTORS]))] == [
        "motor: left",
        "motor: right",
        "scanner",
    ]


def test_a_level_has_a_sign_in_ros1_and_none_in_ros2() -> None:
    status: list[Status] = [(255, b"odd", b"", [])]
    assert read("ros1", serialized("ros1", status)) == [("odd", DriverStatus(-1, ""))]
    assert read("cdr_le", serialized("cdr_le", status)) == [("odd", DriverStatus(255, ""))]


@FORMS
def test_what_is_no_utf8_is_replaced(form: str) -> None:
    assert read(form, serialized(form, [(0, b"a\xff", b"\xc3", [])])) == [("a�", DriverStatus(0, "�"))]


@pytest.mark.newest_python
@FORMS
def test_too_many_statuses_are_a_bad_datum(form: str) -> None:
    found = read(form, serialized(form, [(0, b"", b"", [])] * 10_001))
    assert type(found) is BadDatum
    assert found == "10001 elements (limit 10000)"


@FORMS
def test_a_message_that_was_cut_off_anywhere_is_an_error(form: str) -> None:
    data = serialized(form, MOTORS)
    for length in range(len(data)):
        with pytest.raises(ValueError, match="too short"):
            read(form, data[:length])


@FORMS
def test_random_bytes_are_an_error_or_statuses(form: str) -> None:
    dice = random.Random(1)
    whole = serialized(form, MOTORS)
    for _ in range(2000):
        data = bytearray(whole)
        for _ in range(dice.randrange(1, 4)):
            data[dice.randrange(len(data))] = dice.randrange(256)
        try:
            found = read(form, bytes(data))
        except ValueError:
            continue
        assert found is ABSENT or type(found) in (Elements, BadDatum)


@FORMS
def test_they_are_those_of_the_whole_message(form: str) -> None:
    data = serialized(form, MOTORS)
    message = read(form, data, "")
    assert mapping_getter('status["*"]')(message) == read(form, data)
    assert read(form, data, 'status["*"].values["lens"]') == [("scanner", "dirty")]
    assert read(form, data, 'status["*"] where header.stamp.nanosec == 2') == read(form, data)
    assert read(form, data, 'status["*"] where header.stamp.nanosec == 3') is ABSENT


def test_a_status_of_another_definition_is_read_as_that_says() -> None:
    text = f"p/Status[] status\n{'=' * 80}\nMSG: p/Status\nstring name\nuint8 level\nstring message\n"
    array = text.replace("p/Status", "diagnostic_msgs/DiagnosticStatus")
    types = SerializedType("/a", ros1_format("diagnostic_msgs/DiagnosticArray", array))
    data = struct.pack("<II1sBI", 1, 1, b"a", 2, 0)
    assert types.field_getter('status["*"]')(data) == [("a", DriverStatus(2, ""))]
