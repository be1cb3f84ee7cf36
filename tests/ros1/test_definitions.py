"""The definitions that the rosbridge server carries for a machine without ROS are those of ROS 1 itself."""

from __future__ import annotations

import io
from typing import Any

import pytest

MESSAGES: dict[str, dict[str, Any]] = {
    "std_msgs/Float32": {"data": 19.5},
    "std_msgs/String": {"data": "20 %"},
    "diagnostic_msgs/DiagnosticArray": {
        "header": {"frame_id": "base", "stamp": {"secs": 1, "nsecs": 2}},
        "status": [{"level": 1, "name": "a", "message": "b", "values": [{"key": "k", "value": "v"}]}, {"level": 3}],
    },
    "rosgraph_msgs/Log": {"level": 4, "name": "/alert_system", "msg": "low", "topics": ["/alerts"], "line": 7},
    "rosgraph_msgs/Clock": {"clock": {"secs": 5, "nsecs": 6}},
}


@pytest.mark.parametrize("type_name", list(MESSAGES))
def test_bytes_are_those_of_genpy(type_name: str) -> None:
    from robot_health_monitor.ros1 import messages
    from robot_health_monitor.rosbridge.protocol.definitions import serializer

    native = messages.to_native(messages.message_class(type_name), MESSAGES[type_name])
    buffer = io.BytesIO()
    native.serialize(buffer)
    serialize = serializer(type_name)
    assert serialize is not None
    assert serialize(messages.to_mapping(native)) == buffer.getvalue()


@pytest.mark.parametrize("type_name", list(MESSAGES))
def test_fields_are_those_of_genpy(type_name: str) -> None:
    from robot_health_monitor.core.messages.standard_messages import definition
    from robot_health_monitor.ros1 import messages
    from robot_health_monitor.rosbridge.protocol.definitions import parse

    theirs = parse(type_name, messages.message_class(type_name)._full_text)
    ours = parse(type_name, definition(type_name))
    assert {name: one.fields for name, one in ours.items()} == {name: one.fields for name, one in theirs.items()}
