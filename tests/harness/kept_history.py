"""A history of one robot in memory, and an alert_system that is killed and started again."""

from __future__ import annotations

import json
from typing import Any, Mapping, Sequence

from harness.stage import Stage
from robot_health_monitor.core.judge.sample_summary import SampleSummary
from robot_health_monitor.core.judge.saved_state import SavedSignal
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.values.model import Transition


class KeptHistory:
    """Implements `core.continuity.SignalHistory`; it passes states through JSON, as a file does."""

    def __init__(self, stage: Stage, wall_offset_s: float = 1e9) -> None:
        self._stage = stage
        self.wall_offset_s = wall_offset_s
        self.states: dict[str, SavedSignal] = {}
        self.stopped_s: float | None = None
        self.events: list[str] = []
        self.evidence: list[Sequence[tuple[float, Any]]] = []
        self.configurations: list[Mapping[str, Any]] = []
        self.saves: list[Mapping[str, SavedSignal]] = []
        self.samples: list[Mapping[str, Sequence[SampleSummary]]] = []

    keeps_samples = True

    def wall_s(self) -> float:
        return self._stage.bus.now_s + self.wall_offset_s

    def restore(self) -> Mapping[str, SavedSignal]:
        return dict(self.states)

    def watched_until_s(self) -> float | None:
        return self.stopped_s

    def record(self, transition: Transition, saved: SavedSignal, evidence: Sequence[tuple[float, Any]]) -> None:
        self.events.append(transition.text)
        self.evidence.append(evidence)
        self._keep({transition.signal: saved})

    def save(self, states: Mapping[str, SavedSignal]) -> None:
        self.saves.append(states)
        self._keep(states)

    def record_samples(self, samples: Mapping[str, Sequence[SampleSummary]]) -> None:
        self.samples.append(samples)

    def record_effects(self, effects: Mapping[str, Sequence[str]]) -> None:
        self.effects = effects

    def record_reset(self) -> None:
        self.events.append("reset")

    def record_configuration(self, configuration: Mapping[str, Mapping[str, Any]]) -> None:
        self.configurations.append(configuration)

    def _keep(self, states: Mapping[str, SavedSignal]) -> None:
        for name, state in json.loads(json.dumps(states, allow_nan=False)).items():
            if state:
                self.states[name] = state
            else:
                self.states.pop(name, None)


class Robot:
    """An alert_system with a history, which can be killed and started again, in virtual time."""

    def __init__(self, *, use_sim_time: bool = False, **signals: Mapping[str, Any]) -> None:
        self.stage = Stage()
        self.history = KeptHistory(self.stage)
        self.signals: dict[str, Mapping[str, Any]] = signals
        self._use_sim_time = use_sim_time
        self._announced: list[str] = []
        self.start()

    def start(self) -> None:
        parameters = {"robot_name": "r1", "signals": self.signals}
        bus = self.stage.bus
        self.middleware = bus.node("alert_system", parameters=parameters, use_sim_time=self._use_sim_time)
        self.system = AlertSystem(self.middleware, {"seen": self._note}, history=self.history)

    def kill(self) -> None:
        """Ends it as kill -9 does: nothing is saved."""
        self.middleware.close()
        self.history.stopped_s = self.history.wall_s()

    def restart(self, downtime_s: float = 0.0) -> None:
        self.kill()
        self.stage.bus.run_until(self.stage.bus.now_s + downtime_s)
        self.start()

    def run_for(self, duration_s: int, **values: float) -> None:
        """Passes time; publishes the values at the beginning of each second."""
        for _ in range(duration_s):
            for name, value in values.items():
                self.stage.publish(name, value)
            self.stage.bus.run_until(self.stage.bus.now_s + 1.0)

    def shown(self, signal: str = "battery") -> tuple[str, str]:
        """Returns level and message of a signal."""
        status = self.system.monitor.report(self.stage.bus.now_s).statuses[signal]
        return status.level.name, status.message

    def announced(self) -> list[str]:
        """Returns and forgets what was announced."""
        found, self._announced = self._announced, []
        return found

    def _note(self, event: Event) -> None:
        self._announced.append(event.text)
