"""One example of every rosbridge operation that is read, with the fields of ROSBRIDGE_PROTOCOL.md."""

from __future__ import annotations

from typing import Any

EXAMPLES: list[dict[str, Any]] = [
    {"op": "advertise", "id": "a1", "topic": "/in", "type": "std_msgs/Float32"},
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
        "compression": "png",
    },
    {"op": "unsubscribe", "id": "s1", "topic": "/out"},
    {"op": "call_service", "service": "/reset", "args": {}},
    {
        "op": "call_service",
        "id": 7,
        "service": "/reset",
        "args": [{"x": 1}],
        "compression": "png",
    },
    {"op": "service_response", "service": "/reset", "values": {"success": True}, "result": True, "id": "c1"},
    {"op": "service_response", "service": "/reset", "values": "it failed", "result": False, "id": "c1"},
    {"op": "advertise_service", "service": "/reset", "type": "std_srvs/Trigger"},
    {"op": "unadvertise_service", "service": "/reset"},
    {"op": "send_action_goal", "action": "/dock", "id": "g1"},
    {"op": "set_level", "level": "warning"},
]
