"""The alerts in which configurations differ, found while the alerts arrive."""

from __future__ import annotations

from typing import Callable, Counter, List, Sequence, Tuple

from robot_health_monitor.core.model import Level, Transition

from .judging import JudgedEvent

_Key = Tuple[str, Level, Level, float, bool]


class Differences:
    """Passes on transitions that one configuration announced and another did not, at the same time.

    Two transitions are the same if signal, levels and time agree. Holds the transitions of one instant only.
    """

    def __init__(self, files: Sequence[str], on_difference: Callable[[JudgedEvent], None]) -> None:
        """Starts without transitions.

        Args:
            files: names of the configurations.
            on_difference: called with each transition that not every configuration announced.
        """
        self._files = tuple(files)
        self._on_difference = on_difference
        self._held: List[JudgedEvent] = []

    def add(self, judged: JudgedEvent) -> None:
        """Takes a transition; notices are ignored. Log times must not decrease."""
        if not isinstance(judged.event, Transition):
            return
        if self._held and judged.wall_s != self._held[0].wall_s:
            self.flush()
        self._held.append(judged)

    def flush(self) -> None:
        """Compares the transitions of the last instant; call at the end."""
        held, self._held = self._held, []
        counts = {file: Counter(_key(each.event) for each in held if each.file == file) for file in self._files}
        seen: Counter[Tuple[str, _Key]] = Counter()
        for each in held:
            key = _key(each.event)
            seen[each.file, key] += 1
            if seen[each.file, key] > min(count[key] for count in counts.values()):
                self._on_difference(each)


def _key(event: object) -> _Key:
    assert isinstance(event, Transition)
    return event.signal, event.from_level, event.to_level, event.now_s, event.repeat
