"""Which topics are recorded: those of the signals, those that are named, those that match; images only if named."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import pytest

from robot_health_monitor.core import load_config
from robot_health_monitor.core.port.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.black_box import capture
from robot_health_monitor.ops.black_box.capture import Capture
from robot_health_monitor.ops.black_box.ring import Message

IMAGE = "sensor_msgs/Image"
FLOAT = "std_msgs/Float32"


class Robot:
    """A robot that publishes once on each of its topics."""

    def __init__(self, topics: Mapping[str, str], named: Sequence[str] = (), use_sim_time: bool = False) -> None:
        self.bus = LocalBus(5.0)
        self.found: list[str] = []
        self.times_s: list[float] = []
        self.sensor = self.bus.node("sensor")
        self.types: dict[str, str] = {}
        self.add(topics)
        self.node: LocalMiddleware = self.bus.node("alert_system", use_sim_time=use_sim_time)
        self.capture = Capture(self.node, named, self.note, ("/diagnostics",))
        self.capture.topic_types = self.node.topic_types()

    def add(self, topics: Mapping[str, str]) -> None:
        self.types.update(topics)
        for topic, type_name in topics.items():
            self.sensor.advertise(topic, type_name)

    def note(self, message: Message) -> None:
        self.found.append(message[1])
        self.times_s.append(message[0])

    def recorded(self, **signals: Mapping[str, object]) -> list[str]:
        """Returns the topics that are recorded with a configuration."""
        config = load_config({"signals": signals or {"none": {"topic": "/none", "type": FLOAT}}})
        for _ in range(2):  # an image of which the type was not known is recognised by its first message
            self.capture.follow(config)
            self.found.clear()
            for topic in self.types:
                self.sensor.publish(topic, {})
        return sorted(self.found)


def test_the_topics_of_signals_are_recorded_once_each() -> None:
    robot = Robot({"/a": FLOAT, "/b": FLOAT})
    signals = {
        "one": {"topic": "a"},
        "two": {"topic": "/a", "type": FLOAT},
        "three": {"topic": "a", "statistic": "mean"},
    }
    assert robot.recorded(**signals) == ["/a"]


def test_a_topic_that_is_named_is_recorded_whatever_its_type() -> None:
    assert Robot({"/a": FLOAT, "/image": IMAGE}, ["/image", "/a"]).recorded() == ["/a", "/image"]


def test_patterns_leave_images_and_what_the_node_publishes_itself_out() -> None:
    topics = {"/arm/a": FLOAT, "/arm/b": FLOAT, "/leg": FLOAT, "/arm/image": IMAGE, "/diagnostics": FLOAT}
    assert Robot(topics, ["/arm/*"]).recorded() == ["/arm/a", "/arm/b"]
    assert Robot(topics, ["*"]).recorded() == ["/arm/a", "/arm/b", "/leg"]


def test_a_topic_that_appears_later_is_recorded_from_then_on() -> None:
    robot = Robot({"/a": FLOAT}, ["*"])
    assert robot.recorded() == ["/a"]
    robot.add({"/b": FLOAT})
    robot.capture.topic_types = robot.node.topic_types()
    assert robot.recorded() == ["/a", "/b"]
    assert robot.recorded() == ["/a", "/b"]


@pytest.mark.parametrize("signal", [{"type": IMAGE, "field": ""}, {"field": ""}], ids=str)
def test_the_images_of_a_signal_are_not_recorded(signal: Mapping[str, object]) -> None:
    robot = Robot({"/image": IMAGE, "/a": FLOAT}, ["/a"])
    assert robot.recorded(camera={"topic": "/image", **signal}) == ["/a"]


@pytest.mark.parametrize("signal", [{"type": IMAGE, "field": ""}, {"field": ""}], ids=str)
def test_the_images_of_a_signal_are_recorded_if_they_are_named(signal: Mapping[str, object]) -> None:
    robot = Robot({"/image": IMAGE}, ["/image"])
    assert robot.recorded(camera={"topic": "/image", **signal}) == ["/image"]


def test_a_changed_configuration_ends_subscriptions() -> None:
    robot = Robot({"/a": FLOAT, "/b": FLOAT})
    assert robot.recorded(one={"topic": "/a"}) == ["/a"]
    assert robot.recorded(one={"topic": "/b"}) == ["/b"]
    robot.capture.close()
    robot.found.clear()
    robot.sensor.publish("/b", {})
    assert robot.found == []


def test_a_topic_that_cannot_be_recorded_is_one_line_in_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = Robot({"/a": FLOAT, "/b": FLOAT})
    subscribe_raw = robot.node.subscribe_raw

    def refuse(topic: str, *arguments: Any) -> Any:
        if topic == "/b":
            raise ConfigError("expected another type")
        return subscribe_raw(topic, *arguments)

    monkeypatch.setattr(robot.node, "subscribe_raw", refuse)
    assert robot.recorded(one={"topic": "/a"}, two={"topic": "/b"}) == ["/a"]
    assert robot.recorded(one={"topic": "/a"}, two={"topic": "/b", "for_s": 1.0}) == ["/a"]
    lines = [line.text for line in robot.bus.log_lines]
    assert lines == ["black box: /b is not recorded: expected another type"]


def test_a_robot_that_lists_topics_of_impossible_types_costs_some_lines_and_bounded_memory() -> None:
    """For a minute, 5,000 new names every 5 s; a topic that a signal watches is recorded all the same."""
    robot = Robot({"/z": FLOAT}, ["*"])
    for number in range(12):
        robot.capture.topic_types = {f"/t{number}/n{each}": "no\ntype" for each in range(5_000)}
        assert robot.recorded(one={"topic": "/z"}) == ["/z"]
        assert len(robot.capture._topics) == capture._MOST_MATCHING + 1
        robot.bus.run_until(robot.bus.now_s + 5.0)
    texts = [line.text for line in robot.bus.log_lines]
    assert len(texts) == 10
    assert all(text.startswith("black box: /t0/n") and "\n" not in text for text in texts)
    robot.capture.topic_types = {}
    robot.recorded()
    assert [name for name, _ in robot.capture._topics] == ["/none"]


def test_under_simulated_time_messages_have_steady_time_and_the_clock_is_recorded() -> None:
    robot = Robot({"/a": FLOAT, "/clock": "rosgraph_msgs/Clock"}, use_sim_time=True)
    robot.sensor.publish("/clock", {"clock": {"secs": 7000, "nsecs": 0}})
    assert robot.recorded(one={"topic": "/a"}) == ["/a", "/clock"]
    assert set(robot.times_s) == {5.0}
    assert robot.capture.is_simulated


def test_the_absolute_name_of_each_topic_is_known() -> None:
    robot = Robot({"/a": FLOAT})
    robot.recorded(one={"topic": "a"})
    assert robot.capture.resolved == {"a": "/a"}


def test_the_latest_message_of_a_quiet_topic_is_kept_unless_its_silence_matters() -> None:
    """All topics have one message at 5 s."""
    large = {"data": "x" * 70_000}
    robot = Robot({"/a": FLOAT, "/slow": FLOAT, "/rate": FLOAT, "/map": "std_msgs/String", "/tf_static": FLOAT},
                  ["/map", "/tf_static"])  # fmt: skip
    signals = {
        "a": {"topic": "a", "stale_after_s": 0.0},
        "slow": {"topic": "slow", "stale_after_s": 30.0},
        "again": {"topic": "/slow", "stale_after_s": 60.0},
        "rate": {"topic": "rate", "stale_after_s": 0.0, "statistic": "frequency_hz", "field": ""},
    }
    robot.recorded(**signals)
    robot.sensor.publish("/map", large)

    def quiet(now_s: float) -> list[str]:
        found = robot.capture.quiet(now_s)
        assert all(message[0] == now_s for message in found)
        return sorted(message[1] for message in found)

    assert quiet(5.5) == []
    assert quiet(10.0) == ["/a", "/slow", "/tf_static"]
    assert quiet(40.0) == ["/a", "/tf_static"]
    robot.sensor.publish("/map", {"data": "small"})
    assert quiet(40.0) == ["/a", "/map", "/tf_static"]


def test_what_is_kept_of_quiet_topics_is_bounded() -> None:
    topics = {f"/t{number}": "std_msgs/String" for number in range(20)}
    robot = Robot(topics, sorted(topics))
    robot.recorded()
    for topic in topics:
        robot.sensor.publish(topic, {"data": "x" * 60_000})
    found = robot.capture.quiet(10.0)
    assert len(found) == 4  # 256 KiB hold four
