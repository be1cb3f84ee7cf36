from __future__ import annotations

import json
import math
from typing import Any, Dict, List

import cbor2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.rosbridge.protocol import connection as protocol
from robot_health_monitor.rosbridge.protocol.connection import Connection, operation_fields
from robot_health_monitor.rosbridge.protocol.errors import ProtocolError
from robot_health_monitor.rosbridge.protocol.limits import Limits

# One example of every operation, field for field as ROSBRIDGE_PROTOCOL.md has it.
EXAMPLES: List[Dict[str, Any]] = [
    {"op": "advertise", "id": "a1", "topic": "/in", "type": "std_msgs/Float32"},
    {"op": "advertise", "topic": "/in", "type": "std_msgs/Float32", "latch": True, "queue_size": 10},
    {"op": "unadvertise", "id": "a1", "topic": "/in"},
    {"op": "publish", "id": "p1", "topic": "/in", "msg": {"data": 19.5}},
    {"op": "subscribe", "topic": "/out"},
    {
        "op": "subscribe",
        "id": "s1",
        "topic": "/out",
        "type": "std_msgs/Float32",
        "throttle_rate": 100.0,
        "queue_length": 5,
        "fragment_size": 1000,
        "compression": "png",
    },
    {"op": "unsubscribe", "id": "s1", "topic": "/out"},
    {"op": "call_service", "service": "/reset", "args": {}},
    {"op": "call_service", "id": 7, "service": "/reset", "args": [1, "two"], "fragment_size": 5, "compression": "png"},
    {"op": "service_response", "service": "/reset", "values": {"success": True}, "result": True, "id": "c1"},
    {"op": "service_response", "service": "/reset", "values": "it failed", "result": False, "id": "c1"},
    {"op": "advertise_service", "service": "/reset", "type": "std_srvs/Trigger"},
    {"op": "unadvertise_service", "service": "/reset"},
    {"op": "advertise_action", "action": "/dock", "type": "docking/Dock"},
    {"op": "unadvertise_action", "action": "/dock"},
    {"op": "send_action_goal", "action": "/dock", "action_type": "docking/Dock", "args": {}, "feedback": True},
    {"op": "cancel_action_goal", "action": "/dock", "id": "g1"},
    {"op": "action_feedback", "action": "/dock", "values": {"done": 0.5}, "id": "g1"},
    {"op": "action_result", "action": "/dock", "values": {}, "status": 4, "result": True, "id": "g1"},
    {"op": "set_level", "level": "warning"},
    {"op": "status", "level": "error", "msg": "bad JSON", "id": "p1"},
    {"op": "auth", "mac": "a", "client": "b", "dest": "c", "rand": "d", "t": 1.0, "level": "user", "end": 2.0},
]


def receive(data: protocol.Wire, limits: Limits = Limits()) -> Any:  # noqa: B008 - frozen
    return Connection(limits).receive(data, 0.0)


@pytest.mark.parametrize("fields", EXAMPLES, ids=lambda fields: fields["op"])
class TestEveryOperation:
    def test_is_read_and_written_as_the_protocol_has_it(self, fields: Dict[str, Any]) -> None:
        operation = receive(json.dumps(fields))
        assert type(operation) is protocol.OPERATIONS[fields["op"]]
        assert operation_fields(operation) == fields

    @pytest.mark.parametrize("compression", ["none", "png", "cbor"])
    def test_survives_every_encoding(self, fields: Dict[str, Any], compression: str) -> None:
        operation = receive(json.dumps(fields))
        (wire,) = Connection().send(operation, compression=compression)
        assert receive(wire) == operation

    @pytest.mark.parametrize("compression", ["none", "png"])
    def test_survives_being_cut_into_fragments(self, fields: Dict[str, Any], compression: str) -> None:
        operation = receive(json.dumps(fields))
        wires = Connection().send(operation, compression=compression, fragment_size=7)
        assert len(wires) > 1
        receiver = Connection()
        received = [receiver.receive(wire, 0.0) for wire in wires]
        assert received[:-1] == [None] * (len(wires) - 1)
        assert received[-1] == operation

    def test_says_which_required_field_is_missing(self, fields: Dict[str, Any]) -> None:
        operation = protocol.OPERATIONS[fields["op"]]
        for name in operation._fields:
            if name not in operation._field_defaults:
                rest = {key: value for key, value in fields.items() if key != name}
                with pytest.raises(ProtocolError) as refusal:
                    receive(json.dumps(rest))
                assert str(refusal.value) == f"{fields['op']}: the field {name} is missing"
                assert refusal.value.id == fields.get("id")


