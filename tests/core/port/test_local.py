"""The in-process middleware keeps the port's promises, and its own about virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import pytest
from harness.bad_input import BAD_INPUT
from harness.equivalence import Equivalence
from harness.field_timeline import FIELDS, Scene
from harness.local import LocalHarness
from harness.port_conformance import FLOAT32, PortConformance, Recorder
from harness.raw_conformance import RawConformance
from harness.silence import SILENCE

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ServiceError


class TestLocal(RawConformance, PortConformance):
    @pytest.fixture
    def harness(self) -> LocalHarness:
        return LocalHarness()


SCENES = [(FIELDS, "field_alerts.txt"), (BAD_INPUT, "bad_input_alerts.txt"), (SILENCE, "silence_alerts.txt")]


class TestEquivalence(Equivalence):
    """The reference itself: its lines were written by hand, from docs/rules.md and the timeline."""

    @pytest.fixture
    def harness(self) -> LocalHarness:
        return LocalHarness()

    def test_the_reference_gives_the_values_worked_out_by_hand(self, harness: LocalHarness) -> None:
        assert [str(line) for line in self.replay(harness)] == EXPECTED

    @pytest.mark.parametrize(("scene", "file"), SCENES)
    def test_the_reference_of_the_fields_gives_the_values_worked_out_by_hand(
        self, harness: LocalHarness, scene: Scene, file: str
    ) -> None:
        """Each file has the transitions, then the faults; lines with # are comments."""
        judged = self.publish(harness, scene)
        expected = (DATA / file).read_text(encoding="utf-8").splitlines()
        found = [*map(str, judged.transitions), *judged.faults]
        assert found == [line for line in expected if not line.startswith("#")]


DATA = Path(__file__).parents[2] / "data"

EXPECTED = [
    "103.500 battery_level WARN: 19.5 % is below 20 % (was OK for 3 s)",
    "105.500 battery_level ERROR: 9.5 % is below 10 % (was WARN for 2 s)",
    "106.500 battery_level WARN: 12 % is below 20 % (was ERROR for 1 s)",
    "107.000 temperature WARN: 82 degC is above 80 degC (was OK for 6.5 s)",
    "109.250 battery_level ERROR: invalid data: nan (was WARN for 2.75 s)",
    "111.000 temperature WARN: 74 degC is no longer above 80 degC, "
    "still firing until keep_firing_for_s has passed (for 4 s)",
    "111.500 battery_level OK: 50 % (was ERROR for 2.25 s)",
    "112.000 temperature OK: 74 degC is no longer above 80 degC (was WARN for 5 s)",
    "112.250 cpu_usage WARN: mean 100 % is above 90 % (was OK for 11.8 s)",
    "114.000 cpu_usage OK: mean 60 % is no longer above 90 % (was WARN for 1.75 s)",
    "114.000 battery_level WARN: 50 % is below 60 % (was OK for 2.5 s)",
    "refused: signals.battery_level.error_below: expected at most warn_below (60), got 70:"
    " a falling value crosses the WARN bound first",
    "115.000 battery_level OK: 50 % (was WARN for 1 s)",
    "116.125 vibration WARN: 2 is above 1 (was unknown for 15.6 s)",
    "116.250 vibration OK: 0 is no longer above 1 (was WARN for 0.125 s)",
    "116.375 vibration WARN: 2 is above 1 (was OK for 0.125 s)",
    "116.500 vibration OK: 0 is no longer above 1 (was WARN for 0.125 s)",
    "116.625 vibration WARN: 2 is above 1 (was OK for 0.125 s)",
    "116.750 vibration OK: 0 is no longer above 1 (was WARN for 0.125 s)",
    "116.875 vibration WARN: 2 is above 1 (was OK for 0.125 s)",
    "117.000 vibration OK: 0 is no longer above 1 (was WARN for 0.125 s)",
    "117.125 vibration WARN: 2 is above 1 (was OK for 0.125 s),"
    " flapping: 51.51 % state change, further changes not announced until below 25 %",
    "119.000 vibration OK: 0 is no longer above 1 (was WARN for 1.88 s)",
    "125.000 /battery_level STALE: no message for 5.5 s (limit 5 s), nor on 1 other topic: /temperature "
    "(was OK for 24.5 s)",
    "125.500 /battery_level OK: messages again (was STALE for 0.5 s)",
    "125.500 battery_level WARN: 15 % is below 20 % (was OK for 10.5 s)",
    "53.000 battery_level OK: 30 % is no longer below 20 % (was WARN for 2 s)",
]
"""The transitions of AlertSystem for tests/data/timeline.csv."""


