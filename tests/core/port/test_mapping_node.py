"""Code shared by the in-process middleware and the rosbridge client, beyond the conformance suite."""

from __future__ import annotations

from typing import Any, Callable, Mapping

import pytest
from harness.parameters import set_parameter

from robot_health_monitor.core.port.hints import Answer
from robot_health_monitor.core.port.mapping_node import MappingNode, MappingSubscription, read_clock
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.elements import NOT_A_NUMBER
from robot_health_monitor.core.values.errors import ConfigError, MessageError
from robot_health_monitor.core.values.field_path import ABSENT


class Node(MappingNode):
    """A node without a transport, on a clock that is set by hand."""

    def __init__(self, *, use_sim_time: bool = False, remap: Mapping[str, str] = {}) -> None:
        self.steady = 10.0
        self.lines: list[tuple[Severity, str]] = []
        clocks: dict[str, Callable[[], float]] = {"clock": lambda: self.steady, "wall_clock": lambda: 1_700_000_000.0}
        super().__init__("/robot1/node", {}, remap, **clocks, use_sim_time=use_sim_time)

    def log(self, severity: Severity, text: str) -> None:
        self.lines.append((severity, text))

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        answer(f"{topic} is not connected")

    def subscription(
        self, field: str = "data", kind: type[MappingSubscription] = MappingSubscription
    ) -> tuple[MappingSubscription, list[tuple[Any, float]]]:
        received: list[tuple[Any, float]] = []
        subscription = kind(self, "/in", "", field, lambda value, now_s: received.append((value, now_s)))
        return subscription, received


class FromJson(MappingSubscription):
    null_is_nan = True


@pytest.mark.parametrize(
    ("stamp", "time_s"),
    [
        ({"secs": 7, "nsecs": 250_000_000}, 7.25),
        ({"sec": 7, "nanosec": 250_000_000}, 7.25),
        ({"sec": 7}, None),
        ({}, None),
        ({"sec": "7"}, None),
        ({"sec": -1, "nanosec": 0}, None),
        ({"sec": float("nan"), "nanosec": 0}, None),
        ({"sec": True, "nanosec": 0}, None),
        (None, None),
    ],
)
def test_a_clock_message_has_the_stamp_of_ros_1_or_ros_2(stamp: object, time_s: object) -> None:
    assert read_clock({"clock": stamp}) == time_s


def test_a_null_is_a_nan_where_that_is_asked_for_but_not_behind_an_index() -> None:
    node = Node()
    subscription, received = node.subscription(kind=FromJson)
    subscription.deliver({"data": None})
    assert received[0][0] != received[0][0]
    indexed, received = node.subscription("cells[5]", FromJson)
    indexed.deliver({"cells": [1.0]})
    assert received == [(None, 10.0)]


def test_a_missing_field_is_one_error_line_with_the_fields_that_there_are() -> None:
    node = Node()
    subscription, received = node.subscription("percentage")
    for _ in range(3):
        subscription.deliver({"data": 1.0, "header": {}})
    assert node.lines == [(Severity.ERROR, "/in has no field percentage; available: data, header")]
    assert [value for value, _ in received] == [ABSENT] * 3


def test_a_robot_that_invents_topics_causes_a_limited_number_of_lines() -> None:
    node = Node()
    for number in range(1000):
        MappingSubscription(node, f"/in{number}", "", "percentage", print).deliver({"data": 1.0})
    assert len(node.lines) == 101


def test_a_topic_that_is_not_advertised_is_a_message_error() -> None:
    with pytest.raises(MessageError, match="/robot1/node has not advertised /robot1/out"):
        Node().require_advertised("out")


def test_names_are_remapped_after_they_are_resolved() -> None:
    node = Node(remap={"/diagnostics": "diagnostics", "level": "/battery/level"})
    assert node.resolve("/diagnostics") == "/robot1/diagnostics"
    assert node.resolve("level") == "/battery/level"
    assert node.resolve("other") == "/robot1/other"


def test_a_rejected_parameter_keeps_the_old_value() -> None:
    def reject(tree: Mapping[str, Any]) -> str:
        raise ConfigError("too high", ("rate",))

    node = Node()
    node.declare_parameters([], reject)
    with pytest.raises(ConfigError, match="rate: too high"):
        set_parameter(node, "rate", 7.0)
    assert node.given_parameters() == {}


@pytest.mark.parametrize(
    ("field", "message", "value"),
    [
        ("cells[*]", {"cells": [3.5, None]}, "[('0', 3.5), ('1', nan)]"),
        ('effort["*"]', {"name": ["a", "b"], "effort": [None, 2.5]}, "[('a', nan), ('b', 2.5)]"),
        ('effort["a"]', {"name": ["a"], "effort": [None]}, "nan"),
        ("cells[1]", {"cells": [3.5]}, "None"),
        ("packs[*].cells[1]", {"packs": [{"cells": [3.5]}]}, "[('0', None)]"),
        ('effort["*"]', {"name": ["a", 7], "effort": [1.5, 2.5]}, "name[1] is not a text: 7"),
        ('effort["a"]', {"name": "a", "effort": [1.5]}, ""),
        ("stamp", {"stamp": {"sec": None, "nanosec": 0}}, "not a time stamp: None"),
        ("stamp", {"stamp": {"sec": 1e300, "nanosec": 0}}, "not a time stamp: 1e+300"),
        (
            "stamp",
            {"stamp": {"secs": 5, "nsecs": 10**400}},
            f"not a time stamp: 1{36 * '0'}...",
        ),
        ("stamp", {"stamp": {"sec": True, "nanosec": 0}}, "not a time stamp: True"),
        ('status["*"]', {"status": [{"name": "lidar", "level": 7, "message": "?"}]}, "[('lidar', (7, '?'))]"),
        ("cells[*]", {"cells": "not base64!"}, ""),
        ("cells[*]", {"cells": {"0": 3.5}}, ""),
        ("cells[*]", {"cells": [[1.0], {"a": 1}]}, f"[('0', {NOT_A_NUMBER}), ('1', {NOT_A_NUMBER})]"),
    ],
)
def test_whatever_json_brings_for_elements_and_times_is_a_value_or_one_error_line(
    field: str, message: Mapping[str, Any], value: str
) -> None:
    node = Node()
    subscription, received = node.subscription(field, FromJson)
    subscription.deliver(message)
    subscription.deliver(message)
    if value:
        assert [_text(each) for each, _ in received] == [value, value]
        assert node.lines == []
    else:
        assert [each for each, _ in received] == [ABSENT, ABSENT]
        assert [text.partition(";")[0] for _, text in node.lines] == [f"/in has no field {field}"]


def _text(value: Any) -> str:
    return (
        repr([(name, tuple(each) if isinstance(each, tuple) else each) for name, each in value])
        if isinstance(value, list)
        else str(value)
    )


@pytest.mark.parametrize(
    ("type_name", "value", "expected"),
    [
        ("std_msgs/Float32", True, "true"),
        ("std_msgs/msg/Int8", False, "false"),
        ("std_msgs/Bool", True, True),
        ("robot_msgs/Other", True, True),
        ("std_msgs/Float32", 1, 1),
    ],
)
def test_a_boolean_is_no_number_unless_the_type_has_one(type_name: str, value: Any, expected: Any) -> None:
    received: list[Any] = []
    subscription = MappingSubscription(Node(), "/in", type_name, "data", lambda value, now_s: received.append(value))
    subscription.deliver({"data": value})
    assert received == [expected]
    assert type(received[0]) is type(expected)
