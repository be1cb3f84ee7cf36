"""Fields of serialized messages, from bytes written by hand; tests/recordings/test_decoding.py compares with rosbags.

Work is bounded, whatever the bytes say.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from robot_health_monitor.core.messages.definitions import SEQUENCE, Definition, Field
from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.core.messages.serialized import Deserializer, SerializedType, json_getter
from robot_health_monitor.core.proposal.candidates import Candidates, Topic
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.field_path import ABSENT, mapping_getter


def type_of(topic: str, type_name: str, encoding: str, text: str, form: str) -> SerializedType:
    """Returns the type of messages by its definition in .msg or .idl."""
    return SerializedType(topic, RawFormat(encoding, type_name, f"ros2{form}", text))


def test_big_endian_messages_are_read() -> None:
    get = type_of("/topic", "std_msgs/Float32", "cdr", "float32 data", "msg").field_getter("data")
    assert get(b"\0\0\0\0" + struct.pack(">f", 19.5)) == 19.5


@pytest.mark.parametrize("data", [b"", b"\0", b"\0\1\0\0", b"\0\1\0\0\1\2\3", b"\0\x07\0\0" + bytes(4)])
def test_a_message_that_does_not_match_its_type_is_a_value_error(data: bytes) -> None:
    with pytest.raises(ValueError, match="too short"):
        type_of("/topic", "std_msgs/Float32", "cdr", "float32 data", "msg").field_getter("data")(data)


def test_a_string_that_is_longer_than_its_message_is_a_value_error() -> None:
    get = type_of("/topic", "p/T", "ros1", "string name\nfloat32 data", "msg").field_getter("data")
    with pytest.raises(ValueError, match="too short"):
        get(struct.pack("<I", 2**32 - 1) + b"name")


def test_a_deserializer_that_fails_is_a_value_error() -> None:
    get = type_of("/topic", "p/T", "ros1", "float32[] data", "msg").field_getter("data[0]")
    with pytest.raises(ValueError, match="not a p/T"):
        get(struct.pack("<I", 100))


def test_a_type_of_the_robot_is_read_by_the_definition_in_the_recording() -> None:
    text = (
        "Cell[] cells\nCell first\nfloat64[2] pair\nuint8 state\n" + "=" * 80 + "\nMSG: my_robot/Cell\nfloat32 volts\n"
    )
    types = type_of("/topic", "my_robot/Pack", "ros1", text, "msg")
    data = struct.pack("<I2ffddB", 2, 3.5, 3.75, 4.0, 1.0, 2.0, 7)
    assert types.field_getter("cells[1].volts")(data) == 3.75
    assert types.field_getter("first.volts")(data) == 4.0
    assert types.field_getter("pair[1]")(data) == 2.0
    assert types.field_getter("state")(data) == 7
    assert types.field_getter("")(data) == {
        "cells": [{"volts": 3.5}, {"volts": 3.75}], "first": {"volts": 4.0}, "pair": [1.0, 2.0], "state": 7
    }  # fmt: skip


DYNAMIC_JOINT_STATE = (
    "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values\n"
    + "=" * 80
    + "\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    + "=" * 80
    + "\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
)


def ros1_strings(*texts: str) -> bytes:
    return struct.pack("<I", len(texts)) + b"".join(struct.pack("<I", len(text)) + text.encode() for text in texts)


def test_the_interfaces_of_a_dynamic_joint_state_are_read_by_joint_and_name() -> None:
    types = type_of("/topic", "control_msgs/DynamicJointState", "ros1", DYNAMIC_JOINT_STATE, "msg")
    data = struct.pack("<III", 7, 1_700_000_000, 500_000_000) + struct.pack("<I", 0)
    data += ros1_strings("wheel_left", "arm") + struct.pack("<I", 2)
    data += ros1_strings("position", "effort") + struct.pack("<I2d", 2, 0.5, 7.5)
    data += ros1_strings("effort") + struct.pack("<I1d", 1, 8.5)
    expected = {
        'interface_values["wheel_left"].values["effort"]': 7.5,
        'interface_values["arm"].values["position"]': ABSENT,
        'interface_values["*"].values["effort"]': [("wheel_left", 7.5), ("arm", 8.5)],
        'interface_values["wheel_left"].values["*"]': [("position", 0.5), ("effort", 7.5)],
        "header.stamp": 1_700_000_000.5,
    }
    assert {field: types.field_getter(field)(data) for field in expected} == expected


@pytest.mark.parametrize("encoding", ["ros1", "mapping"])
def test_a_frame_is_selected_by_its_child_frame_id(encoding: str) -> None:
    text = "Frame[] transforms\n" + "=" * 80 + "\nMSG: my_robot/Frame\nstring child_frame_id\nfloat64 x\n"
    frames = [("base_link", 1.5), ("camera", 2.5), ("camera_left", 3.5)]
    message: Any = {"transforms": [{"child_frame_id": name, "x": x} for name, x in frames]}
    if encoding == "ros1":
        parts = [struct.pack("<I", len(name)) + name.encode() + struct.pack("<d", x) for name, x in frames]
        message = struct.pack("<I", 3) + b"".join(parts)
    types = type_of("/tf", "my_robot/Tree", "ros1", text, "msg")
    getter = mapping_getter if encoding == "mapping" else types.field_getter
    assert getter('transforms["camera"].x')(message) == 2.5
    assert getter('transforms["map"].x')(message) is ABSENT
    assert getter('transforms["camera*"].x')(message) == [("camera", 2.5), ("camera_left", 3.5)]
    assert getter('transforms["*"].x')(message) == frames


def test_an_array_of_one_number_is_an_array() -> None:
    types = type_of("/topic", "p/T", "ros1", "float64[1] data\nint8 after", "msg")
    data = struct.pack("<db", 1.5, -3)
    assert types.field_getter("data[0]")(data) == 1.5
    assert types.field_getter("after")(data) == -3


def test_a_byte_of_ros1_is_signed_as_in_rospy() -> None:
    assert type_of("/topic", "std_msgs/Byte", "ros1", "byte data", "msg").field_getter("data")(b"\xff") == -1


def test_time_stamps_have_the_spellings_of_both_middlewares() -> None:
    types = type_of("/topic", "std_msgs/Header", "ros1", "uint32 seq\ntime stamp\nstring frame_id", "msg")
    data = struct.pack("<IIII", 1, 100, 5, 0)
    assert types.field_getter("stamp.secs")(data) == 100
    assert types.field_getter("stamp.nanosec")(data) == 5


def test_idl_definitions_are_parsed() -> None:
    text = (
        "=" * 80 + "\nIDL: my_robot/msg/Load\n"
        "module my_robot { module msg { struct Load { double watts; my_robot::msg::Cell cell; }; }; };\n"
        + "=" * 80 + "\nIDL: my_robot/msg/Cell\nmodule my_robot { module msg { struct Cell { float volts; }; }; };\n"
    )  # fmt: skip
    types = type_of("/topic", "my_robot/Load", "cdr", text, "idl")
    data = b"\0\1\0\0" + struct.pack("<df", 12.5, 3.5)
    assert types.field_getter("watts")(data) == 12.5
    assert types.field_getter("cell.volts")(data) == 3.5


def test_a_constant_is_that_of_the_message_that_has_the_field_or_of_the_whole() -> None:
    text = (
        "uint8 OK=1\nuint8 BAD=2\nPart part\nuint8[] codes\n" + "=" * 80
        + "\nMSG: p/Part\nuint8 OK=3\nuint8 MASK=16\nuint8 code\n"
    )  # fmt: skip
    types = type_of("/topic", "p/T", "ros1", text, "msg")
    data = struct.pack("<BIBB", 3, 2, 1, 16)

    def matches(where: str) -> bool:
        return types.field_getter(f" where {where}")(data) == 1.0

    assert matches("part.code == OK") and matches("codes[0] == OK") and matches("codes[1] == 16")
    assert not matches("part.code == BAD") and not matches("codes[2] != OK")
    assert matches("part.code < MASK") and not matches("part.code >= MASK")
    with pytest.raises(ConfigError, match=r"p/T has no constant MASK for codes\[0\]$"):
        types.field_getter(" where codes[0] == MASK")


def test_the_constants_of_an_idl_definition_are_known() -> None:
    text = (
        "=" * 80 + "\nIDL: my_robot/msg/Log\nmodule my_robot { module msg { module Log_Constants {\n"
        "const octet ERROR = 40; const long LOW = -3; const float HALF = 0.5; }; struct Log { octet level; }; }; };\n"
    )
    types = type_of("/topic", "my_robot/Log", "cdr", text, "idl")
    for where, holds in (("level >= ERROR", True), ("level < LOW", False), ("level < HALF", False)):
        assert (types.field_getter(f"level where {where}")(b"\0\1\0\0\x32") == 50) is holds


def test_a_field_that_does_not_exist_is_refused_with_those_that_do() -> None:
    with pytest.raises(ConfigError, match="data"):
        type_of("/topic", "std_msgs/Float32", "cdr", "float32 data", "msg").field_getter("value")


@pytest.mark.parametrize("ends_at", [0, 1000], ids=["contains itself", "is very deep"])
def test_the_numbers_of_a_nested_definition_are_limited(ends_at: int) -> None:
    """Each level contains the next one twice: 2 ** 1000 numbers."""
    parts = [f"L{level + 1} a\nL{level + 1} b\nfloat32 data" for level in range(ends_at)] + ["L0 a\nfloat32 data"]
    first, *others = (f"{text}\n" for text in parts)
    text = first + "".join(f"{'=' * 80}\nMSG: L{level}\n{part}" for level, part in enumerate(others, 1))
    types = type_of("/x", "odd/L0", "cdr", text.replace("L", "odd/L"), "msg")
    candidates = Candidates()
    candidates.add([Topic("/x", "odd/L0", types.definitions)])
    assert len(candidates.signals) <= 102
    with pytest.raises(ConfigError, match="contains itself, or more than 32 levels of types"):
        types.field_getter("data")


MIXED = (("flag", "bool"), ("small", "uint16"), ("real", "float64"), ("level", "uint8"))


def reader(fields: dict[str, tuple[Field, ...]], is_cdr: bool = False) -> Any:
    return Deserializer({name: Definition(each) for name, each in fields.items()}, is_cdr).bind("a/T")


def test_big_endian_arrays_are_read() -> None:
    get = reader({"a/T": (Field("x", "float64", SEQUENCE), Field("y", "int16", 2))}, is_cdr=True)
    message = get(b"\0\0\0\0" + struct.pack(">I4xdhh", 1, 2.5, -3, 4))
    assert (message["x"].tolist(), message["y"].tolist()) == ([2.5], [-3, 4])


@pytest.mark.parametrize(
    ("fields", "data"),
    [
        ((Field("x", "string", None),), struct.pack("<i", -5)),
        ((Field("x", "string", SEQUENCE),), struct.pack("<ii", 2**31 - 1, -4)),
        ((Field("x", "float64", SEQUENCE),), struct.pack("<i", -1)),
        ((Field("x", "a/E", SEQUENCE),), struct.pack("<I", 2**32 - 1) + bytes(1000)),
        ((Field("x", "a/E", 2**31),), bytes(1000)),
        ((Field("x", "uint8", 10**9),), bytes(1000)),
    ],
    ids=["string", "strings", "numbers", "messages", "fixed messages", "fixed numbers"],
)
@pytest.mark.parametrize("is_cdr", [False, True], ids=["ros1", "cdr"])
def test_a_length_beyond_the_message_is_refused_at_once(fields: Any, data: bytes, is_cdr: bool) -> None:
    """Lengths that are read as signed would go back, and read the same bytes again and again."""
    get = reader({"a/T": fields, "a/E": (Field("y", "uint8", None),)}, is_cdr)
    with pytest.raises(ValueError, match=r"too short|expected"):
        get(b"\0\1\0\0" * is_cdr + data)


@pytest.mark.newest_python
def test_more_elements_than_fit_into_memory_are_refused() -> None:
    get = reader({"a/T": (Field("x", "a/E", SEQUENCE),), "a/E": (Field("y", "uint8", None),)})
    assert len(get(struct.pack("<I", 400_000) + bytes(400_000))["x"]) == 400_000
    with pytest.raises(ValueError, match="expected at most 500000"):
        get(struct.pack("<I", 600_000) + bytes(600_000))


def nested(size: Any, leaf: tuple[Field, ...]) -> dict[str, tuple[Field, ...]]:
    """Returns types in eight levels."""
    types = {f"a/L{level}": (Field("x", f"a/L{level + 1}", size),) for level in range(8)}
    return {"a/T": (Field("x", "a/L0", size),), **types, "a/L8": leaf}


@pytest.mark.parametrize("leaf", [(), (Field("x", "uint8", 0),)], ids=["empty", "array of size 0"])
@pytest.mark.parametrize("size", [100, SEQUENCE])
def test_arrays_of_empty_elements_are_refused(leaf: Any, size: int) -> None:
    """100 to the power of 8 elements that take no bytes."""
    with pytest.raises(ValueError, match="array of empty values"):
        reader(nested(size, leaf))


def test_many_empty_fields_of_many_empty_fields_are_refused() -> None:
    fields = {name: tuple(Field(f"f{n}", inner, None) for n in range(100)) for name, inner in ("Ta", "ab", "bc")}
    types = {f"a/{name}": tuple(each._replace(kind=f"a/{each.kind}") for each in row) for name, row in fields.items()}
    with pytest.raises(ValueError, match="nearly all of them empty"):
        reader({**types, "a/c": ()})


def test_a_type_that_contains_itself_or_an_unknown_one_is_refused() -> None:
    with pytest.raises(ValueError, match="a/T contains itself"):
        reader({"a/T": (Field("x", "a/T", SEQUENCE),)})
    with pytest.raises(ValueError, match="the definition of a/E is missing"):
        reader({"a/T": (Field("x", "a/E", None),)})
    with pytest.raises(ValueError, match="the definition of wstring is missing"):
        reader({"a/T": (Field("x", "wstring", None),)})


def test_text_that_is_not_utf8_is_readable_still() -> None:
    get = reader({"a/T": (Field("x", "string", None), Field("y", "uint8", None))})
    message = get(struct.pack("<I2sB", 2, b"\xff!", 7))
    assert message == {"x": "\ufffd!", "y": 7}


def test_a_message_that_ends_early_is_refused() -> None:
    with pytest.raises(ValueError, match="too short"):
        reader({"a/T": (Field("x", "uint8", None),)})(b"")


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize(("field", "expected"), [("x", 1.5), ("y[1]", 3), ("z.data", 2.5), ("", None), ("y[*]", None)])
def test_a_message_is_read_up_to_the_field_that_is_needed(encoding: str, field: str, expected: Any) -> None:
    text = f"float32 x\nuint8[4] y\nFloat z\nstring[] late\n{'=' * 80}\nMSG: p/Float\nfloat32 data\n"
    get = type_of("/topic", "p/T", encoding, text, "msg").field_getter(field)
    data = (b"\0\1\0\0" if encoding == "cdr" else b"") + struct.pack("<f4Bf", 1.5, 2, 3, 4, 5, 2.5)
    if expected is None:
        with pytest.raises(ValueError, match="not a p/T: too short"):
            get(data)
    else:
        assert get(data) == expected


def test_fields_that_are_read_from_one_message_are_all_there() -> None:
    types = type_of("/topic", "p/T", "ros1", "float32 x\nfloat32 y\nfloat32 z", "msg")
    data, getters = struct.pack("<3f", 1.5, 2.5, 3.5), [types.field_getter("x")]
    assert [get(data) for get in getters] == [1.5]
    getters += map(types.field_getter, ("z", "y"))
    assert [get(data) for get in getters] == [1.5, 3.5, 2.5]


def test_a_type_that_is_not_needed_may_be_unknown() -> None:
    types = type_of("/topic", "p/T", "ros1", "float32 x\nOdd y", "msg")
    assert types.field_getter("x")(struct.pack("<f", 1.5)) == 1.5
    with pytest.raises(ConfigError, match="the definition of p/Odd is missing"):
        types.field_getter("y")


def test_a_message_without_fields_is_read() -> None:
    assert type_of("/topic", "std_msgs/Empty", "ros1", "", "msg").field_getter("")(b"") == {}


def test_a_negative_time_is_a_bad_datum() -> None:
    get = type_of("/topic", "p/T", "cdr", "time stamp", "msg").field_getter("stamp")
    assert get(b"\0\1\0\0" + struct.pack("<iI", -1, 0)) == "not a time stamp: -1"


def test_cdr_aligns_each_number_to_its_size() -> None:
    # flag at 0, small at 2, real at 8, level at 16
    body = b"\x01\xaa" + struct.pack("<H", 7) + b"\xaa" * 4 + struct.pack("<d", 2.5) + b"\x03"
    get = reader({"a/T": tuple(Field(*each) for each in MIXED)}, is_cdr=True)
    assert get(b"\0\1\0\0" + body) == {"flag": True, "small": 7, "real": 2.5, "level": 3}


def test_ros1_has_no_padding() -> None:
    data = b"\x01" + struct.pack("<H", 7) + struct.pack("<d", 2.5) + b"\x03"
    get = reader({"a/T": tuple(Field(*each) for each in MIXED)})
    assert get(data) == {"flag": True, "small": 7, "real": 2.5, "level": 3}


def read_json(data: bytes, field: str, type_name: str = "std_msgs/Float32") -> Any:
    return json_getter("/a", type_name, field)(data)


def test_fields_of_json_are_read_json() -> None:
    assert read_json(b'{"data": 1.5}', "data") == 1.5
    assert read_json(b'{"data": "low"}', "data", "std_msgs/String") == "low"
    assert read_json(b'{"data": {"x": [1, 2]}}', "data.x[1]", "own_msgs/Thing") == 2
    assert read_json(b'{"data": 1.5}', "") == {"data": 1.5}
    assert math.isnan(read_json(b'{"data": null}', "data"))


@pytest.mark.parametrize("data", [b"", b"1", b"[]", b"\xff", b"{", b"{}", b"[" * 100_000, b'{"data": {' * 50_000])
def test_bytes_that_are_no_such_json_raise_value_error(data: bytes) -> None:
    with pytest.raises(ValueError):
        read_json(data, "data")


def test_a_field_that_the_type_does_not_have_is_refused() -> None:
    with pytest.raises(ConfigError, match="has no field"):
        read_json(b"{}", "date")


def test_a_number_behind_an_array_of_any_length_is_read_from_the_whole_message() -> None:
    types = type_of("/topic", "p/T", "ros1", "float64[] early\nfloat64 late", "msg")
    assert types.field_getter("late")(struct.pack("<Idd", 1, 1.5, 2.5)) == 2.5


def test_bytes_behind_a_message_of_ros2_are_ignored() -> None:
    """`rclpy.serialization.serialize_message` returns more bytes than it writes, here 8."""
    get = reader({"a/T": (Field("x", "string", SEQUENCE), Field("y", "float64", SEQUENCE))}, is_cdr=True)
    data = b"\0\1\0\0" + struct.pack("<II2s2xId", 1, 2, b"a\0", 1, 1.5)
    assert get(data + b"\xcc" * 8)["y"].tolist() == get(data)["y"].tolist() == [1.5]
