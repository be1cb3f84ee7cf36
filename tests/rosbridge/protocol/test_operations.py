from __future__ import annotations

import dataclasses
import json
from typing import Any

import pytest
from harness.rosbridge_operations import EXAMPLES

from robot_health_monitor.core.config.schema import parameters
from robot_health_monitor.rosbridge.protocol import operations
from robot_health_monitor.rosbridge.protocol.limits import ProtocolError
from robot_health_monitor.rosbridge.protocol.operations import OPERATIONS, read_operation


@pytest.mark.parametrize("fields", EXAMPLES, ids=lambda fields: fields["op"])
class TestEveryOperation:
    def test_is_read_as_in_the_protocol(self, fields: dict[str, Any]) -> None:
        operation = read_operation(json.loads(json.dumps(fields)))
        assert type(operation) is OPERATIONS[fields["op"]]
        names = vars(operation).keys()
        assert vars(operation).items() >= {key: value for key, value in fields.items() if key in names}.items()

    def test_names_a_missing_required_field(self, fields: dict[str, Any]) -> None:
        operation = OPERATIONS[fields["op"]]
        table = {each.name: each for each in parameters(operation)}
        for name, field in operation.__dataclass_fields__.items():
            if field.default is field.default_factory is dataclasses.MISSING:
                rest = {key: value for key, value in fields.items() if key != name}
                with pytest.raises(ProtocolError) as refusal:
                    read_operation(rest)
                assert str(refusal.value) == f"{fields['op']}: {name}: is missing; expected {table[name].allowed}"


def test_every_operation_of_the_protocol_has_an_example() -> None:
    required = {"advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service", "advertise_service"}
    required |= {"unadvertise_service", "service_response", "send_action_goal"}
    required |= {"set_level"}
    assert required <= {fields["op"] for fields in EXAMPLES} == OPERATIONS.keys()


@pytest.mark.parametrize("op", ["status", "auth", "action_result"])
def test_what_needs_no_action_is_ignored(op: str) -> None:
    assert read_operation({"op": op, "level": 5}) is None


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({}, "unknown operation nothing"),
        ({"op": 5}, "unknown operation 5"),
        ({"op": "shutdown"}, "unknown operation 'shutdown'"),
        ({"op": "advertise_action", "action": "/dock"}, "actions are not supported"),
        ({"op": "fragment", "data": "{", "num": 0, "total": 2}, "fragment: received messages must be whole"),
        ({"op": "png", "data": "iVBO"}, "png: received messages must not be compressed"),
        ({"op": "subscribe", "topic": 5}, "topic: expected printable text of 1 to 512 characters, got 5"),
        ({"op": "subscribe", "topic": ""}, "topic: expected printable text of 1 to 512 characters, got ''"),
        ({"op": "subscribe", "topic": "/a\0"}, r"got '/a\x00'"),
        (
            {"op": "subscribe", "topic": "/a", "id": []},
            "id: expected a whole number or a text of at most 512 characters",
        ),
        ({"op": "subscribe", "topic": "/a", "id": 1e30}, "id: expected a whole number or a text"),
        (
            {"op": "subscribe", "topic": "/a", "throttle_rate": -1},
            "expected a number of at least 0, got -1",
        ),
        (
            {"op": "subscribe", "topic": "/a", "throttle_rate": float("nan")},
            "expected a number of at least 0, got nan",
        ),
        (
            {"op": "subscribe", "topic": "/a", "throttle_rate": True},
            "throttle_rate: expected a number of at least 0, got true",
        ),
        (
            {"op": "subscribe", "topic": "/a", "compression": "zip"},
            "one of none, png, cbor, cbor-raw, got 'zip'",
        ),
        ({"op": "publish", "topic": "/a", "msg": "text"}, "msg: expected a mapping, got 'text'"),
        ({"op": "call_service", "service": "/a", "args": "text"}, "args: expected a mapping or a list, got 'text'"),
        ({"op": "set_level", "level": "loud"}, "level: expected one of none, error, warning, info, got 'loud'"),
    ],
)
def test_a_wrong_field_is_reported_in_one_line(fields: dict[str, Any], problem: str) -> None:
    with pytest.raises(ProtocolError) as refusal:
        read_operation(fields)
    assert problem in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_fields_that_are_not_used_are_ignored() -> None:
    fields = {"op": "advertise", "topic": "/in", "type": "std_msgs/Float32", "latch": "yes", "new": 1}
    assert read_operation(fields) == operations.Advertise("/in", "std_msgs/Float32")