def test_log_lines_name_their_node_and_time() -> None:
    bus = LocalBus(5.0)
    bus.node("alert_system", namespace="robot1").log(Severity.WARN, "low")
    assert bus.log_lines == [(5.0, "/robot1/alert_system", Severity.WARN, "low")]


def test_log_lines_can_go_elsewhere() -> None:
    lines: list[Any] = []
    bus = LocalBus(on_log=lines.append)
    bus.node("alert_system").log(Severity.INFO, "started")
    assert [line.text for line in lines] == ["started"]
    assert bus.log_lines == []


def test_timers_are_called_in_the_order_of_their_times() -> None:
    bus, calls = LocalBus(), []  # type: ignore[var-annotated]
    node = bus.node("aggregator")
    node.create_timer(1.0, lambda now_s: calls.append(("slow", now_s)))
    node.create_timer(0.4, lambda now_s: calls.append(("fast", now_s)))
    bus.run_until(1.0)
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
    assert bus.graph().topics == {"/battery_level": FLOAT32, "/diagnostics": "diagnostic_msgs/DiagnosticArray"}


def test_the_bus_forgets_topics_that_nothing_uses_any_more() -> None:
    bus = LocalBus()
    first, second = bus.node("first"), bus.node("second", use_sim_time=True)
    subscriptions = [node.subscribe("/out", FLOAT32, Recorder()) for node in (first, first, second)]
    for subscription in subscriptions[:2]:
        first.unsubscribe(subscription)
        assert bus.graph().topics == {"/out": FLOAT32}
    second.unsubscribe(subscriptions[2])
    assert bus.graph().topics == {}
    first.advertise("/out", FLOAT32)
    second.unsubscribe(second.subscribe("/out", FLOAT32, Recorder()))
    assert bus.graph().topics == {"/out": FLOAT32}
    first.close()
    second.close()
    assert (bus.graph().topics, bus._topics) == ({}, {})


def test_a_number_too_large_for_32_bits_becomes_infinity() -> None:
    bus, heard = LocalBus(), Recorder()
    node = bus.node("battery_sensor")
    node.subscribe("out", FLOAT32, heard, field="data")
    node.advertise("out", FLOAT32)
    node.publish("out", {"data": 1e39})
    node.publish("out", {"data": -1e39})
    assert heard.values == [float("inf"), float("-inf")]


def test_calling_a_missing_service_fails() -> None:
    bus = LocalBus()
    bus.node("alert_system").advertise_service("~reset", "std_srvs/Trigger", lambda request: {})
    with pytest.raises(ServiceError, match=r"^there is no service /reset$"):
        bus.call_service("/reset")


def test_a_whole_configuration_can_be_proposed() -> None:
    proposed: list[Mapping[str, Any]] = []

    def on_change(tree: Mapping[str, Any]) -> str:
        proposed.append(tree)
        return "publish_rate: 2 -> 3"

    node = LocalBus().node("alert_system", parameters={"publish_rate": 2.0})
    node.declare_parameters([], on_change)
    tree: dict[str, Any] = {"publish_rate": 3.0}
    assert node.set_parameters(tree) == "publish_rate: 2 -> 3"
    assert proposed == [tree]
    assert node.given_parameters() == tree
