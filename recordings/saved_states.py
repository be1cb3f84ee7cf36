"""The states with which a black box begins, as the history that an alert_system continues from."""

from __future__ import annotations

from typing import Any, Callable, Mapping, Optional, Sequence, Tuple

from robot_health_monitor.core.attachments import SavedMonitor
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.sample_summary import SampleSummary
from robot_health_monitor.core.signal_config import LINK
from robot_health_monitor.core.state_reader import SavedSignal


def announced_level(saved: SavedMonitor, signal: str) -> Level:
    """Returns the level of a signal that was announced last; OK if that is not known."""
    state: Any = saved.states.get(signal)
    try:
        return Level[state["announced"]["level"]]
    except (KeyError, TypeError):
        return Level.OK


class SavedStates:
    """Implements `core.continuity.SignalHistory`, which documents its methods; stores nothing."""

    is_kept = True
    keeps_samples = False

    def __init__(self, saved: SavedMonitor, wall_s: Callable[[], float]) -> None:
        """Starts with saved states; `wall_s` returns the time in s since 1970."""
        self._saved = saved
        self.wall_s = wall_s

    def restore(self) -> Mapping[str, SavedSignal]:
        """Returns the states, without that of the link: a recording has none."""
        return {name: state for name, state in self._saved.states.items() if name != LINK}

    def watched_until_s(self) -> Optional[float]:
        """Returns when the states were saved: there was no time between."""
        return self._saved.time_s

    def record(self, transition: Transition, saved: SavedSignal, evidence: Sequence[Tuple[float, Any]]) -> None:
        """Does nothing."""

    def save(self, states: Mapping[str, SavedSignal]) -> None:
        """Does nothing."""

    def record_samples(self, samples: Mapping[str, Sequence[SampleSummary]]) -> None:
        """Does nothing."""

    def record_reset(self) -> None:
        """Does nothing."""

    def record_configuration(self, configuration: Mapping[str, Mapping[str, Any]]) -> None:
        """Does nothing."""
