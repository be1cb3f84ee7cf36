"""The contract of the port, as tests that run against every implementation.

A test module per middleware subclasses `PortConformance` and gives it a fixture `harness`, made anew for each test:

    class TestRos1(PortConformance):
        @pytest.fixture
        def harness(self, master): ...

The nodes under test live in the test's own process; the `Harness` stands outside them and speaks the middleware's own
language, so that a wrong conversion in an adapter cannot cancel itself out.
"""

from __future__ import annotations

import base64
import itertools
import math
import threading
import time
from pathlib import Path
from typing import Any, Callable, Mapping, NamedTuple, Protocol, Sequence

import pytest

from robot_health_monitor.core.config.monitor_config import find_section
from robot_health_monitor.core.config.parameters import Parameter, flatten
from robot_health_monitor.core.config.schema import read_parameters
from robot_health_monitor.core.config.yaml_file import read_yaml
from robot_health_monitor.core.judge.attachments import TICKS
from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor
from robot_health_monitor.core.nodes.outlets import Event, Outlet
from robot_health_monitor.core.port.middleware import Middleware, Severity
from robot_health_monitor.core.proposal.candidates import Candidates, Topic
from robot_health_monitor.core.proposal.proposal import propose
from robot_health_monitor.core.values.errors import ConfigError, MessageError
from robot_health_monitor.core.values.field_path import ABSENT
from robot_health_monitor.core.values.model import Transition

START_S = 100.0
"""The simulated time at which every test starts."""

CONFIG = Path(__file__).resolve().parents[2] / "config"

FLOAT32 = "std_msgs/Float32"
DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
TRIGGER = "std_srvs/Trigger"
STATUS = {
    "level": 2,
    "name": "driver: left motor",
    "message": "too hot",
    "hardware_id": "robot1",
    "values": [{"key": "unit", "value": "degrees C"}, {"key": "value", "value": "81.0"}],
}

JOINTS = {
    "header": {"stamp": {"secs": 1_700_000_000, "nsecs": 250_000_000}},
    "name": ["wheel_left", "wheel_right", "arm"],
    "velocity": [0.5, 1.5],
    "effort": [1.5, -2.5, 0.25],
}
NINE_ONES = [(str(index), 1.0) for index in range(9)]


class LogLine(NamedTuple):
    """One line in the middleware's log."""

    severity: Severity
    text: str


