"""The promise of one verdict everywhere: a recorded timeline through a real node gives the reference's transitions.

`tests/data/timeline.csv` holds samples, changes of parameters, resets and the course of simulated time;
`field_timeline.py` holds messages for every kind of field and statistic, `bad_input.py` those of broken drivers. A test
module per middleware subclasses
`Equivalence` and gives it the fixture `harness` of `port_conformance.py`.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any, Callable, NamedTuple, Sequence

import pytest

from harness.bad_input import BAD_INPUT
from harness.field_timeline import FIELDS, Scene
from harness.local import LocalHarness
from harness.port_conformance import FLOAT32, START_S, TRIGGER, Harness
from harness.silence import SILENCE
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.alert_system import TICK_PERIOD_S
from robot_health_monitor.core.port.middleware import Middleware, Subscription, Timer
from robot_health_monitor.core.values.model import Transition

TIMELINE = Path(__file__).parents[1] / "data" / "timeline.csv"

PARAMETERS = {
    "robot_name": "robot1",
    "publish_rate": 1.0,
    "signals": {
        "battery_level": {
            "unit": "%",
            "valid_min": 0.0,
            "valid_max": 100.0,
            "warn_below": 20.0,
            "error_below": 10.0,
            "hysteresis": 2.0,
        },
        "temperature": {
            "unit": "degC",
            "warn_above": 80.0,
            "hysteresis": 5.0,
            "for_s": 2.0,
            "keep_firing_for_s": 3.0,
            "repeat_s": 4.0,
        },
        "cpu_usage": {
            "unit": "%",
            "statistic": "mean",
            "window_s": 4.0,
            "warn_above": 90.0,
            "latch": True,
            "stale_after_s": 20.0,
        },
        "vibration": {"warn_above": 1.0, "flap_detection": True, "stale_after_s": 0.0},
    },
}


class Event(NamedTuple):
    """One row of the timeline."""

    time_s: float
    event: str
    """`sample`, `set` (a parameter), `reset`, or `time`, which only passes."""
    name: str
    value: str


class Refusal(NamedTuple):
    """A change of parameters that the node refused."""

    reason: str

    def __str__(self) -> str:
        return f"refused: {self.reason}"


class Judged(NamedTuple):
    """What the messages of a robot brought about."""

    transitions: list[Transition]
    samples: list[int]
    """How many samples there were after each message."""
    faults: list[str]
    """Those of the node itself at the end."""


class Equivalence:
    """Replays the timeline; the times are such that every middleware can write them exactly."""

    def test_the_recorded_timeline_gives_the_same_transitions(self, harness: Harness) -> None:
        try:
            replayed = self.replay(harness)
        finally:
            harness.close()
        reference = self.replay(LocalHarness())
        # as texts: a NaN that was judged is not equal to itself
        assert [repr(result) for result in replayed] == [repr(result) for result in reference]

    @pytest.mark.parametrize("scene", [FIELDS, BAD_INPUT, SILENCE], ids=["fields", "bad input", "silence"])
    def test_every_kind_of_field_gives_the_same_transitions(self, harness: Harness, scene: Scene) -> None:
        reference = self.publish(LocalHarness(), scene)
        try:
            found = self.publish(harness, scene, reference.samples)
        finally:
            harness.close()
        assert [repr(each) for each in found.transitions] == [repr(each) for each in reference.transitions]
        assert found.faults == reference.faults

    def publish(self, harness: Harness, scene: Scene, samples: Sequence[int] = ()) -> Judged:
        """Returns what the messages of a robot bring about.

        Args:
            harness: where to publish.
            scene: the messages.
            samples: their `Judged.samples`, to wait for; empty: messages are delivered while they are published.
        """
        judged = Judged([], [], [])
        node = _Watched(harness.node("alert_system", parameters={"robot_name": "robot1", "signals": scene.signals}))
        AlertSystem(
            node, {"test": lambda event: judged.transitions.append(event) if isinstance(event, Transition) else None}
        )
        clock = _Clock(harness, node)
        for number, published in enumerate(scene.messages):
            clock.advance(published.time_s)
            harness.publish(published.topic, published.type_name, published.message)
            if samples:
                harness.wait_until(lambda expected=samples[number]: node.samples >= expected)
            judged.samples.append(node.samples)
        clock.advance(START_S + scene.seconds)
        judged.faults.extend(f"{part}: {fault.text}" for part, fault in sorted(node.wrapped.faults.current().items()))
        return judged

    def replay(self, harness: Harness) -> list[Transition | Refusal]:
        """Returns what the timeline brings about, in order."""
        results: list[Transition | Refusal] = []
        node = _Watched(harness.node("alert_system", parameters=PARAMETERS))
        AlertSystem(node, {"test": lambda event: results.append(event) if isinstance(event, Transition) else None})
        clock = _Clock(harness, node)
        for event in read_timeline():
            clock.advance(event.time_s)
            if event.event == "sample":
                before = node.samples
                harness.publish(f"/{event.name}", FLOAT32, {"data": float(event.value)})
                harness.wait_until(lambda expected=before + 1: node.samples == expected)
            elif event.event == "set":
                reason = harness.propose(node.wrapped, event.name, float(event.value))
                if reason:
                    results.append(Refusal(reason))
            elif event.event == "reset":
                assert harness.call("/alert_system/reset", TRIGGER)["success"]
        return results


def read_timeline() -> list[Event]:
    """Returns the rows of the timeline."""
    with open(TIMELINE, encoding="utf-8", newline="") as file:
        return [Event(float(row["time_s"]), row["event"], row["name"], row["value"]) for row in csv.DictReader(file)]


class _Clock:
    """Moves simulated time so that no tick is missed: to every beat of the node's timers, which it waits for."""

    def __init__(self, harness: Harness, node: _Watched) -> None:
        self._harness = harness
        self._node = node
        self._now_s = self._beat_from_s = START_S

    def advance(self, to_s: float) -> None:
        if to_s < self._now_s:
            self._set(to_s)
            self._beat_from_s = to_s
        beats = math.floor((self._now_s - self._beat_from_s) / TICK_PERIOD_S)
        while self._beat_from_s + (beats + 1) * TICK_PERIOD_S <= to_s:
            beats += 1
            beat_s = self._beat_from_s + beats * TICK_PERIOD_S
            self._set(beat_s)
            self._harness.wait_until(lambda now_s=beat_s: self._node.has_ticked(now_s))
        if to_s > self._now_s:
            self._set(to_s)

    def _set(self, now_s: float) -> None:
        self._harness.set_time(now_s)
        self._now_s = now_s


class _Watched:
    """A node's connection, with a count of the callbacks that have returned."""

    def __init__(self, wrapped: Middleware) -> None:
        self.wrapped = wrapped
        self.samples = 0
        self._ticks: list[list[float]] = []

    def has_ticked(self, now_s: float) -> bool:
        return all(times_s[-1:] == [now_s] for times_s in self._ticks)

    def subscribe(
        self, topic: str, type_name: str, callback: Callable[[Any, float], None], **options: Any
    ) -> Subscription:
        def counted(value: Any, now_s: float) -> None:
            callback(value, now_s)
            self.samples += 1

        return self.wrapped.subscribe(topic, type_name, counted, **options)

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> Timer:
        if steady:
            return self.wrapped.create_timer(period_s, callback, steady=True)
        times_s: list[float] = []
        self._ticks.append(times_s)

        def noted(now_s: float) -> None:
            callback(now_s)
            times_s.append(now_s)

        return self.wrapped.create_timer(period_s, noted)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.wrapped, name)
