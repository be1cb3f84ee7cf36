"""A monitor that stores what it announces, and continues after a restart (docs/rules.md, "After a restart")."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import pytest
from harness.stage import Stage

from robot_health_monitor.core.continuity import SavedSignal
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Transition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.outlets import Event


class KeptHistory:
    """A history of one robot in memory; it passes states through JSON, as a file does."""

    def __init__(self, stage: Stage, wall_offset_s: float = 1e9) -> None:
        self._stage = stage
        self.wall_offset_s = wall_offset_s
        self.states: Dict[str, SavedSignal] = {}
        self.events: List[str] = []
        self.evidence: List[Sequence[Tuple[float, Any]]] = []
        self.saves: List[Mapping[str, SavedSignal]] = []

    def wall_s(self) -> float:
        return self._stage.bus.now_s + self.wall_offset_s

    def restore(self) -> Mapping[str, SavedSignal]:
        return dict(self.states)

    def record(self, transition: Transition, saved: SavedSignal, evidence: Sequence[Tuple[float, Any]]) -> None:
        self.events.append(transition.text)
        self.evidence.append(evidence)
        self._keep({transition.signal: saved})

    def save(self, states: Mapping[str, SavedSignal]) -> None:
        self.saves.append(states)
        self._keep(states)

    def record_reset(self) -> None:
        self.events.append("reset")

    def _keep(self, states: Mapping[str, SavedSignal]) -> None:
        for name, state in json.loads(json.dumps(states)).items():
            if state:
                self.states[name] = state
            else:
                self.states.pop(name, None)


class Robot:
    """An alert_system with a history, which can be killed and started again."""

    def __init__(self, **signals: Mapping[str, Any]) -> None:
        self.stage = Stage()
        self.history = KeptHistory(self.stage)
        self.signals: Dict[str, Mapping[str, Any]] = signals
        self.announced: List[str] = []
        self.start()

    def start(self) -> None:
        parameters = {"robot_name": "r1", "signals": self.signals}
        self._middleware = self.stage.bus.node("alert_system", parameters=parameters)
        self.system = AlertSystem(self._middleware, {"seen": self._note}, history=self.history)

    def kill(self) -> None:
        """Ends it as kill -9 does: nothing is saved."""
        self._middleware.close()

    def restart(self, downtime_s: float = 0.0) -> None:
        self.kill()
        self.run_for(downtime_s)
        self.start()

    def run_for(self, duration_s: float, **values: float) -> None:
        """Passes time, with a sample of each value every second."""
        for _ in range(int(duration_s)):
            for name, value in values.items():
                self.stage.publish(name, value)
            self.stage.bus.run_until(self.stage.bus.now_s + 1.0)

    def shown(self, signal: str = "battery") -> Tuple[str, str]:
        status = self.system.monitor.report(self.stage.bus.now_s).statuses[signal]
        return status.level.name, status.message

    def announcements(self) -> List[str]:
        """Returns and forgets what was announced."""
        found, self.announced = self.announced, []
        return found

    def _note(self, event: Event) -> None:
        self.announced.append(event.text)


def test_an_open_alert_that_still_holds_is_not_announced_again() -> None:
    robot = Robot(battery={"warn_below": 20.0})
    robot.run_for(3, battery=15.0)
    assert robot.announcements() == ["battery WARN: 15 is below 20 (was OK for 0 s)"]
    robot.restart(3600.0)
    robot.run_for(60, battery=15.0)
    assert robot.announcements() == []
    assert robot.shown() == ("WARN", "15 is below 20")


def test_a_transition_is_stored_before_the_outlets_receive_it() -> None:
    robot = Robot(battery={"warn_below": 20.0})
    order: List[str] = []
    robot.history.record = lambda *_: order.append("history")  # type: ignore[method-assign]
    robot.system.outlets.add("seen", lambda event: order.append("outlet"))
    robot.run_for(1, battery=15.0)
    assert order == ["history", "outlet"]


def test_evidence_is_the_window_in_wall_time() -> None:
    robot = Robot(battery={"warn_below": 20.0})
    robot.run_for(2, battery=50.0)
    robot.run_for(1, battery=15.0)
    assert robot.history.evidence == [[(1e9, 50.0), (1e9 + 1.0, 50.0), (1e9 + 2.0, 15.0)]]


def test_a_healthy_signal_is_saved_once() -> None:
    robot = Robot(battery={"warn_below": 20.0}, load={"statistic": "mean", "warn_above": 80.0})
    robot.run_for(100, battery=50.0, load=3.0)
    saved = [name for states in robot.history.saves for name in states]
    assert sorted(saved) == ["battery", "load"]


def test_a_reset_is_stored_with_the_cleared_latch() -> None:
    robot = Robot(battery={"warn_below": 20.0, "latch": True})
    robot.run_for(2, battery=15.0)
    robot.run_for(2, battery=50.0)
    robot.stage.bus.call_service("/alert_system/reset")
    assert robot.history.events[-1] == "reset"
    assert "latched" not in robot.history.states["battery"]


@pytest.mark.parametrize("with_history", [False, True])
def test_only_without_a_history_a_latch_is_not_restored(with_history: bool) -> None:
    stage = Stage()
    parameters = {"signals": {"battery": {"warn_below": 20.0, "latch": True}}}
    history = KeptHistory(stage) if with_history else None
    AlertSystem(stage.bus.node("alert_system", parameters=parameters), history=history)
    lines = [line for line in stage.log(Severity.INFO) if "no history" in line]
    assert bool(lines) is not with_history


def test_the_states_of_signals_that_left_the_configuration_are_deleted() -> None:
    robot = Robot(battery={"warn_below": 20.0}, load={"warn_above": 80.0})
    robot.run_for(2, battery=50.0, load=3.0)
    del robot.signals["load"]
    robot.restart()
    robot.run_for(2, battery=50.0)
    assert list(robot.history.states) == ["battery"]