def test_every_operation_of_the_facts_has_an_example() -> None:
    facts = {"advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service", "advertise_service"}
    facts |= {"unadvertise_service", "service_response", "send_action_goal", "cancel_action_goal", "advertise_action"}
    facts |= {"action_feedback", "action_result", "set_level", "auth"}
    assert facts <= {fields["op"] for fields in EXAMPLES} == set(protocol.OPERATIONS)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "the message is not JSON"),
        ("{{", "the message is not JSON"),
        ("[]", "the message is a list, allowed is a mapping"),
        ("null", "the message is None, allowed is a mapping"),
        ("{}", "unknown operation None"),
        ('{"op": 5}', "unknown operation 5"),
        ('{"op": "shutdown"}', "unknown operation 'shutdown'"),
        ('{"op": "subscribe", "topic": 5}', "topic: found 5, allowed is a name of 1 to 512 characters"),
        ('{"op": "subscribe", "topic": ""}', "topic: found ''"),
        ('{"op": "subscribe", "topic": "/a\\u0000"}', "topic: found '/a\\x00'"),
        ('{"op": "subscribe", "topic": "/a", "id": []}', "id: found a list"),
        ('{"op": "subscribe", "topic": "/a", "throttle_rate": -1}', "throttle_rate: found -1"),
        ('{"op": "subscribe", "topic": "/a", "throttle_rate": NaN}', "throttle_rate: found nan"),
        ('{"op": "subscribe", "topic": "/a", "throttle_rate": true}', "throttle_rate: found True"),
        ('{"op": "subscribe", "topic": "/a", "fragment_size": 0}', "fragment_size: found 0"),
        ('{"op": "subscribe", "topic": "/a", "compression": "zip"}', "allowed is one of none, png, cbor, cbor-raw"),
        ('{"op": "publish", "topic": "/a", "msg": "text"}', "msg: found 'text', allowed is a mapping"),
        (
            '{"op": "call_service", "service": "/a", "args": "text"}',
            "args: found 'text', allowed is a mapping or",
        ),
        ('{"op": "set_level", "level": "loud"}', "level: found 'loud', allowed is one of none, error, warning, info"),
        ('{"op": "png", "data": "####"}', "the picture is not base64"),
        ('{"op": "png"}', "png: data: found None"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(text: str, problem: str) -> None:
    with pytest.raises(ProtocolError) as refusal:
        receive(text)
    assert problem in str(refusal.value)
    assert "\n" not in str(refusal.value)


class TestLimits:
    def test_a_message_of_exactly_the_limit_passes_and_one_byte_more_does_not(self) -> None:
        text = json.dumps({"op": "publish", "topic": "/a", "msg": {"data": "x" * 100}})
        assert receive(text, Limits(message_bytes=len(text))).topic == "/a"
        with pytest.raises(ProtocolError, match="longer than"):
            receive(text, Limits(message_bytes=len(text) - 1))

    def test_nesting_up_to_the_limit_passes_and_one_more_does_not(self) -> None:
        def nested(depth: int) -> str:
            return '{"op":"publish","topic":"/a","msg":{"a":' + "[" * (depth - 2) + "]" * (depth - 2) + "}}"

        assert receive(nested(64)).topic == "/a"
        with pytest.raises(ProtocolError, match="nested"):
            receive(nested(65))
        with pytest.raises(ProtocolError, match="nested"):
            receive(nested(100_000))

    def test_many_brackets_beside_each_other_are_not_nesting(self) -> None:
        text = json.dumps({"op": "publish", "topic": "/a", "msg": {"data": [[]] * 1000}})
        assert receive(text).msg == {"data": [[]] * 1000}

    def test_a_number_that_would_take_seconds_to_read_is_refused(self) -> None:
        with pytest.raises(ProtocolError, match="400 digits"):
            receive('{"op": "publish", "topic": "/a", "msg": {"data": ' + "9" * 900_000 + "}}")

    def test_pictures_in_pictures_end_somewhere(self) -> None:
        text = '{"op": "set_level", "level": "none"}'
        for _ in range(10):
            text = json.dumps({"op": "png", "data": protocol.encode_png(text)})
        with pytest.raises(ProtocolError, match="too often"):
            receive(text)


class TestNumbersThatJsonLacks:
    def test_nan_and_infinities_travel_as_null(self) -> None:
        message = {"data": math.nan, "list": [math.inf, 1.0, -math.inf], "inner": {"x": math.nan}}
        (wire,) = Connection().send(protocol.Publish("/a", message))
        assert json.loads(wire)["msg"] == {"data": None, "list": [None, 1.0, None], "inner": {"x": None}}

    def test_a_client_may_send_them_as_they_are(self) -> None:
        (wire,) = Connection(nan_as_null=False).send(protocol.Publish("/a", {"data": math.inf}))
        assert receive(wire).msg == {"data": math.inf}

    def test_cbor_keeps_them(self) -> None:
        (wire,) = Connection().send(protocol.Publish("/a", {"data": -math.inf}), compression="cbor")
        assert receive(wire).msg == {"data": -math.inf}

    def test_byte_arrays_travel_as_base64(self) -> None:
        (wire,) = Connection().send(protocol.Publish("/a", {"data": b"\x00\xff"}))
        assert json.loads(wire)["msg"] == {"data": "AP8="}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=12,
)
FIELD_NAMES = sorted({name for operation in protocol.OPERATIONS.values() for name in operation._fields})
OPS = [*protocol.OPERATIONS, "fragment", "png"]


