from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest

from robot_health_monitor.core.port.middleware import Graph, NodeInfo
from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.rosbridge.server import rosapi
from robot_health_monitor.rosbridge.server.rosapi import PREFIX

GRAPH = Graph(
    {"/battery_level": "std_msgs/msg/Float32", "/odom": "nav_msgs/Odometry"},
    {"/alert_system/reset": "std_srvs/Trigger"},
    {
        "/alert_system": NodeInfo(["/alerts"], ["/battery_level"], ["/alert_system/reset"]),
        "/driver": NodeInfo(["/battery_level", "/odom"], [], []),
    },
)
PARAMETERS = {"/alert_system": {"rosbridge_port": 9090, "rosbridge_token": "s3cret", "signals": {"a": {"for_s": 3.0}}}}


def node(graphs: Any = None) -> Any:
    """A served node; each reading of the graph returns the next of `graphs`."""
    queue: list[Graph] = list(graphs or [])
    return SimpleNamespace(
        graph=lambda: queue.pop(0) if graphs else GRAPH,
        definition=lambda type_name: "float32 data\n" if "Float32" in type_name else "",
        parameters=lambda: PARAMETERS,
    )


@pytest.fixture(autouse=True)
def _time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.time_ns", lambda: 1_234_500_000_000)


@pytest.mark.parametrize(
    ("service", "args", "response"),
    [
        ("topics", {}, {"topics": ["/battery_level", "/odom"], "types": ["std_msgs/msg/Float32", "nav_msgs/Odometry"]}),
        ("topics_for_type", {"type": "std_msgs/Float32"}, {"topics": ["/battery_level"]}),
        ("topic_type", {"topic": "/odom"}, {"type": "nav_msgs/Odometry"}),
        ("topic_type", {"topic": "/unknown"}, {"type": ""}),
        ("topic_type", {"topic": 5}, {"type": ""}),
        ("services", {}, {"services": ["/alert_system/reset"]}),
        ("service_type", {"service": "/alert_system/reset"}, {"type": "std_srvs/Trigger"}),
        ("services_for_type", {"type": "std_srvs/srv/Trigger"}, {"services": ["/alert_system/reset"]}),
        ("service_node", {"service": "/alert_system/reset"}, {"node": "/alert_system"}),
        ("service_providers", {"service": "/alert_system/reset"}, {"providers": ["/alert_system"]}),
        ("service_host", {"service": "/alert_system/reset"}, {"host": "localhost"}),
        ("nodes", {}, {"nodes": ["/alert_system", "/driver"]}),
        (
            "node_details",
            {"node": "/driver"},
            {"subscribing": [], "publishing": ["/battery_level", "/odom"], "services": []},
        ),
        ("node_details", {"node": "/unknown"}, {"subscribing": [], "publishing": [], "services": []}),
        ("publishers", {"topic": "/odom"}, {"publishers": ["/driver"]}),
        ("subscribers", {"topic": "/battery_level"}, {"subscribers": ["/alert_system"]}),
        ("action_servers", {}, {"action_servers": []}),
        ("get_time", {}, {"time": {"secs": 1234, "nsecs": 500000000, "sec": 1234, "nanosec": 500000000}}),
        ("get_param_names", {}, {"names": ["/alert_system:rosbridge_port", "/alert_system:signals.a.for_s"]}),
        ("get_param", {"name": "/alert_system:signals.a.for_s"}, {"value": "3.0"}),
        ("get_param", {"name": "/alert_system:rosbridge_token"}, {"value": '""'}),
        ("get_param", {"name": "/unknown", "default_value": "7"}, {"value": "7"}),
        ("get_param", {"name": "/unknown", "default": "7"}, {"value": "7"}),
        ("has_param", {"name": "/alert_system:rosbridge_port"}, {"exists": True}),
    ],
)
def test_services_answer_as_rosapi_does(service: str, args: Any, response: Any) -> None:
    assert rosapi.answer(node(), PREFIX + service, args) == response


def test_topics_types_and_definitions_come_from_one_reading_of_the_graph() -> None:
    grown = Graph({**GRAPH.topics, "/new": "std_msgs/Float32"}, {}, {})
    raw = rosapi.answer(node([GRAPH, grown, grown]), PREFIX + "topics_and_raw_types", {})
    assert raw == {
        "topics": ["/battery_level", "/odom"],
        "types": ["std_msgs/msg/Float32", "nav_msgs/Odometry"],
        "typedefs_full_text": ["float32 data\n", ""],
    }


def test_definitions_are_described_field_by_field() -> None:
    details = rosapi.answer(node(), PREFIX + "message_details", {"type": "std_msgs/Float32"})
    assert details["definition"] == "float32 data\n"
    (typedef,) = details["typedefs"]
    assert (typedef["fieldnames"], typedef["fieldtypes"], typedef["fieldarraylen"]) == (["data"], ["float32"], [-1])
    (request,) = rosapi.answer(node(), PREFIX + "service_request_details", {"type": "std_srvs/SetBool"})["typedefs"]
    assert request["fieldnames"] == ["data"]
    (response,) = rosapi.answer(node(), PREFIX + "service_response_details", {"type": "std_srvs/Trigger"})["typedefs"]
    assert response["fieldnames"] == ["success", "message"]


def test_an_unknown_service_is_a_service_error() -> None:
    for service in (PREFIX + "delete_param", "/other"):
        with pytest.raises(ServiceError, match=f"no service {service}"):
            rosapi.answer(node(), service, {})


def test_every_response_is_json() -> None:
    for service, type_name in rosapi.SERVICES.items():
        assert json.dumps(rosapi.answer(node(), service, {"name": "/a", "type": "std_msgs/Float32"})), type_name
