"""Flap detection against a plain calculation of the formula that Nagios publishes.

"Detection and Handling of State Flapping", Nagios Core documentation: of the last 21 check results the 20 possible
changes are looked at; the oldest weighs 0.75, the newest 1.25, those between rise linearly, and the weighted changes
over the number of possible ones are the percent state change.
"""

from __future__ import annotations

import random
from fractions import Fraction
from typing import List, Optional, Sequence

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.flapping import FlapDetector

RESULTS = 21


def percent_state_change(levels: Sequence[Level]) -> Fraction:
    """Of exactly 21 levels, the oldest first."""
    assert len(levels) == RESULTS
    total = Fraction(0)
    for place in range(1, RESULTS):
        if levels[place] != levels[place - 1]:
            total += Fraction(3, 4) + Fraction(1, 2) * Fraction(place - 1, RESULTS - 2)
    return total * 100 / (RESULTS - 1)


def last_21(history: Sequence[Level]) -> List[Level]:
    return ([Level.OK] * RESULTS + list(history))[-RESULTS:]


def seeded() -> int:
    return random.SystemRandom().randrange(10**9)


def test_the_formula_weighs_all_changes_to_100_and_none_to_0() -> None:
    assert percent_state_change([Level.OK, Level.WARN] * 10 + [Level.OK]) == 100
    assert percent_state_change([Level.WARN] * RESULTS) == 0


def test_the_percentage_is_exactly_that_of_the_formula() -> None:
    seed = seeded()
    chance = random.Random(seed)
    for _ in range(200):
        detector, history = FlapDetector(50.0, 25.0), []
        for _ in range(60):
            level = chance.choice((Level.OK, Level.OK, Level.WARN, Level.ERROR))
            detector.add(level)
            history.append(level)
            assert detector.percent == pytest.approx(float(percent_state_change(last_21(history))), rel=1e-14), (
                f"seed {seed}"
            )


def test_flapping_begins_and_ends_exactly_at_the_limits_of_the_formula() -> None:
    seed = seeded()
    chance = random.Random(seed)
    changes = 0
    for _ in range(400):
        # Limits that the percentage can hit: the sums of weights are multiples of 1/76 of 5 %.
        low, high = sorted(Fraction(5 * chance.randrange(76 * 20), 76) for _ in range(2))
        steadiness = chance.random()
        detector, history, flapping = FlapDetector(float(high), float(low)), [Level.OK], False
        for _ in range(80):
            level = history[-1] if chance.random() < steadiness else chance.choice((Level.OK, Level.WARN, Level.ERROR))
            detector.add(level)
            history.append(level)
            percent = percent_state_change(last_21(history))
            was, flapping = flapping, percent >= low if flapping else percent >= high
            changes += was is not flapping
            # Most such limits are no doubles: the configuration holds the nearest ones.
            assert detector.flapping is flapping or min(abs(percent - low), abs(percent - high)) < Fraction(
                1, 10**12
            ), f"seed {seed}"
            flapping = detector.flapping
    assert changes > 100, f"seed {seed}"


def test_what_a_monitor_announces_is_what_the_formula_leaves_unsilenced() -> None:
    """From the levels alone: announce every change, but none while it flaps, and the level once when that ends."""
    seed = seeded()
    chance = random.Random(seed)
    for _ in range(100):
        settings = {"warn_below": 20.0, "error_below": 10.0, "flap_detection": True}
        monitor = Monitor(load_config({"signals": {"a": settings}}))
        steadiness = chance.random()
        history: List[Level] = []
        announced, flapping = Level.OK, False
        worst: Optional[Level] = None  # announced since flapping began
        value = 50.0
        for second in range(120):
            if chance.random() > steadiness and second < 80:
                value = chance.choice((5.0, 15.0, 50.0))
            level = Level.ERROR if value < 10.0 else Level.WARN if value < 20.0 else Level.OK
            history.append(level)
            percent = percent_state_change(last_21(history))
            flapping = percent >= 25 if flapping else percent >= 50
            expected = []
            if not flapping:
                worst = None
            if level != announced and (worst is None or level.severity > worst.severity):
                expected = [(announced, level)]
                announced = level
                if flapping:
                    worst = level

            transitions = monitor.observe(Sample("a", value, float(second)))

            found = [(each.from_level, each.to_level) for each in transitions]
            assert found == expected, f"seed {seed}, second {second}"
            assert all(("flapping" in each.text) is flapping for each in transitions), f"seed {seed}, second {second}"
            status = monitor.report(float(second)).statuses["a"]
            assert (status.level, status.values["flapping"]) == (level, str(flapping).lower()), f"seed {seed}"