def raises_only_its_own_error(connection: Connection, data: Any) -> None:
    try:
        operation = connection.receive(data, 0.0)
    except ProtocolError:
        return
    if operation is not None:
        connection.send(operation)
        connection.send(operation, compression="cbor")


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from(OPS),
    st.dictionaries(st.sampled_from([*FIELD_NAMES, "data", "num", "total"]), JSON, max_size=8),
    st.sampled_from(["json", "cbor"]),
)
def test_an_operation_with_any_fields_raises_nothing_but_its_own_error(
    op: str, fields: Dict[str, Any], encoding: str
) -> None:
    message = {**fields, "op": op}
    raises_only_its_own_error(Connection(), json.dumps(message) if encoding == "json" else cbor2.dumps(message))


@settings(max_examples=300, deadline=None)
@given(st.text() | st.binary())
def test_any_text_and_any_bytes_raise_nothing_but_its_own_error(data: Any) -> None:
    raises_only_its_own_error(Connection(), data)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_a_damaged_message_raises_nothing_but_its_own_error(data: st.DataObject) -> None:
    fields = data.draw(st.sampled_from(EXAMPLES))
    compression = data.draw(st.sampled_from(["none", "png", "cbor"]))
    (wire,) = Connection().send(receive(json.dumps(fields)), compression=compression)
    raw = bytearray(wire.encode() if isinstance(wire, str) else wire)
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(raw[: data.draw(st.integers(0, len(raw)))])
    raises_only_its_own_error(Connection(), cut)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.dictionaries(st.sampled_from(["id", "num", "total", "data"]), JSON, max_size=4), max_size=10))
def test_any_sequence_of_fragments_raises_nothing_but_its_own_error(sequence: List[Dict[str, Any]]) -> None:
    connection = Connection()
    for fields in sequence:
        raises_only_its_own_error(connection, json.dumps({**fields, "op": "fragment"}))


@settings(max_examples=200, deadline=None)
@given(st.dictionaries(st.text(max_size=10), JSON, max_size=5), st.integers(1, 50), st.sampled_from(["none", "png"]))
def test_any_message_survives_any_fragment_size(message: Dict[str, Any], size: int, compression: str) -> None:
    connection = Connection()
    wires = connection.send(protocol.Publish("/a", message), fragment_size=size, compression=compression)
    received = [Connection.receive(connection, wire, 0.0) for wire in wires]
    expected = json.loads(protocol.encode_json(message))
    assert received[-1] is not None and received[-1].msg == expected  # type: ignore[union-attr]
