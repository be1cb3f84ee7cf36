"""The formula of flap detection that Nagios publishes, and what it leaves to announce.

"Detection and Handling of State Flapping", Nagios Core documentation: of the last 21 check results the 20 possible
changes are looked at; the oldest weighs 0.75, the newest 1.25, those between rise linearly, and the weighted changes
over the number of possible ones are the percent state change.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Iterable, Iterator, Sequence

from robot_health_monitor.core.values.model import Level

RESULTS = 21


def percent_state_change(levels: Sequence[Level]) -> Fraction:
    """Of exactly 21 levels, the oldest first."""
    assert len(levels) == RESULTS
    total = Fraction(0)
    for place in range(1, RESULTS):
        if levels[place] != levels[place - 1]:
            total += Fraction(3, 4) + Fraction(1, 2) * Fraction(place - 1, RESULTS - 2)
    return total * 100 / (RESULTS - 1)


def last_21(history: Sequence[Level]) -> list[Level]:
    return ([Level.OK] * RESULTS + list(history))[-RESULTS:]


def announcements(levels: Iterable[Level]) -> Iterator[tuple[list[tuple[Level, Level]], bool]]:
    """Yields, per level, the changes to announce, and whether it flaps: from 50 % until below 25 %.

    Every change is announced, but while it flaps only a level that is worse than those announced since it began, and
    the level once when that ends.
    """
    history: list[Level] = []
    announced, flapping = Level.OK, False
    worst: Level | None = None  # announced since flapping began
    for level in levels:
        history.append(level)
        percent = percent_state_change(last_21(history))
        flapping = percent >= 25 if flapping else percent >= 50
        changes = []
        if not flapping:
            worst = None
        if level != announced and (worst is None or level.severity > worst.severity):
            changes = [(announced, level)]
            announced = level
            if flapping:
                worst = level
        yield changes, flapping