class Harness(Protocol):
    """One middleware, seen from outside the nodes under test."""

    knows_listeners: bool
    """Whether a node knows if a topic has subscribers."""

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        remap: Mapping[str, str] | None = None,
        sim_time: bool = True,
    ) -> Middleware:
        """Returns a new node; `close()` of the harness closes it.

        Args:
            name: base name.
            namespace: `robot1`, or empty.
            parameters: its configuration, nested.
            remap: names as the node uses them to the names to use instead.
            sim_time: its clock is the one that `set_time` moves; False: the middleware's default clock.
        """

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        """Publishes as a foreign process would; returns when it has been sent to all present subscribers."""

    def listen(self, topic: str, type_name: str) -> list[Mapping[str, Any]]:
        """Subscribes as a foreign process would, to all present publishers.

        Returns:
            A list that grows by one mapping per message, in the shape of the middleware: nested, `level` as it is on
            the wire, byte arrays as bytes, base64 text or lists.
        """

    def call(self, service: str, type_name: str, request: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        """Calls a service by its absolute name and returns the response.

        Raises:
            ServiceFailed: the call itself failed.
        """

    def propose(self, node: Middleware, name: str, value: object) -> str:
        """Changes one parameter as a user would, by its dotted name.

        Returns:
            The reason why the node refused it, empty when it accepted.
        """

    def set_time(self, now_s: float) -> None:
        """Moves simulated time; returns when the nodes' clocks show it. Timers may still be about to be called."""

    def log_lines(self) -> Sequence[LogLine]:
        """Returns what the nodes of this test have logged until now."""

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        """Runs the nodes until `predicate()` is true.

        Raises:
            AssertionError: it is still false after 30 s.
        """

    def close(self) -> None:
        """Closes the nodes and its own connections."""


class ServiceFailed(Exception):
    """The service does not exist, or its handler failed and the middleware reports it."""


def poll_until(predicate: Callable[[], bool], work: Callable[[], object], deadline_s: float = 30.0) -> None:
    """Calls `work` (which may wait a little) until `predicate()` is true: a `wait_until` for a harness.

    Raises:
        AssertionError: it is still false after `deadline_s`.
    """
    give_up_s = time.monotonic() + deadline_s
    while not predicate():
        assert time.monotonic() < give_up_s, f"still not true after {deadline_s:g} s"
        work()


def stamp_s(stamp: Mapping[str, int]) -> float:
    """Returns a stamp in seconds, in either spelling."""
    seconds = stamp["secs"] if "secs" in stamp else stamp["sec"]
    nanoseconds = stamp["nsecs"] if "nsecs" in stamp else stamp["nanosec"]
    return seconds + nanoseconds / 1e9


def level_of(status: Mapping[str, Any]) -> int:
    """Returns the level of a native DiagnosticStatus: an int, or one byte."""
    level = status["level"]
    return level[0] if isinstance(level, bytes) else level


def bytes_of(data: Any) -> bytes:
    """Returns the bytes of a native byte array: bytes, base64 text or a list of numbers."""
    return base64.b64decode(data) if isinstance(data, str) else bytes(data)


class Recorder:
    """A callback that records its arguments, and counts messages that hold no value."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self.times_s: list[float] = []
        self.without = 0

    def __call__(self, value: Any, now_s: float) -> None:
        if value is ABSENT:
            self.without += 1
            return
        self.times_s.append(now_s)
        self.values.append(value)


class RefusingNode:
    """Declares a rate and a bound, and refuses what the rate's table does not allow."""

    RATE = Parameter("publish_rate", float, 1.0, "messages per second", minimum=0.1, maximum=100.0)
    BOUND = Parameter("signals.battery_level.warn_below", float, None, "level in % below which to warn")

    def __init__(self, middleware: Middleware) -> None:
        self.trees: list[Mapping[str, Any]] = []
        middleware.declare_parameters([self.RATE, self.BOUND], self._on_change)

    def _on_change(self, tree: Mapping[str, Any]) -> str:
        read_parameters(tree, [self.RATE], sections=["signals"])
        self.trees.append(tree)
        return f"change {len(self.trees)}"


def levels_to(levels: list[tuple[str, str]]) -> Outlet:
    """Returns an outlet that appends the signal and the new level of each transition."""

    def outlet(event: Event) -> None:
        if isinstance(event, Transition):
            levels.append((event.signal, event.to_level.name))

    return outlet


def plain(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a tree's leaves that have a value, by dotted name."""
    return {name: value for name, value in flatten(tree) if value is not None}


class PortConformance:
    """The contract, grouped as in the port's docstrings."""

    is_one_node_per_process = False
    """Whether the nodes of a process are one for the graph, as in ROS 1."""
    knows_graph = True

    def other_node(self, harness: Harness, name: str) -> Any:
        """Returns a node of the robot's graph that is not one of the monitor's."""
        return harness.node(name)

    @pytest.fixture(autouse=True)
    def _close(self, harness: Harness) -> Any:
        yield
        harness.close()

    # Names

    def test_a_node_is_named_with_its_namespace(self, harness: Harness) -> None:
        assert harness.node("alert_system").name == "/alert_system"
        assert harness.node("alert_system", namespace="robot1").name == "/robot1/alert_system"

    @pytest.mark.parametrize(
        ("topic", "resolved"),
        [
            ("battery_level", "/robot1/battery_level"),
            ("front/temperature", "/robot1/front/temperature"),
            ("/battery_level", "/battery_level"),
            ("~battery_level", "/robot1/alert_system/battery_level"),
        ],
    )
    def test_topics_are_relative_absolute_or_private(self, harness: Harness, topic: str, resolved: str) -> None:
        node, heard = harness.node("alert_system", namespace="robot1"), Recorder()
        subscription = node.subscribe(topic, FLOAT32, heard, field="data")
        assert subscription.topic == resolved
        harness.publish(resolved, FLOAT32, {"data": 19.5})
        harness.wait_until(lambda: heard.values == [19.5])

        node.unsubscribe(subscription)
        node.advertise(topic, FLOAT32)
        listened = harness.listen(resolved, FLOAT32)
        node.publish(topic, {"data": 20.5})
        harness.wait_until(lambda: [message["data"] for message in listened] == [20.5])

    def test_services_are_private_to_their_node_when_their_name_says_so(self, harness: Harness) -> None:
        node = harness.node("alert_system", namespace="robot1")
        node.advertise_service("~reset", TRIGGER, lambda request: {"success": True, "message": "private"})
        node.advertise_service("reset", TRIGGER, lambda request: {"success": True, "message": "relative"})
        assert harness.call("/robot1/alert_system/reset", TRIGGER)["message"] == "private"
        assert harness.call("/robot1/reset", TRIGGER)["message"] == "relative"

    @pytest.mark.parametrize(
        ("topic", "old", "new", "resolved"),
        [
            ("temperature", "temperature", "engine/temperature", "/robot1/engine/temperature"),
            ("temperature", "temperature", "/engine/temperature", "/engine/temperature"),
            ("temperature", "/robot1/temperature", "engine", "/robot1/engine"),
            ("/diagnostics", "/diagnostics", "diagnostics", "/robot1/diagnostics"),
        ],
    )
    def test_topics_are_remapped(self, harness: Harness, topic: str, old: str, new: str, resolved: str) -> None:
        node, heard = harness.node("alert_system", namespace="robot1", remap={old: new}), Recorder()
        subscription = node.subscribe(topic, FLOAT32, heard, field="data")
        assert subscription.topic == resolved
        harness.publish(resolved, FLOAT32, {"data": 81.0})
        harness.wait_until(lambda: heard.values == [81.0])

        node.unsubscribe(subscription)
        node.advertise(topic, FLOAT32)
        listened = harness.listen(resolved, FLOAT32)
        node.publish(topic, {"data": 82.0})
        harness.wait_until(lambda: [message["data"] for message in listened] == [82.0])

    # Types and values

    @pytest.mark.parametrize("type_name", ["std_msgs/Float32", "std_msgs/msg/Float32"])
    def test_message_types_have_two_spellings(self, harness: Harness, type_name: str) -> None:
        node, heard = harness.node("aggregator"), Recorder()
        node.subscribe("cpu_usage", type_name, heard, field="data")
        harness.publish("/cpu_usage", FLOAT32, {"data": 12.5})
        harness.wait_until(lambda: heard.values == [12.5])

        node.advertise("system_health", type_name)
        listened = harness.listen("/system_health", FLOAT32)
        node.publish("system_health", {"data": 13.5})
        harness.wait_until(lambda: [message["data"] for message in listened] == [13.5])

    @pytest.mark.parametrize("type_name", ["std_srvs/Trigger", "std_srvs/srv/Trigger"])
    def test_service_types_have_two_spellings(self, harness: Harness, type_name: str) -> None:
        node = harness.node("alert_system")
        node.advertise_service("~reset", type_name, lambda request: {"success": True, "message": "2 alerts cleared"})
        assert dict(harness.call("/alert_system/reset", TRIGGER)) == {"success": True, "message": "2 alerts cleared"}

    def test_float32_carries_32_bits_both_ways(self, harness: Harness) -> None:
        node, heard = harness.node("battery_sensor"), Recorder()
        node.subscribe("in", FLOAT32, heard, field="data")
        harness.publish("/in", FLOAT32, {"data": 0.1})
        harness.wait_until(lambda: heard.values == [0.10000000149011612])
        assert type(heard.values[0]) is float

        node.advertise("out", FLOAT32)
        listened = harness.listen("/out", FLOAT32)
        node.publish("out", {"data": 0.1})
        harness.wait_until(lambda: [float(message["data"]) for message in listened] == [0.10000000149011612])

    def test_nan_and_infinities_pass_through_both_ways(self, harness: Harness) -> None:
        node, heard = harness.node("battery_sensor"), Recorder()
        node.subscribe("in", FLOAT32, heard, field="data")
        node.advertise("out", FLOAT32)
        listened = harness.listen("/out", FLOAT32)
        for number in (math.nan, math.inf, -math.inf):
            harness.publish("/in", FLOAT32, {"data": number})
            node.publish("out", {"data": number})
        node.publish("out", {"data": None})
        harness.wait_until(lambda: len(heard.values) == 3 and len(listened) == 4)
        assert math.isnan(heard.values[0]) and heard.values[1:] == [math.inf, -math.inf]
        sent = [float(message["data"]) for message in listened]
        assert math.isnan(sent[0]) and sent[1:3] == [math.inf, -math.inf] and math.isnan(sent[3])

    @pytest.mark.parametrize(
        ("type_name", "message", "field", "value"),
        [
            ("std_msgs/Int32", {"data": -7}, "data", -7),
            ("std_msgs/Bool", {"data": True}, "data", True),
            ("std_msgs/String", {"data": "20 %"}, "data", "20 %"),
            ("sensor_msgs/BatteryState", {"percentage": 0.25}, "percentage", 0.25),
            ("sensor_msgs/BatteryState", {"cell_voltage": [3.5, 4.25]}, "cell_voltage[1]", 4.25),
            ("sensor_msgs/BatteryState", {"header": {"frame_id": "base"}}, "header.frame_id", "base"),
            ("sensor_msgs/Imu", {"orientation": {"w": 0.5}}, "orientation.w", 0.5),
            ("sensor_msgs/Imu", {"orientation_covariance": [1.0, 2.0, 3.0] * 3}, "orientation_covariance[8]", 3.0),
            ("std_msgs/Float32MultiArray", {"layout": {"data_offset": 4}}, "layout.data_offset", 4),
            ("std_msgs/Float32MultiArray", {"layout": {"dim": [{"size": 3}]}}, "layout.dim[0].size", 3),
            ("diagnostic_msgs/DiagnosticStatus", {"level": 2}, "level", 2),
            ("diagnostic_msgs/DiagnosticArray", {"status": [{"level": 1}]}, "status[0].level", 1),
        ],
    )
    def test_fields_are_read_by_their_path(
        self, harness: Harness, type_name: str, message: Mapping[str, Any], field: str, value: object
    ) -> None:
        heard = Recorder()
        harness.node("alert_system").subscribe("in", type_name, heard, field=field)
        harness.publish("/in", type_name, message)
        harness.wait_until(lambda: len(heard.values) == 1)
        assert heard.values == [value]
        assert isinstance(heard.values[0], type(value))

    def test_an_index_beyond_the_end_of_the_array_reads_as_none(self, harness: Harness) -> None:
        heard = Recorder()
        harness.node("alert_system").subscribe("in", "sensor_msgs/BatteryState", heard, field="cell_voltage[2]")
        harness.publish("/in", "sensor_msgs/BatteryState", {"cell_voltage": [3.5, 4.25]})
        harness.wait_until(lambda: heard.values == [None])

    @pytest.mark.parametrize(
        ("type_name", "message", "field", "value"),
        [
            (DIAGNOSTICS, {"status": [STATUS]}, 'status["driver: left motor"].level', 2),
            (DIAGNOSTICS, {"status": [STATUS]}, 'status["driver: left motor"].message', "too hot"),
            (DIAGNOSTICS, {"status": [STATUS]}, 'status["driver: left motor"].values["value"]', 81.0),
            (DIAGNOSTICS, {"status": [STATUS]}, "status['driver: left motor'].values['unit']", "degrees C"),
            ("diagnostic_msgs/DiagnosticStatus", STATUS, 'values["value"].value', "81.0"),
        ],
    )
    def test_an_element_is_picked_by_its_name_or_key(
        self, harness: Harness, type_name: str, message: Mapping[str, Any], field: str, value: object
    ) -> None:
        heard = Recorder()
        harness.node("alert_system").subscribe("in", type_name, heard, field=field)
        harness.publish("/in", type_name, message)
        harness.wait_until(lambda: heard.values == [value])
        assert isinstance(heard.values[0], type(value))

    @pytest.mark.parametrize(
        ("type_name", "message", "values"),
        [
            (
                "sensor_msgs/JointState",
                JOINTS,
                {
                    'effort["wheel_right"]': -2.5,
                    'effort["*"]': [("wheel_left", 1.5), ("wheel_right", -2.5), ("arm", 0.25)],
                    'effort["wheel_*"]': [("wheel_left", 1.5), ("wheel_right", -2.5)],
                    "effort[*]": [("0", 1.5), ("1", -2.5), ("2", 0.25)],
                    'velocity["arm"]': "velocity has 2 elements, name has 3",
                    'velocity["*"]': "velocity has 2 elements, name has 3",
                    "header.stamp": 1_700_000_000.25,
                },
            ),
            ("sensor_msgs/BatteryState", {"cell_voltage": [3.5, 4.25]}, {"cell_voltage[*]": [("0", 3.5), ("1", 4.25)]}),
            ("sensor_msgs/BatteryState", {}, {"cell_voltage[*]": []}),
            ("sensor_msgs/Imu", {"orientation_covariance": [1.0] * 9}, {"orientation_covariance[*]": NINE_ONES}),
            (
                "sensor_msgs/Image",
                {"data": base64.b64encode(b"\x07\xff").decode()},
                {"data[*]": [("0", 7), ("1", 255)]},
            ),
            ("sensor_msgs/TimeReference", {"time_ref": {"secs": 12, "nsecs": 500_000_000}}, {"time_ref": 12.5}),
            (
                DIAGNOSTICS,
                {"status": [STATUS]},
                {
                    'status["*"]': [("driver: left motor", (2, "too hot"))],
                    'status["driver: left motor"]': (2, "too hot"),
                    "status[*].level": [("0", 2)],
                    'status["*"].values["value"]': [("driver: left motor", 81.0)],
                },
            ),
        ],
    )
    def test_elements_and_times_are_read_alike(
        self, harness: Harness, type_name: str, message: Mapping[str, Any], values: Mapping[str, Any]
    ) -> None:
        heard = {field: Recorder() for field in values}
        node = harness.node("alert_system", sim_time=False)
        for field, recorder in heard.items():
            node.subscribe("in", type_name, recorder, field=field)
        harness.publish("/in", type_name, message)
        harness.wait_until(lambda: all(recorder.values for recorder in heard.values()))
        assert {field: recorder.values for field, recorder in heard.items()} == {
            field: [value] for field, value in values.items()
        }

    @pytest.mark.parametrize(
        ("type_name", "field", "messages", "values"),
        [
            (
                "diagnostic_msgs/DiagnosticStatus",
                "level where level >= ERROR",
                [{"level": level} for level in (0, 1, 2, 3)],
                [2, 3],
            ),
            (
                DIAGNOSTICS,
                'status["*"].level where status[0].level == STALE and status[0].name == "*left*"',
                [{"status": [{**STATUS, "level": 3}]}, {"status": [STATUS]}, {"status": []}],
                [[("driver: left motor", 3)]],
            ),
            (
                "sensor_msgs/BatteryState",
                " where power_supply_status != POWER_SUPPLY_STATUS_CHARGING and present == 1",
                [{"power_supply_status": 2, "present": True}, {"power_supply_status": 1, "present": True}, {}],
                [1.0],
            ),
            (FLOAT32, "data where data > 1.5", [{"data": 1.5}, {"data": math.nan}, {"data": 2.0}], [2.0]),
            (FLOAT32, " where data != 3", [{"data": 3.0}, {"data": math.nan}, {"data": 2.0}], [1.0, 1.0]),
        ],
    )
    def test_a_message_for_which_the_condition_does_not_hold_is_only_a_sign_of_life(
        self, harness: Harness, type_name: str, field: str, messages: Sequence[Any], values: Sequence[Any]
    ) -> None:
        heard = Recorder()
        harness.node("alert_system").subscribe("in", type_name, heard, field=field)
        for message in messages:
            harness.publish("/in", type_name, message)
        harness.wait_until(lambda: len(heard.values) + heard.without == len(messages))
        assert heard.values == values

    @pytest.mark.parametrize("field", ["data where date > 1", "data where data == HIGH"])
    def test_a_condition_with_a_field_or_constant_that_is_not_there_is_refused(
        self, harness: Harness, field: str
    ) -> None:
        with pytest.raises(ConfigError, match=r"/in: std_msgs/Float32 has no (field date|constant HIGH)"):
            harness.node("alert_system").subscribe("in", FLOAT32, Recorder(), field=field)

    def test_an_empty_array_beside_its_names_is_a_sign_of_life_without_a_value(self, harness: Harness) -> None:
        one, every = Recorder(), Recorder()
        node = harness.node("alert_system")
        node.subscribe("in", "sensor_msgs/JointState", one, field='effort["arm"]')
        node.subscribe("in", "sensor_msgs/JointState", every, field='effort["*"]')
        harness.publish("/in", "sensor_msgs/JointState", {**JOINTS, "effort": []})
        harness.publish("/in", "sensor_msgs/JointState", JOINTS)
        harness.wait_until(lambda: bool(one.values and every.values))
        assert one.values == [0.25] and len(every.values) == 1
        assert one.without == every.without == 1

    def test_the_age_of_a_stamp_is_judged_by_the_simulated_clock(self, harness: Harness) -> None:
        events: list[Any] = []
        age = {"topic": "in", "type": "sensor_msgs/Imu", "field": "header.stamp", "warn_above": 0.5}
        node = harness.node("alert_system", parameters={"signals": {"age": age}})
        AlertSystem(node, {"test": events.append})
        for stamp_s in (START_S - 2.0, START_S + 1.0, 0.0):
            stamp = {"secs": int(stamp_s), "nsecs": 0}
            harness.publish("/in", "sensor_msgs/Imu", {"header": {"stamp": stamp}})
        harness.wait_until(lambda: len(events) == 3)
        assert [event.text.rpartition(" (")[0] for event in events] == [
            "age WARN: 2 s is above 0.5 s",
            "age OK: -1 s is no longer above 0.5 s, clocks differ",
            "age ERROR: invalid data: no time stamp",
        ]

    def test_without_simulated_time_stamps_are_compared_with_the_wall_clock(self, harness: Harness) -> None:
        node = harness.node("alert_system", sim_time=False)
        assert abs(node.stamp_s() - time.time()) < 60.0

    def test_a_message_without_the_picked_element_is_a_sign_of_life_without_a_value(self, harness: Harness) -> None:
        heard = Recorder()
        node = harness.node("alert_system")
        node.subscribe("in", DIAGNOSTICS, heard, field='status["driver: left motor"].level')
        harness.publish("/in", DIAGNOSTICS, {"status": [{**STATUS, "name": "driver: right motor"}]})
        harness.publish("/in", DIAGNOSTICS, {"status": []})
        harness.publish("/in", DIAGNOSTICS, {"status": [STATUS]})
        harness.wait_until(lambda: len(heard.values) >= 1)
        assert (heard.values, heard.without) == ([2], 2)

    def test_arrivals_are_received_without_reading_the_messages(self, harness: Harness) -> None:
        node, typed, untyped, read = harness.node("alert_system"), Recorder(), Recorder(), Recorder()
        node.subscribe("in", FLOAT32, typed, field=None)
        node.subscribe("in", "", untyped, field=None)
        harness.publish("/in", FLOAT32, {"data": 5.0})
        harness.publish("/in", FLOAT32, {"data": 6.0})
        harness.wait_until(lambda: len(typed.values) == 2)
        node.subscribe("in", FLOAT32, read, field="data")
        harness.publish("/in", FLOAT32, {"data": 7.0})
        harness.wait_until(lambda: read.values == [7.0])
        harness.wait_until(lambda: typed.values == [1.0] * 3 and untyped.values[-1:] == [1.0])

    def test_a_type_that_is_left_out_is_found_out(self, harness: Harness) -> None:
        """Whether the topic is there before the subscription or comes after it."""
        node, before, after = harness.node("alert_system"), Recorder(), Recorder()

        def heard(recorder: Recorder, topic: str, message: Mapping[str, Any]) -> bool:
            harness.publish(topic, "sensor_msgs/BatteryState", message)
            return bool(recorder.values)

        node.subscribe("late", "", after, field="cell_voltage[1]")
        harness.wait_until(lambda: heard(after, "/late", {"cell_voltage": [3.5, 4.25]}))
        assert set(after.values) == {4.25}
        harness.publish("/early", "sensor_msgs/BatteryState", {"percentage": 0.5})
        node.subscribe("early", "", before, field="percentage")
        harness.wait_until(lambda: heard(before, "/early", {"percentage": 0.25}))
        assert set(before.values) <= {0.25, 0.5}

    def test_a_field_that_the_type_found_out_lacks_is_one_error_line(self, harness: Harness) -> None:
        heard = Recorder()
        harness.node("alert_system").subscribe("in", "", heard, field="percentage")

        def errors() -> list[str]:
            harness.publish("/in", FLOAT32, {"data": 1.0})
            return [line.text for line in harness.log_lines() if line.severity == Severity.ERROR]

        harness.wait_until(lambda: bool(errors()))
        harness.publish("/in", FLOAT32, {"data": 2.0})
        (error,) = errors()
        for text in ("/in", "percentage", "data"):
            assert text in error
        assert heard.values == []

    def test_a_whole_message_arrives_as_a_mapping(self, harness: Harness) -> None:
        heard = Recorder()
        harness.node("alert_system").subscribe("in", FLOAT32, heard)
        harness.publish("/in", FLOAT32, {"data": 1.5})
        harness.wait_until(lambda: [dict(value) for value in heard.values] == [{"data": 1.5}])

    def test_a_diagnostic_array_arrives_with_levels_as_ints(self, harness: Harness) -> None:
        heard = Recorder()
        harness.node("aggregator").subscribe("/diagnostics", DIAGNOSTICS, heard)
        header = {"stamp": {"sec": 42, "nanosec": 500_000_000}, "frame_id": "base"}
        harness.publish("/diagnostics", DIAGNOSTICS, {"header": header, "status": [STATUS]})
        harness.wait_until(lambda: len(heard.values) == 1)
        (array,) = heard.values
        assert array["status"] == [STATUS]
        assert type(array["status"][0]["level"]) is int
        assert stamp_s(array["header"]["stamp"]) == 42.5
        assert array["header"]["frame_id"] == "base"

    def test_a_diagnostic_array_is_published_and_stamped(self, harness: Harness) -> None:
        node = harness.node("aggregator")
        node.advertise("/diagnostics", DIAGNOSTICS)
        listened = harness.listen("/diagnostics", DIAGNOSTICS)
        harness.set_time(START_S + 0.5)
        status = {
            "level": 3,
            "name": "alert_system: battery_level",
            "message": "no sample for 6 s",
            "hardware_id": "robot1",
            "values": [{"key": "unit", "value": "%"}],
        }
        node.publish("/diagnostics", {"status": [status]})
        node.publish("/diagnostics", {"header": {"frame_id": "base"}, "status": []})
        harness.wait_until(lambda: len(listened) == 2)
        (heard,) = listened[0]["status"]
        assert {**heard, "level": level_of(heard)} == status
        assert [stamp_s(message["header"]["stamp"]) for message in listened] == [100.5, 100.5]
        assert listened[1]["header"]["frame_id"] == "base"

    @pytest.mark.parametrize("stamp", [{"sec": 7, "nanosec": 250_000_000}, {"secs": 7, "nsecs": 250_000_000}])
    def test_a_stamp_that_is_given_is_kept_in_either_spelling(self, harness: Harness, stamp: dict[str, int]) -> None:
        node = harness.node("aggregator")
        node.advertise("/diagnostics", DIAGNOSTICS)
        listened = harness.listen("/diagnostics", DIAGNOSTICS)
        node.publish("/diagnostics", {"header": {"stamp": stamp}, "status": []})
        harness.wait_until(lambda: [stamp_s(message["header"]["stamp"]) for message in listened] == [7.25])

    def test_byte_arrays_travel_as_base64_text(self, harness: Harness) -> None:
        node, heard = harness.node("camera"), Recorder()
        image = {"format": "png", "data": "AAECgP8="}
        node.subscribe("in", "sensor_msgs/CompressedImage", heard)
        harness.publish("/in", "sensor_msgs/CompressedImage", image)
        harness.wait_until(lambda: [value["data"] for value in heard.values] == ["AAECgP8="])

        node.advertise("out", "sensor_msgs/CompressedImage")
        listened = harness.listen("/out", "sensor_msgs/CompressedImage")
        node.publish("out", image)
        harness.wait_until(lambda: [bytes_of(m["data"]) for m in listened] == [b"\x00\x01\x02\x80\xff"])

    def test_fields_that_are_left_out_keep_their_defaults(self, harness: Harness) -> None:
        node = harness.node("alert_system")
        node.advertise("alerts", "diagnostic_msgs/DiagnosticStatus")
        listened = harness.listen("/alerts", "diagnostic_msgs/DiagnosticStatus")
        node.publish("alerts", {"name": "alert_system: temperature"})
        harness.wait_until(lambda: len(listened) == 1)
        (status,) = listened
        assert {**status, "level": level_of(status)} == {
            "level": 0,
            "name": "alert_system: temperature",
            "message": "",
            "hardware_id": "",
            "values": [],
        }

    @pytest.mark.parametrize("type_name", ["Float32", "std_msgs/", "a/b/c/d"])
    def test_an_invalid_type_name_is_refused(self, harness: Harness, type_name: str) -> None:
        node = harness.node("alert_system")
        with pytest.raises(ConfigError):
            node.advertise("out", type_name)
        with pytest.raises(ConfigError):
            node.subscribe("in", type_name, Recorder(), field="data")

    @pytest.mark.parametrize("type_name", ["std_msgs/Flota32", "std_msgs/msg/Flota32"])
    def test_an_unknown_type_of_a_standard_package_is_rejected(self, harness: Harness, type_name: str) -> None:
        node = harness.node("alert_system")
        with pytest.raises(ConfigError, match=type_name):
            node.advertise("out", type_name)
        with pytest.raises(ConfigError, match=type_name):
            node.subscribe("in", type_name, Recorder(), field="data")

    @pytest.mark.parametrize(
        ("type_name", "field", "there_are"),
        [
            ("std_msgs/Float32", "dat", ["data"]),
            ("std_msgs/Float32", "data.value", []),
            ("std_msgs/Float32", "data[0]", []),
            ("sensor_msgs/BatteryState", "percent", ["percentage", "voltage", "cell_voltage"]),
            ("sensor_msgs/BatteryState", "header.frame", ["frame_id", "stamp"]),
            ("diagnostic_msgs/DiagnosticArray", "status[0].lvl", ["level", "hardware_id"]),
            ("sensor_msgs/BatteryState", "cell_voltage[one]", []),
            ("sensor_msgs/BatteryState", 'cell_voltage["one"]', []),
            ("sensor_msgs/BatteryState", "header..frame_id", []),
        ],
    )
    def test_a_field_that_is_not_there_is_refused_with_those_that_are(
        self, harness: Harness, type_name: str, field: str, there_are: Sequence[str]
    ) -> None:
        with pytest.raises(ConfigError) as refusal:
            harness.node("alert_system", namespace="robot1").subscribe("in", type_name, Recorder(), field=field)
        for text in ("/robot1/in", type_name, field, *there_are):
            assert text in str(refusal.value)
        assert "\n" not in str(refusal.value)

    # Publishing and subscribing

    def test_publishing_without_advertising_is_an_error(self, harness: Harness) -> None:
        with pytest.raises(MessageError, match="/out"):
            harness.node("battery_sensor").publish("out", {"data": 1.0})

    @pytest.mark.parametrize("message", [{"data": "full"}, {"data": []}])
    def test_a_message_that_does_not_fit_its_type_is_an_error(self, harness: Harness, message: dict[str, Any]) -> None:
        node = harness.node("battery_sensor")
        node.advertise("out", FLOAT32)
        with pytest.raises(MessageError):
            node.publish("out", message)

    def test_a_message_with_a_field_that_its_type_lacks_is_an_error(self, harness: Harness) -> None:
        node = harness.node("battery_sensor")
        node.advertise("out", FLOAT32)
        with pytest.raises(MessageError, match="value"):
            node.publish("out", {"value": 1.0})

    def test_a_topic_has_listeners_while_there_are_subscribers(self, harness: Harness) -> None:
        node = harness.node("source")
        with pytest.raises(MessageError, match="/level"):
            node.has_listeners("level")
        node.advertise("level", FLOAT32)
        assert node.has_listeners("level") is not harness.knows_listeners
        other = harness.node("sink")
        subscription = other.subscribe("level", FLOAT32, lambda value, now_s: None)
        harness.wait_until(lambda: node.has_listeners("level"))
        other.unsubscribe(subscription)
        harness.wait_until(lambda: node.has_listeners("level") is not harness.knows_listeners)

    def test_advertising_twice_publishes_once(self, harness: Harness) -> None:
        node = harness.node("battery_sensor")
        node.advertise("out", FLOAT32)
        node.advertise("out", FLOAT32)
        listened = harness.listen("/out", FLOAT32)
        for number in (1.0, 2.0, 3.0):
            node.publish("out", {"data": number})
        harness.wait_until(lambda: len(listened) >= 3)
        assert [message["data"] for message in listened] == [1.0, 2.0, 3.0]

    def test_messages_arrive_in_order_with_the_time_of_their_arrival(self, harness: Harness) -> None:
        heard = Recorder()
        harness.node("alert_system").subscribe("in", FLOAT32, heard, field="data")
        for step in range(1, 6):
            harness.set_time(START_S + step / 4)
            for number in (step, step + 0.5):
                harness.publish("/in", FLOAT32, {"data": number})
            harness.wait_until(lambda expected=2 * step: len(heard.values) == expected)
        assert heard.values == [1, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5, 5.5]
        assert heard.times_s == [100.25, 100.25, 100.5, 100.5, 100.75, 100.75, 101.0, 101.0, 101.25, 101.25]

    def test_two_subscriptions_to_one_topic_both_hear_until_one_ends(self, harness: Harness) -> None:
        node, number, whole = harness.node("alert_system"), Recorder(), Recorder()
        ended = node.subscribe("in", FLOAT32, number, field="data")
        node.subscribe("in", FLOAT32, whole)
        harness.publish("/in", FLOAT32, {"data": 1.0})
        harness.wait_until(lambda: len(number.values) == 1 and len(whole.values) == 1)
        node.unsubscribe(ended)
        node.unsubscribe(ended)
        harness.publish("/in", FLOAT32, {"data": 2.0})
        harness.wait_until(lambda: len(whole.values) == 2)
        assert number.values == [1.0]

    def test_many_subscriptions_to_one_topic_each_get_their_field(self, harness: Harness) -> None:
        """In the order of creation; a failing timer does not affect the others."""
        battery = "sensor_msgs/BatteryState"
        node = harness.node("alert_system")
        recorders = {field: Recorder() for field in ("percentage", "voltage", "cell_voltage[1]")}
        failing, untyped, arrivals = Recorder(), Recorder(), Recorder()

        def fail(value: Any, now_s: float) -> None:
            failing(value, now_s)
            raise RuntimeError("in one of many")

        node.subscribe("in", battery, fail, field="current")
        subscriptions = {field: node.subscribe("in", battery, heard, field=field) for field, heard in recorders.items()}
        node.subscribe("in", "", untyped, field="voltage")
        node.subscribe("in", battery, arrivals, field=None)

        def publish(voltage: float) -> None:
            message = {"percentage": 0.5, "voltage": voltage, "current": -1.0, "cell_voltage": [3.5, 4.25]}
            harness.publish("/in", battery, message)

        def heard_from_the_start(voltage: float) -> bool:
            publish(voltage)
            return bool(untyped.values and recorders["percentage"].values and arrivals.values)

        harness.wait_until(lambda: heard_from_the_start(24.0))
        node.unsubscribe(subscriptions["voltage"])
        before = len(recorders["voltage"].values)
        publish(25.0)
        harness.wait_until(lambda: untyped.values[-1] == 25.0 and failing.values == [-1.0] * len(arrivals.values))
        assert set(recorders["percentage"].values) == {0.5}
        assert set(recorders["cell_voltage[1]"].values) == {4.25}
        assert recorders["voltage"].values == [24.0] * before
        assert set(arrivals.values) == {1.0}

    def test_several_publishers_may_share_a_topic(self, harness: Harness) -> None:
        node, heard = harness.node("alert_system"), Recorder()
        arrivals = Recorder()
        node.subscribe("in", FLOAT32, heard, field="data")
        node.subscribe("in", FLOAT32, arrivals, field=None)
        drivers = [harness.node(name) for name in ("front_driver", "rear_driver")]
        for driver in drivers:
            driver.advertise("/in", FLOAT32)

        def all_heard() -> bool:
            harness.publish("/in", FLOAT32, {"data": 1.0})
            for number, driver in enumerate(drivers):
                driver.publish("/in", {"data": 2.0 + number})
            return set(heard.values) == {1.0, 2.0, 3.0}

        harness.wait_until(all_heard)
        harness.wait_until(lambda: len(arrivals.values) == len(heard.values))

    def test_the_alert_node_watches_what_robots_publish(self, harness: Harness) -> None:
        """A BatteryState on a charger, another node's diagnostics, the frequency of a topic whose type is left out."""
        battery, waits = "sensor_msgs/BatteryState", {"stale_after_s": 600.0, "startup_grace_s": 600.0}
        driver = 'status["driver: left motor"]'
        signals = {
            "battery": {
                "type": battery, "field": "percentage", "scale": 100.0, "unit": "%", "warn_below": 20.0,
                "only_if": {"signal": "charging", "is_not": 1.0},
            },
            "charging": {"topic": "battery", "type": battery, "field": "power_supply_status"},
            "motor": {"topic": "/diagnostics", "type": DIAGNOSTICS, "field": f"{driver}.level", "error_above": 1.0},
            "motor_value": {
                "topic": "/diagnostics", "type": DIAGNOSTICS, "field": f'{driver}.values["value"]', "warn_above": 80.0,
            },
            "imu": {"field": "", "statistic": "frequency_hz", "warn_below": 5.0},
        }  # fmt: skip
        received: list[tuple[str, str]] = []
        configured = {"signals": {name: {**signal, **waits} for name, signal in signals.items()}}
        node = harness.node("alert_system", parameters=configured)
        AlertSystem(node, {"test": levels_to(received)})

        def hears(topic: str, type_name: str, message: Mapping[str, Any], signal: str, level: str) -> None:
            def heard() -> bool:
                harness.publish(topic, type_name, message)
                harness.set_time(node.now_s() + 1.0)
                return (signal, level) in received

            harness.wait_until(heard)

        hears("/battery", battery, {"percentage": 0.15, "power_supply_status": 2}, "battery", "WARN")
        hears("/battery", battery, {"percentage": 0.15, "power_supply_status": 1}, "battery", "OK")
        hears("/diagnostics", DIAGNOSTICS, {"status": [{**STATUS, "name": "other"}, STATUS]}, "motor", "ERROR")
        harness.wait_until(lambda: ("motor_value", "WARN") in received)
        hears("/imu", "sensor_msgs/Imu", {}, "imu", "WARN")
        assert [line for line in harness.log_lines() if "in a callback" in line.text] == []

    @pytest.mark.parametrize("names", [("alert_system", "second"), ("left", "right")])
    def test_two_alert_nodes_watch_the_diagnostics_of_each_other_without_feedback(
        self, harness: Harness, names: tuple[str, str]
    ) -> None:
        """One wildcard watches every driver; what the nodes publish themselves is no signal."""
        common = {"topic": "/diagnostics", "type": DIAGNOSTICS, "stale_after_s": 0.0}
        nodes = [
            harness.node(
                name,
                parameters={
                    "robot_name": name,
                    "signals": {
                        "drivers": {**common, "field": 'status["*"]'},
                        "peer": {**common, "field": f'status["{other}: monitor"].values["signals"]'},
                    },
                },
            )
            for name, other in (names, names[::-1])
        ]
        announced: list[tuple[str, str]] = []
        systems = [AlertSystem(node, {"test": levels_to(announced)}) for node in nodes]
        monitors = [system.monitor for system in systems]

        def report(level: int) -> None:
            harness.publish("/diagnostics", DIAGNOSTICS, {"status": [{**STATUS, "level": level}]})
            harness.set_time(nodes[0].now_s() + 1.0)

        def hear_each_other() -> bool:
            report(0)
            return all(monitor.fresh_value("peer") is not None for monitor in monitors)

        element = f"drivers[{STATUS['name']}]"
        harness.wait_until(hear_each_other)
        harness.wait_until(lambda: all(element in monitor.signals() for monitor in monitors))
        reports = harness.listen("/diagnostics", DIAGNOSTICS)
        for level, word in ((2, "ERROR"), (0, "OK"), (3, "STALE"), (1, "WARN"), (0, "OK")):
            before = len(announced)
            report(level)
            harness.wait_until(lambda before=before: len(announced) >= before + 2)
            assert announced[before:] == [(element, word)] * 2
            for _ in range(3):
                report(level)
        assert [list(monitor.signals()) for monitor in monitors] == [["drivers", element, "peer"]] * 2
        assert len(announced) == 10
        # The three signals and the node itself; after a transition, one of them.
        harness.wait_until(lambda: len(reports) >= 40)
        assert max(len(message["status"]) for message in reports) == 4

    @pytest.mark.parametrize(
        ("example", "topic", "type_name", "message", "signal"),
        [
            ("thresholds", "/battery_level", FLOAT32, {"data": 15.0}, "battery_level"),
            ("differential_drive", "/battery_state", "sensor_msgs/BatteryState", {"voltage": 22.0}, "battery_voltage"),
            (
                "differential_drive",
                "/imu/temperature",
                "sensor_msgs/Temperature",
                {"temperature": 75.0},
                "imu_temperature",
            ),
            ("raspberry_pi", "/memory", FLOAT32, {"data": 90.0}, "memory"),
            ("mixed_fleet", "/battery_state", "sensor_msgs/BatteryState", {"percentage": 0.2}, "battery"),
            (
                "battery_and_joints",
                "/battery_state",
                "sensor_msgs/BatteryState",
                {"cell_voltage": [3.7, 3.1]},
                "weakest_cell",
            ),
        ],
    )
    def test_the_alert_node_runs_the_examples(
        self, harness: Harness, example: str, topic: str, type_name: str, message: Mapping[str, Any], signal: str
    ) -> None:
        pytest.importorskip("yaml")
        file = CONFIG / f"{example}.yaml"
        tree = find_section(read_yaml(file).tree, "alert_system").tree
        received: list[tuple[str, str]] = []
        node = harness.node("alert_system", parameters=tree)
        AlertSystem(node, {"test": levels_to(received)})

        def warned() -> bool:
            harness.publish(topic, type_name, message)
            harness.set_time(node.now_s() + 0.5)
            return (signal, "WARN") in received

        harness.wait_until(warned)
        assert [line for line in harness.log_lines() if "in a callback" in line.text] == []

    def test_what_the_nodes_of_this_package_publish_is_known_by_its_publisher(self, harness: Harness) -> None:
        """The driver's /battery_level is the robot's, that of a battery_sensor is not, whatever it is called."""
        remap = {"temperature": "/board"}
        sensor = harness.node("power", namespace="own", parameters={"cpu_usage": {"source": "none"}}, remap=remap)
        aggregator = harness.node("aggregator", namespace="own", parameters={"inputs": ["battery_level"]})
        BatterySensor(sensor)
        Aggregator(aggregator)
        AlertSystem(harness.node("alert_system", namespace="own"))
        robots = ["/battery_level", "/own/cpu_usage"]
        own = [
            "/board",
            *(f"/own/{name}" for name in ("_simulated_sensors", "alerts", "battery_level", "system_health")),
        ]
        candidates = Candidates()
        candidates.add(Topic(topic, FLOAT32, None) for topic in (*robots, *own))
        candidates.add([Topic("/diagnostics", DIAGNOSTICS, None)])
        candidates.listen(harness.node("init"), ["/diagnostics"])

        def known() -> bool:
            harness.publish("/diagnostics", DIAGNOSTICS, {"status": [STATUS]})
            harness.set_time(sensor.now_s() + 1.0)
            return candidates.own_topics >= set(own)

        harness.wait_until(known)
        assert candidates.own_topics == {TICKS, *own}
        not_watched = propose(candidates).not_watched
        assert [topic for topic, why in not_watched.items() if why == "published by this monitor"] == sorted(own)

    def test_nodes_hear_one_another(self, harness: Harness) -> None:
        sensor, monitor = harness.node("battery_sensor"), harness.node("alert_system")
        monitor.advertise("alerts", FLOAT32)
        listened = harness.listen("/alerts", FLOAT32)
        monitor.subscribe("in", FLOAT32, lambda value, now_s: monitor.publish("alerts", {"data": -value}), field="data")
        sensor.advertise("in", FLOAT32)

        def heard_back() -> bool:
            sensor.publish("in", {"data": 5.0})
            return bool(listened)

        harness.wait_until(heard_back)
        assert listened[0]["data"] == -5.0

    def test_callbacks_may_change_what_their_node_does(self, harness: Harness) -> None:
        """A node whose configuration changes does this: from within a callback it leaves and joins topics."""
        node, first, second = harness.node("alert_system"), Recorder(), Recorder()

        def move(value: Any, now_s: float) -> None:
            node.unsubscribe(subscription)
            node.subscribe("second", FLOAT32, second, field="data")
            node.create_timer(0.5, timers.append)
            first(value, now_s)

        timers: list[float] = []
        subscription = node.subscribe("first", FLOAT32, move, field="data")
        harness.publish("/first", FLOAT32, {"data": 1.0})
        harness.wait_until(lambda: first.values == [1.0])
        harness.publish("/second", FLOAT32, {"data": 2.0})
        harness.wait_until(lambda: second.values == [2.0])
        harness.set_time(START_S + 0.5)
        harness.wait_until(lambda: timers == [100.5])

    def test_a_message_from_before_the_first_clock_message_waits_for_it(self, harness: Harness) -> None:
        heard = Recorder()
        node = harness.node("alert_system")
        listened = harness.listen("/in", FLOAT32)  # first, since rospy calls back one after the other
        node.subscribe("in", FLOAT32, heard, field="data")
        harness.set_time(0.0)
        harness.publish("/in", FLOAT32, {"data": 19.5})
        harness.wait_until(lambda: len(listened) == 1)
        assert heard.values == []
        harness.set_time(START_S)
        harness.wait_until(lambda: heard.values == [19.5])
        assert heard.times_s == [START_S]

    # Missing samples

    def test_a_topic_without_a_publisher_is_named_as_resolved(self, harness: Harness) -> None:
        node = harness.node("alert_system", namespace="robot1", remap={"battery": "/power/battery"})
        for topic, resolved in (("battery", "/power/battery"), ("pressure", "/robot1/pressure")):
            node.subscribe(topic, FLOAT32, Recorder(), field="data")
            self._wait_for_hint(harness, node, topic, FLOAT32, f"no publisher on {resolved}")

    def test_a_topic_of_another_type_gives_both_types(self, harness: Harness) -> None:
        self._publish_until_heard(harness, "/battery", "sensor_msgs/Temperature", "temperature")
        text = "/battery is published as sensor_msgs/Temperature, configured as std_msgs/Float32"
        for type_name in (FLOAT32, "std_msgs/msg/Float32"):
            self._wait_for_hint(harness, harness.node("alert_system"), "battery", type_name, text)

    @pytest.mark.parametrize(
        ("topic", "type_name", "existing"),
        [
            ("battery", FLOAT32, "/battery_state"),  # part of the name
            ("/robot1/battery_state", "sensor_msgs/BatteryState", "/battery_state"),  # another namespace
            ("batery_state", "sensor_msgs/BatteryState", "/battery_state"),  # a typing mistake
            ("power", "sensor_msgs/BatteryState", "/battery_state"),  # the type
        ],
    )
    def test_a_topic_that_may_be_meant_is_named(
        self, harness: Harness, topic: str, type_name: str, existing: str
    ) -> None:
        self._publish_until_heard(harness, existing, "sensor_msgs/BatteryState", "percentage")
        node = harness.node("alert_system")
        resolved = node.subscribe(topic, type_name, Recorder(), field=None).topic
        text = f"no publisher on {resolved}; {existing} exists"
        self._wait_for_hint(harness, node, topic, type_name, text)

    def test_a_topic_that_is_only_subscribed_to_is_not_meant(self, harness: Harness) -> None:
        self._publish_until_heard(harness, "/temperature", "sensor_msgs/Temperature", "temperature")
        node = harness.node("alert_system")
        for topic in ("battery_state", "battery_current"):
            node.subscribe(topic, "", Recorder(), field=None)
        self._wait_for_hint(harness, node, "battery", FLOAT32, "no publisher on /battery")

    def test_a_topic_with_a_publisher_of_the_type_gives_no_hint(self, harness: Harness) -> None:
        self._publish_until_heard(harness, "/battery", FLOAT32, "data")
        node = harness.node("alert_system")
        for type_name in (FLOAT32, "std_msgs/msg/Float32", ""):
            assert node.why_silent("battery", type_name) is None
        self._wait_for_hint(harness, node, "elsewhere", FLOAT32, "no publisher on /elsewhere")  # so all have answers
        for type_name in (FLOAT32, "std_msgs/msg/Float32", ""):
            assert node.why_silent("battery", type_name) is None

    def test_the_line_of_a_signal_without_samples_ends_with_the_reason(self, harness: Harness) -> None:
        self._publish_until_heard(harness, "/battery_state", "sensor_msgs/BatteryState", "percentage")
        signals = {"battery": {"type": FLOAT32, "startup_grace_s": 100_000.0}}
        node = harness.node("alert_system", parameters={"robot_name": "robot1", "signals": signals})
        monitor = AlertSystem(node).monitor
        harness.set_time(START_S + 1.0)
        harness.wait_until(lambda: bool(monitor.signals()))
        times_s, hint = itertools.count(START_S + 60_000.0), "no publisher on /battery; /battery_state exists"

        def has_hint() -> bool:
            harness.set_time(next(times_s))  # the answer may come after some ticks
            known = monitor.status("battery", 0.0)
            return known is not None and known.hint == hint

        harness.wait_until(has_hint)
        harness.set_time(START_S + 100_002.0)

        def lines() -> list[str]:
            return [line.text for line in harness.log_lines() if line.text.startswith("battery STALE: ")]

        harness.wait_until(lambda: bool(lines()))
        (line,) = lines()
        assert line.endswith(f" [{hint}]")

    def test_nodes_and_endpoints_that_come_and_go_are_judged(self, harness: Harness) -> None:
        given = {
            "driver": {"node": "lidar_driver"},
            "scan": {"publishers": "/graph/scan"},
            "cmd": {"subscribers": "/graph/c*"},
        }
        absent = ["node /lidar_driver is not there", "no publisher on /graph/scan", "no subscriber on /graph/c*"]
        there = ["node /lidar_driver is there", "1 publisher on /graph/scan", "1 subscriber on /graph/c*"]
        first = 1 if self.is_one_node_per_process else 0  # whose nodes are there as long as the process
        signals = {name: {**given[name], "startup_grace_s": 1.0} for name in list(given)[first:]}
        node = harness.node("alert_system", parameters={"signals": signals})
        for topic in ("/graph/cmd", "/graph/scan"):
            node.subscribe(topic, FLOAT32, Recorder())  # its own endpoints are not counted
        monitor = AlertSystem(node).monitor
        times_s = itertools.count(START_S + 2.0)

        def reads(texts: list[str]) -> bool:
            harness.set_time(next(times_s))
            return [status.message for status in monitor.report(0.0).statuses.values()] == texts[first:]

        if not self.knows_graph:
            lines = [line.text for line in harness.log_lines()]
            assert sum(line.startswith("scan is not watched: ") for line in lines) == 1
            assert not monitor.report(0.0).statuses
            return
        harness.wait_until(lambda: reads(absent))
        driver = self.other_node(harness, "lidar_driver")
        driver.advertise("/graph/scan", FLOAT32)
        if self.is_one_node_per_process:
            there[2] = absent[2]
        else:
            driver.subscribe("/graph/cmd", FLOAT32, Recorder())
        harness.wait_until(lambda: reads(there))
        driver.close()
        harness.wait_until(lambda: reads(absent))

    def test_names_of_the_graph_are_resolved_and_remapped_but_patterns_are_not(self, harness: Harness) -> None:
        if not self.knows_graph:
            return
        keys = {"here": "scan", "elsewhere": "other", "every": "scan*"}
        signals = {name: {"publishers": topic} for name, topic in keys.items()}
        node = harness.node(
            "alert_system", namespace="robot1", parameters={"signals": signals}, remap={"scan": "/front"}
        )
        configured = AlertSystem(node).configuration.signals
        names = {name: signal.publishers for name, signal in configured.items()}
        assert names == {"here": "/front", "elsewhere": "/robot1/other", "every": "/robot1/scan*"}

    def test_the_hint_of_a_silent_topic_names_the_node_that_is_gone(self, harness: Harness) -> None:
        if self.is_one_node_per_process or not self.knows_graph:
            return  # test_master.py of ROS 1 kills a process
        node, driver, heard = harness.node("alert_system"), self.other_node(harness, "lidar_driver"), Recorder()
        node.subscribe("/graph/scan", FLOAT32, heard, field="data")
        driver.advertise("/graph/scan", FLOAT32)

        def is_heard() -> bool:
            driver.publish("/graph/scan", {"data": 1.0})
            return bool(heard.values)

        harness.wait_until(is_heard)
        other = "/graph/scan is published as std_msgs/Float32, configured as std_msgs/String"
        self._wait_for_hint(harness, node, "/graph/scan", "std_msgs/String", other)
        driver.close()
        self._wait_for_hint(harness, node, "/graph/scan", FLOAT32, "node /lidar_driver is gone")

    @staticmethod
    def _publish_until_heard(harness: Harness, topic: str, type_name: str, field: str) -> None:
        """Publishes a number; returns when another node has received it, so that the publisher is known everywhere."""
        heard = Recorder()
        harness.node("listener").subscribe(topic, type_name, heard, field=field)
        harness.publish(topic, type_name, {field: 0.5})
        harness.wait_until(lambda: heard.values == [0.5])

    @staticmethod
    def _wait_for_hint(harness: Harness, node: Middleware, topic: str, type_name: str, text: str) -> None:
        """Waits for an answer; one that still has to do with an earlier test is corrected after 10 s."""
        harness.wait_until(lambda: node.why_silent(topic, type_name) == text)

    # Services

    def test_a_service_answers_every_call(self, harness: Harness) -> None:
        requests: list[Mapping[str, Any]] = []

        def count(request: Mapping[str, Any]) -> Mapping[str, Any]:
            requests.append(request)
            return {"success": len(requests) > 1, "message": f"call {len(requests)}"}

        harness.node("alert_system").advertise_service("~reset", TRIGGER, count)
        responses = [dict(harness.call("/alert_system/reset", TRIGGER)) for _ in range(2)]
        assert responses == [{"success": False, "message": "call 1"}, {"success": True, "message": "call 2"}]
        assert [dict(request) for request in requests] == [{}, {}]

    def test_requests_arrive_as_mappings(self, harness: Harness) -> None:
        harness.node("alert_system").advertise_service(
            "~enable", "std_srvs/SetBool", lambda request: {"success": request["data"], "message": "seen"}
        )
        assert harness.call("/alert_system/enable", "std_srvs/SetBool", {"data": True})["success"] is True
        assert harness.call("/alert_system/enable", "std_srvs/SetBool", {"data": False})["success"] is False

    def test_a_service_that_fails_is_logged_and_answers_the_next_call(self, harness: Harness) -> None:
        calls: list[int] = []

        def fail_once(request: Mapping[str, Any]) -> Mapping[str, Any]:
            calls.append(len(calls))
            if len(calls) == 1:
                raise RuntimeError("the first call always fails")
            return {"success": True, "message": "fine"}

        harness.node("alert_system").advertise_service("~reset", TRIGGER, fail_once)
        try:
            assert harness.call("/alert_system/reset", TRIGGER)["success"] is False
        except ServiceFailed:
            pass
        self._wait_for_error(harness, "the first call always fails")
        assert harness.call("/alert_system/reset", TRIGGER)["message"] == "fine"

    # Time

    def test_a_timer_calls_back_after_each_period(self, harness: Harness) -> None:
        node, times_s = harness.node("aggregator"), []  # type: ignore[var-annotated]
        assert node.now_s() == START_S
        node.create_timer(1.0, times_s.append)
        for step, calls in ((100.5, 0), (101.0, 1), (101.75, 1), (102.0, 2), (103.0, 3)):
            harness.set_time(step)
            assert node.now_s() == step
            harness.wait_until(lambda expected=calls: len(times_s) >= expected)
        assert times_s == [101.0, 102.0, 103.0]

    def test_time_that_jumps_ahead_gives_one_call_and_keeps_the_beat(self, harness: Harness) -> None:
        times_s: list[float] = []
        harness.node("aggregator").create_timer(1.0, times_s.append)
        for step, calls in ((110.5, 1), (110.75, 1), (111.0, 2), (112.0, 3)):
            harness.set_time(step)
            harness.wait_until(lambda expected=calls: len(times_s) >= expected)
        assert times_s == [110.5, 111.0, 112.0]

    def test_time_that_goes_back_restarts_the_period_again_and_again(self, harness: Harness) -> None:
        """A looped bag: its clock goes back at every round."""
        node, times_s = harness.node("aggregator"), []  # type: ignore[var-annotated]
        node.create_timer(1.0, times_s.append)
        for past_rounds in range(3):
            for step, calls in ((50.25, 0), (51.0, 0), (51.25, 1), (52.25, 2)):
                harness.set_time(step)
                assert node.now_s() == step
                harness.wait_until(lambda expected=2 * past_rounds + calls: len(times_s) >= expected)
        assert times_s == [51.25, 52.25] * 3

    def test_a_timer_can_be_cancelled_twice_and_from_its_own_callback(self, harness: Harness) -> None:
        node, once, others = harness.node("aggregator"), [], []  # type: ignore[var-annotated]

        def cancel(now_s: float) -> None:
            once.append(now_s)
            timer.cancel()

        timer = node.create_timer(1.0, cancel)
        cancelled = node.create_timer(1.0, once.append)
        cancelled.cancel()
        node.create_timer(1.0, others.append)
        for step in (101.0, 102.0, 103.0):
            harness.set_time(step)
            harness.wait_until(lambda now_s=step: bool(others) and others[-1] == now_s)
        timer.cancel()
        assert once == [101.0]

    def test_the_default_clock_never_goes_back_and_drives_timers(self, harness: Harness) -> None:
        node, times_s = harness.node("battery_sensor", sim_time=False), []  # type: ignore[var-annotated]
        start_s = node.now_s()
        node.create_timer(0.05, times_s.append)
        harness.wait_until(lambda: len(times_s) >= 4)
        node.close()
        assert times_s == sorted(times_s)
        assert times_s[0] >= start_s + 0.04

    # Callbacks

    def test_callbacks_of_a_node_never_run_at_the_same_time(self, harness: Harness) -> None:
        node = harness.node("alert_system")
        inside, done, overlap = threading.Event(), threading.Event(), threading.Event()

        def linger(value: Any, now_s: float) -> None:
            inside.set()
            overlap.wait(0.3)
            inside.clear()
            done.set()

        def note(*arguments: Any) -> None:
            if inside.is_set():
                overlap.set()

        node.subscribe("slow", FLOAT32, linger, field="data")
        node.subscribe("fast", FLOAT32, note, field="data")
        node.create_timer(0.25, note)
        harness.publish("/fast", FLOAT32, {"data": 0.0})
        harness.publish("/slow", FLOAT32, {"data": 0.0})
        for step in range(1, 5):
            harness.publish("/fast", FLOAT32, {"data": float(step)})
            harness.set_time(START_S + step / 4)
        harness.wait_until(done.is_set)
        assert not overlap.is_set()

    def test_another_thread_can_keep_callbacks_from_running(self, harness: Harness) -> None:
        node = harness.node("alert_system")
        entered, leave = threading.Event(), threading.Event()
        calls: list[str] = []

        def linger() -> str:
            entered.set()
            leave.wait(10.0)
            calls.append("outside")
            return "result"

        def release(value: Any, now_s: float) -> None:
            calls.append("callback")

        results: list[str] = []
        thread = threading.Thread(target=lambda: results.append(node.exclusively(linger)))
        node.subscribe("fast", FLOAT32, release, field="data")
        thread.start()
        assert entered.wait(10.0)
        threading.Timer(0.2, leave.set).start()  # publishing may wait for the callback
        harness.publish("/fast", FLOAT32, {"data": 0.0})
        harness.wait_until(lambda: len(calls) == 2)
        thread.join(10.0)
        assert calls == ["outside", "callback"]
        assert results == ["result"]
        with pytest.raises(ZeroDivisionError):
            node.exclusively(lambda: 1 / 0)

    def test_a_callback_that_raises_is_one_error_line_and_ends_nothing(self, harness: Harness) -> None:
        node, heard, times_s = harness.node("alert_system"), Recorder(), []  # type: ignore[var-annotated]

        def fail(value: Any, now_s: float) -> None:
            raise RuntimeError(f"cannot bear {value}")

        node.subscribe("in", FLOAT32, fail, field="data")
        node.subscribe("in", FLOAT32, heard, field="data")
        node.create_timer(1.0, times_s.append)
        harness.publish("/in", FLOAT32, {"data": 1.0})
        self._wait_for_error(harness, "cannot bear 1.0")
        harness.publish("/in", FLOAT32, {"data": 2.0})
        self._wait_for_error(harness, "cannot bear 2.0")
        harness.wait_until(lambda: heard.values == [1.0, 2.0])
        harness.set_time(START_S + 1.0)
        harness.wait_until(lambda: times_s == [101.0])
        errors = [line for line in harness.log_lines() if line.severity == Severity.ERROR]
        assert len(errors) == 2
        assert all("RuntimeError" in line.text and "\n" not in line.text for line in errors)

    def test_a_timer_that_raises_keeps_running(self, harness: Harness) -> None:
        times_s: list[float] = []

        def fail(now_s: float) -> None:
            times_s.append(now_s)
            raise RuntimeError(f"not at {now_s:g}")

        harness.node("alert_system").create_timer(1.0, fail)
        for step in (101.0, 102.0):
            harness.set_time(step)
            harness.wait_until(lambda now_s=step: times_s[-1:] == [now_s])
            self._wait_for_error(harness, f"not at {step:g}")

    # Parameters

    def test_a_node_gets_the_parameters_that_were_given(self, harness: Harness) -> None:
        given = {
            "publish_rate": 2.0,
            "sensor_name": "front",
            "seed": 7,
            "latch": True,
            "signals": {"battery_level": {"warn_below": 20.0, "unit": "%"}, "temperature": {"warn_above": 80.0}},
        }
        assert plain(harness.node("alert_system", parameters=given).given_parameters()) == plain(given)
        assert plain(harness.node("aggregator").given_parameters()) == {}
        assert plain(harness.node("alert_system", namespace="robot1").given_parameters()) == {}

    def test_a_change_reaches_the_node_as_the_whole_tree(self, harness: Harness) -> None:
        given = {"publish_rate": 2.0, "signals": {"battery_level": {"warn_below": 20.0}}}
        node = harness.node("alert_system", parameters=given)
        refusing = RefusingNode(node)
        assert harness.propose(node, "signals.battery_level.warn_below", 30.0) == ""
        expected = {"publish_rate": 2.0, "signals": {"battery_level": {"warn_below": 30.0}}}
        assert [plain(tree) for tree in refusing.trees] == [plain(expected)]
        assert plain(node.given_parameters()) == plain(expected)

    def test_a_parameter_that_was_left_out_can_be_given_later(self, harness: Harness) -> None:
        node = harness.node("alert_system", parameters={"publish_rate": 2.0})
        refusing = RefusingNode(node)
        assert harness.propose(node, "signals.battery_level.warn_below", 15.0) == ""
        assert refusing.trees[-1]["signals"]["battery_level"]["warn_below"] == 15.0

    def test_a_refused_change_gives_the_reason_and_keeps_the_old_values(self, harness: Harness) -> None:
        node = harness.node("alert_system", parameters={"publish_rate": 2.0})
        refusing = RefusingNode(node)
        reason = harness.propose(node, "publish_rate", 1000.0)
        assert "publish_rate" in reason and "100" in reason
        assert refusing.trees == []
        assert plain(node.given_parameters()) == {"publish_rate": 2.0}
        assert harness.propose(node, "publish_rate", 5.0) == ""
        assert refusing.trees[-1]["publish_rate"] == 5.0

    def test_a_change_that_the_node_fails_on_is_refused_and_logged(self, harness: Harness) -> None:
        def fail(tree: Mapping[str, Any]) -> str:
            raise RuntimeError("cannot change now")

        node = harness.node("alert_system", parameters={"publish_rate": 2.0})
        node.declare_parameters([RefusingNode.RATE], fail)
        assert "cannot change now" in harness.propose(node, "publish_rate", 5.0)
        self._wait_for_error(harness, "cannot change now")
        assert plain(node.given_parameters()) == {"publish_rate": 2.0}

    # Logging and leaving

    def test_log_lines_keep_their_severity_and_text(self, harness: Harness) -> None:
        node = harness.node("alert_system")
        lines = [
            (Severity.INFO, "started"),
            (Severity.WARN, "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)"),
            (Severity.ERROR, "{braces} and %d percent signs %s"),
            (Severity.FATAL, "degrees \N{DEGREE SIGN}C"),
        ]
        for severity, text in lines:
            node.log(severity, text)
        harness.wait_until(lambda: len([line for line in harness.log_lines() if line in lines]) == 4)
        assert [line for line in harness.log_lines() if line in lines] == lines

    def test_after_close_nothing_calls_back(self, harness: Harness) -> None:
        node, closed, times_s = harness.node("alert_system"), Recorder(), []  # type: ignore[var-annotated]
        node.subscribe("in", FLOAT32, closed, field="data")
        node.create_timer(1.0, times_s.append)
        node.advertise_service("~reset", TRIGGER, lambda request: {"success": True, "message": ""})
        other, heard, other_times_s = harness.node("aggregator"), Recorder(), []  # type: ignore[var-annotated]
        other.subscribe("in", FLOAT32, heard, field="data")
        other.create_timer(1.0, other_times_s.append)
        harness.publish("/in", FLOAT32, {"data": 1.0})
        harness.wait_until(lambda: closed.values == [1.0] and heard.values == [1.0])

        node.close()
        node.close()
        harness.publish("/in", FLOAT32, {"data": 2.0})
        harness.wait_until(lambda: heard.values == [1.0, 2.0])
        harness.set_time(START_S + 1.0)
        harness.wait_until(lambda: other_times_s == [101.0])
        with pytest.raises(ServiceFailed):
            harness.call("/alert_system/reset", TRIGGER)
        assert closed.values == [1.0]
        assert times_s == []

    def test_a_node_may_close_itself_from_its_own_callback(self, harness: Harness) -> None:
        node, heard = harness.node("alert_system"), Recorder()

        def leave(now_s: float) -> None:
            node.close()
            left.set()

        left = threading.Event()
        node.subscribe("in", FLOAT32, heard, field="data")
        node.create_timer(1.0, leave)
        harness.set_time(START_S + 1.0)
        harness.wait_until(left.is_set)
        other, also = harness.node("aggregator"), Recorder()
        other.subscribe("in", FLOAT32, also, field="data")
        harness.publish("/in", FLOAT32, {"data": 1.0})
        harness.wait_until(lambda: also.values == [1.0])
        assert heard.values == []

    def test_a_node_can_come_back_under_its_name(self, harness: Harness) -> None:
        for message in ("first", "second"):
            node, heard = harness.node("alert_system"), Recorder()
            node.subscribe("in", FLOAT32, heard, field="data")
            node.advertise("out", FLOAT32)
            node.advertise_service("~reset", TRIGGER, lambda request, m=message: {"success": True, "message": m})
            RefusingNode(node)
            harness.publish("/in", FLOAT32, {"data": 1.0})
            harness.wait_until(lambda values=heard.values: values == [1.0])
            assert harness.call("/alert_system/reset", TRIGGER)["message"] == message
            node.close()

    @staticmethod
    def _wait_for_error(harness: Harness, text: str) -> None:
        harness.wait_until(
            lambda: any(text in line.text and line.severity == Severity.ERROR for line in harness.log_lines())
        )
