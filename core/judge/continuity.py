"""What a monitor needs from a history, to store what it announces and to continue after a restart.

`ops/store` implements `SignalHistory`. `AlertSystem` uses it through `Continuity`. See docs/rules.md, "After a
restart".
"""

from __future__ import annotations

import math
from typing import Any, Mapping, Protocol, Sequence

from ..config import OF_ARRIVALS, MonitorConfig, settings_of
from ..values import Changes, JsonObject, Transition
from .monitor import Monitor
from .sample_summary import PERIOD_S, SampleSummary
from .saved_state import SavedSignal

MAX_EVIDENCE = 300
"""Most samples that are stored with a transition."""
_SAME_TIME_S = 1.0
"""The wall clock was set if it differs by more from the monitor's; saved times are corrected then."""


class SignalHistory(Protocol):
    """The part of a history that belongs to one robot. No method raises; all but `record` return at once.

    The calls take effect in their order: a state from `save` never replaces a newer one from `record`. An empty state
    means that its signal is no longer watched: the stored state is deleted.
    """

    keeps_samples: bool
    """Whether it stores samples."""

    def wall_s(self) -> float:
        """Returns the time in seconds since 1970."""

    def restore(self) -> Mapping[str, SavedSignal]:
        """Returns the last state of each signal, by name; called once, before the first sample."""

    def watched_until_s(self) -> float | None:
        """Returns when the robot was last watched before this run, in seconds since 1970; None if that is unknown."""

    def record(self, transition: Transition, saved: SavedSignal, evidence: Sequence[tuple[float, Any]]) -> None:
        """Stores a transition and its signal's new state in one transaction; called before the outlets receive it.

        The evidence is samples of its window as (seconds since 1970, value), oldest first, at most `MAX_EVIDENCE`;
        where the statistic is one of arrivals, its values. Returns when it is committed, or after 0.2 s.
        """

    def save(self, states: Mapping[str, SavedSignal]) -> None:
        """Stores the states that changed, by the names of their signals."""

    def record_samples(self, samples: Mapping[str, Sequence[SampleSummary]]) -> None:
        """Stores what was collected of the samples of signals, by their names."""

    def record_effects(self, effects: Mapping[str, Sequence[str]]) -> None:
        """Stores with open alerts, by the names of their signals, which signals they keep from being announced."""

    def record_reset(self) -> None:
        """Stores that latches were cleared."""

    def record_configuration(self, configuration: Mapping[str, JsonObject]) -> None:
        """Stores the settings of each signal by its name, as a thresholds.yaml has them."""


class Continuity:
    """Stores the transitions and states of a monitor, and restores them at the start."""

    def __init__(self, monitor: Monitor, history: SignalHistory) -> None:
        """Starts without having saved anything."""
        self._monitor = monitor
        self._history = history
        self._saved: dict[str, SavedSignal] = {}
        self._at_rest_since_s: dict[str, float | None] = {}
        self._offset_s = 0.0
        self._period: float | None = None
        """The period in which samples were stored last."""
        self._effects: Mapping[str, Sequence[str]] = {}

    def restore(self, now_s: float, *, at_first_call: bool) -> Changes:
        """Continues the previous run. `at_first_call`: no time is known before the first sample or tick."""
        states = self._history.restore()
        self._saved = dict(states)
        stopped_s = self._history.watched_until_s()
        self._offset_s = round(self._history.wall_s() - now_s, 3)
        self.record_samples(now_s)
        return self._monitor.restore(states, None if at_first_call else now_s, self._history.wall_s(), stopped_s)

    def record(self, transition: Transition) -> None:
        """Stores a transition with the state of its signal."""
        name, now_s = transition.signal, transition.now_s
        wall_s = self._history.wall_s()
        saved = self._monitor.snapshot(name, now_s, wall_s)
        samples = self._monitor.window_samples(name, MAX_EVIDENCE)
        if transition.statistic in OF_ARRIVALS:  # the values say nothing: the statistic is the evidence
            samples = self._monitor.shown_samples(name, MAX_EVIDENCE - 1)
            if isinstance(transition.value, float):
                samples = [*samples, (now_s, transition.value)]
        self._keep({name: saved})
        offset_s = wall_s - now_s
        self._history.record(transition, saved, [(time_s + offset_s, value) for time_s, value in samples])

    def save(self, now_s: float) -> None:
        """Saves the states that changed since they were saved last, and every 10 s the samples; call at each tick."""
        monitor, wall_s = self._monitor, self._history.wall_s()
        if not monitor.signals():  # before the first call
            return
        effects = monitor.effects()
        if effects != self._effects:
            self._effects = effects
            self._history.record_effects(effects)
        if not abs(wall_s - now_s - self._offset_s) < _SAME_TIME_S:
            self._offset_s = round(wall_s - now_s, 3)
            self._at_rest_since_s = {}
            self.record_samples(now_s)  # what comes belongs to other periods; simulated time comes here all the time
        if wall_s // PERIOD_S != self._period:
            self._period = wall_s // PERIOD_S
            self.record_samples(now_s, now_s + _SAME_TIME_S)
        names = monitor.saved_signals()
        changed: dict[str, SavedSignal] = {name: {} for name in self._saved if name not in names}
        for name in names:
            at_rest_since_s = monitor.at_rest_since_s(name)
            if at_rest_since_s is None or self._at_rest_since_s.get(name) != at_rest_since_s:
                self._at_rest_since_s[name] = at_rest_since_s
                saved = monitor.snapshot(name, now_s, now_s + self._offset_s)
                if saved != self._saved.get(name, {}):
                    changed[name] = saved
        if changed:
            self._keep(changed)
            self._history.save(changed)

    def record_samples(self, now_s: float, until_s: float = math.inf) -> None:
        """Stores the samples until then, or those of the open period too: the run, or that of a signal, may end."""
        if self._history.keeps_samples:
            samples = self._monitor.take_samples(until_s, self._history.wall_s() - now_s)
            if samples:
                self._history.record_samples(samples)

    def _keep(self, states: Mapping[str, SavedSignal]) -> None:
        self._saved.update(states)
        for name in [name for name, saved in states.items() if not saved]:
            del self._saved[name]
            self._at_rest_since_s.pop(name, None)

    def record_reset(self, now_s: float) -> None:
        """Stores that latches were cleared, and the states without them."""
        self._history.record_reset()
        self.save(now_s)

    def forget(self) -> None:
        """Deletes the states: the robot is no longer watched."""
        states: dict[str, SavedSignal] = {name: {} for name in self._saved}
        self._saved = {}
        if states:
            self._history.save(states)

    def record_configuration(self, config: MonitorConfig) -> None:
        """Stores the configuration in force."""
        self._history.record_configuration({name: settings_of(signal) for name, signal in config.signals.items()})
