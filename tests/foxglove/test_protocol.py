"""What a server says. The texts and bytes are those of the protocol's specification, written by hand."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.foxglove.protocol import (
    Channel,
    ProtocolError,
    ServerMessage,
    read_message,
    read_text,
    subscribe,
    unsubscribe,
)

FLOAT = {
    "id": 3,
    "topic": "/battery",
    "encoding": "cdr",
    "schemaName": "std_msgs/msg/Float32",
    "schema": "float32 data",
}


def channel(**changes: object) -> Channel:
    (found,) = read_text(json.dumps({"op": "advertise", "channels": [{**FLOAT, **changes}]})).channels
    return found


def test_channels_are_offered_and_withdrawn() -> None:
    offered = read_text(json.dumps({"op": "advertise", "channels": [FLOAT]}))
    assert offered == ServerMessage(
        "advertise",
        [Channel(3, "/battery", RawFormat("cdr", "std_msgs/msg/Float32", "ros2msg", "float32 data"))],
    )
    assert read_text('{"op": "unadvertise", "channelIds": [3, 4]}') == ServerMessage("unadvertise", channel_ids=[3, 4])


def test_a_status_has_a_level_and_a_text() -> None:
    assert read_text('{"op": "status", "level": 2, "message": "no"}') == ServerMessage("status", level=2, message="no")
    assert read_text('{"op": "status"}') == ServerMessage("status")


def test_other_operations_are_not_used() -> None:
    assert read_text('{"op": "serverInfo", "name": "a", "capabilities": []}') == ServerMessage("serverInfo")


def test_a_message_is_opcode_1_subscription_time_and_payload() -> None:
    head = bytes([1, 0x04, 0x03, 0x02, 0x01]) + bytes(8)  # little endian
    assert read_message(head + b"payload") == (0x01020304, b"payload")
    assert read_message(head) == (0x01020304, b"")
    century = bytes([1, 0, 0, 0, 0]) + b"\xff" * 8  # a log time in the year 2554 is not looked at
    assert read_message(century + b"x") == (0, b"x")


@pytest.mark.parametrize("opcode", [0, 2, 3, 4, 255])
def test_other_opcodes_are_not_used(opcode: int) -> None:
    assert read_message(bytes([opcode]) + bytes(20)) is None


def test_a_message_shorter_than_its_head_is_refused() -> None:
    with pytest.raises(ProtocolError, match="expected a message of at least 13 bytes, got 12"):
        read_message(bytes([1]) + bytes(11))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "[]",
        "3",
        "{}",
        '{"op": 3}',
        '{"op": "advertise"}',
        '{"op": "unadvertise", "channelIds": 3}',
        "[" * 99_999,
    ],
)
def test_what_is_not_valid_is_refused(text: str) -> None:
    with pytest.raises(ProtocolError):
        read_text(text)


@pytest.mark.parametrize(
    "change",
    [{"id": -1}, {"id": True}, {"id": "3"}, {"topic": ""}, {"topic": 3}, {"topic": "/" + "a" * 1000}, {"schema": [1]}],
)
def test_a_channel_that_is_not_valid_is_left_out(change: dict) -> None:
    found = read_text(json.dumps({"op": "advertise", "channels": [{**FLOAT, **change}, 7, FLOAT]}))
    assert [each.id for each in found.channels] == [3]


@pytest.mark.parametrize(
    ("encoding", "schema_encoding", "problem"),
    [
        ("cdr", "ros2msg", ""),
        ("cdr", "ros2idl", ""),
        ("cdr", None, ""),  # servers of the first version name none
        ("ros1", "ros1msg", ""),
        ("ros1", None, ""),
        ("json", "jsonschema", ""),
        ("json", None, ""),
        ("protobuf", "protobuf", "its messages have the encoding protobuf, which is not supported"),
        ("cdr", "omgidl", "its schema has the encoding omgidl, which is not supported"),
        ("", "", "its messages have the encoding of no name, which is not supported"),
    ],
)
def test_encodings_that_can_be_read(encoding: str, schema_encoding: str, problem: str) -> None:
    assert channel(encoding=encoding, schemaEncoding=schema_encoding).problem == problem


def test_subscriptions_have_the_form_of_the_specification() -> None:
    assert json.loads(subscribe(0, 3)) == {"op": "subscribe", "subscriptions": [{"id": 0, "channelId": 3}]}
    assert json.loads(unsubscribe(7)) == {"op": "unsubscribe", "subscriptionIds": [7]}


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda below: st.lists(below, max_size=4) | st.dictionaries(st.text(max_size=8), below, max_size=4),
    max_leaves=12,
)


@given(st.sampled_from(["advertise", "unadvertise", "status", "x"]), VALUES, VALUES)
def test_any_json_is_read_or_refused(op: str, first: object, second: object) -> None:
    fields = {
        "op": op,
        "channels": [first, {**FLOAT, "id": second}],
        "channelIds": first,
        "level": first,
        "message": second,
    }
    try:
        read_text(json.dumps(fields))
    except ProtocolError:
        pass


@given(st.binary(min_size=1, max_size=40))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    try:
        read_message(data)
    except ProtocolError:
        assert data[0] == 1 and len(data) < 13
