"""The in-process middleware keeps the port's promises, and its own about virtual time."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence

import pytest
from port_conformance import FLOAT32, START_S, LogLine, PortConformance, Recorder, ServiceFailed, changed, poll_until

from robot_health_monitor.core.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.parameters import ConfigError


class LocalHarness:
    """A bus in virtual time."""

    knows_types = False

    def __init__(self) -> None:
        self.bus = LocalBus(START_S)
        self._outside = self.bus.node("outside")
        self._nodes: List[LocalMiddleware] = []
        self._tick_s = 0.0

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Optional[Mapping[str, Any]] = None,
        remap: Optional[Mapping[str, str]] = None,
        sim_time: bool = True,
    ) -> LocalMiddleware:
        self._tick_s = 0.0 if sim_time else 0.01
        node = self.bus.node(name, namespace=namespace, parameters=parameters, remap=remap)
        self._nodes.append(node)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        self._outside.advertise(topic, type_name)
        self._outside.publish(topic, message)

    def listen(self, topic: str, type_name: str) -> List[Mapping[str, Any]]:
        messages: List[Mapping[str, Any]] = []
        self._outside.subscribe(topic, type_name, lambda message, now_s: messages.append(message))
        return messages

    def call(self, service: str, type_name: str, request: Optional[Mapping[str, Any]] = None) -> Mapping[str, Any]:
        try:
            return self.bus.call_service(service, request)
        except ValueError as error:
            raise ServiceFailed(str(error)) from error

    def propose(self, node: LocalMiddleware, name: str, value: object) -> str:
        try:
            node.set_parameter(name, value)
        except ConfigError as error:
            return str(error)
        return ""

    def set_time(self, now_s: float) -> None:
        self.bus.run_due(now_s)

    def log_lines(self) -> Sequence[LogLine]:
        return [LogLine(line.severity, line.text) for line in self.bus.log_lines]

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        poll_until(predicate, lambda: self.bus.run_due(self.bus.now_s + self._tick_s), deadline_s=1.0)

    def close(self) -> None:
        for node in (*self._nodes, self._outside):
            node.close()


class TestLocal(PortConformance):
    @pytest.fixture
    def harness(self) -> LocalHarness:
        return LocalHarness()

    def test_time_that_jumps_ahead_gives_one_call_and_keeps_the_beat(self, harness: LocalHarness) -> None:
        """Here each period is called at its own time: a test in virtual time may jump without losing a beat."""
        times_s: List[float] = []
        harness.node("aggregator").create_timer(1.0, times_s.append)
        harness.set_time(103.5)
        assert times_s == [101.0, 102.0, 103.0]


def test_log_lines_name_their_node_and_time() -> None:
    bus = LocalBus(5.0)
    bus.node("alert_system", namespace="robot1").log(Severity.WARN, "low")
    assert bus.log_lines == [(5.0, "/robot1/alert_system", Severity.WARN, "low")]


def test_log_lines_can_go_elsewhere() -> None:
    lines: List[Any] = []
    bus = LocalBus(on_log=lines.append)
    bus.node("alert_system").log(Severity.INFO, "started")
    assert [line.text for line in lines] == ["started"]
    assert bus.log_lines == []


def test_timers_are_called_in_the_order_of_their_times() -> None:
    bus, calls = LocalBus(), []  # type: ignore[var-annotated]
    node = bus.node("aggregator")
    node.create_timer(1.0, lambda now_s: calls.append(("slow", now_s)))
    node.create_timer(0.4, lambda now_s: calls.append(("fast", now_s)))
    bus.run_due(1.0)
    assert calls == [("fast", 0.4), ("fast", 0.8), ("slow", 1.0)]
    assert bus.next_due_s() == pytest.approx(1.2)


def test_the_next_due_time_skips_cancelled_timers() -> None:
    bus = LocalBus()
    timer = bus.node("aggregator").create_timer(1.0, lambda now_s: None)
    assert bus.next_due_s() == 1.0
    timer.cancel()
    assert bus.next_due_s() is None


def test_the_bus_knows_the_types_of_its_topics() -> None:
    bus = LocalBus()
    node = bus.node("battery_sensor")
    node.advertise("battery_level", FLOAT32)
    node.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray", Recorder())
    assert bus.types == {"/battery_level": FLOAT32, "/diagnostics": "diagnostic_msgs/DiagnosticArray"}


def test_a_number_too_large_for_32_bits_becomes_infinity() -> None:
    bus, heard = LocalBus(), Recorder()
    node = bus.node("battery_sensor")
    node.subscribe("out", FLOAT32, heard, field="data")
    node.advertise("out", FLOAT32)
    node.publish("out", {"data": 1e39})
    node.publish("out", {"data": -1e39})
    assert heard.values == [float("inf"), float("-inf")]


def test_a_service_that_nobody_offers_says_which_there_are() -> None:
    bus = LocalBus()
    with pytest.raises(ValueError, match="there are none"):
        bus.call_service("/reset")
    bus.node("alert_system").advertise_service("~reset", "std_srvs/Trigger", lambda request: {})
    with pytest.raises(ValueError, match="there are /alert_system/reset"):
        bus.call_service("/reset")


def test_a_whole_configuration_can_be_proposed() -> None:
    proposed: List[Mapping[str, Any]] = []
    node = LocalBus().node("alert_system", parameters={"publish_rate": 2.0})
    node.declare_parameters([], proposed.append)
    tree: Dict[str, Any] = {"publish_rate": 3.0}
    node.set_parameters(tree)
    assert proposed == [tree]
    assert node.given_parameters() == tree
    assert changed(tree, "signals.battery_level.warn_below", 10.0) == {
        "publish_rate": 3.0,
        "signals": {"battery_level": {"warn_below": 10.0}},
    }
