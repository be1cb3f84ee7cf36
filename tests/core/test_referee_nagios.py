"""Flap detection against a plain calculation of the formula that Nagios publishes.

"Detection and Handling of State Flapping", Nagios Core documentation: of the last 21 check results the 20 possible
changes are looked at; the oldest weighs 0.75, the newest 1.25, those between rise linearly, and the weighted changes
over the number of possible ones are the percent state change.
"""

from __future__ import annotations

import random
from fractions import Fraction

import pytest
from harness.nagios import RESULTS, announcements, last_21, percent_state_change
from harness.seeds import fixed_seed

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.judge.flapping import FlapDetector

pytestmark = pytest.mark.newest_python


def test_the_formula_weighs_all_changes_to_100_and_none_to_0() -> None:
    assert percent_state_change([Level.OK, Level.WARN] * 10 + [Level.OK]) == 100
    assert percent_state_change([Level.WARN] * RESULTS) == 0


def test_the_percentage_is_exactly_that_of_the_formula() -> None:
    chance = random.Random(fixed_seed())
    for _ in range(200):
        detector, history = FlapDetector(50.0, 25.0), []
        for _ in range(60):
            level = chance.choice((Level.OK, Level.OK, Level.WARN, Level.ERROR))
            detector.add(level)
            history.append(level)
            assert detector.percent == pytest.approx(float(percent_state_change(last_21(history))), rel=1e-14)


def test_flapping_begins_and_ends_exactly_at_the_limits_of_the_formula() -> None:
    chance = random.Random(fixed_seed())
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
            assert detector.flapping is flapping or min(abs(percent - low), abs(percent - high)) < Fraction(1, 10**12)
            flapping = detector.flapping
    assert changes > 100


def test_what_a_monitor_announces_is_what_the_formula_leaves_unsilenced() -> None:
    """From the levels alone: announce every change, but none while it flaps, and the level once when that ends."""
    chance = random.Random(fixed_seed())
    for _ in range(100):
        settings = {"warn_below": 20.0, "error_below": 10.0, "flap_detection": True}
        monitor = Monitor(load_config({"signals": {"a": settings}}))
        steadiness = chance.random()
        values: list[float] = []
        for second in range(120):
            changes = chance.random() > steadiness and second < 80
            values.append(chance.choice((5.0, 15.0, 50.0)) if changes else values[-1] if values else 50.0)
        levels = [Level.ERROR if value < 10.0 else Level.WARN if value < 20.0 else Level.OK for value in values]
        for second, (expected, flapping) in enumerate(announcements(levels)):
            transitions = monitor.observe(Sample("a", values[second], float(second)))

            found = [(each.from_level, each.to_level) for each in transitions]
            assert found == expected, f"second {second}"
            assert all(("flapping" in each.text) is flapping for each in transitions), f"second {second}"
            status = monitor.report(float(second)).statuses["a"]
            shown = (status.level, status.values["flapping"])
            assert shown == (levels[second], str(flapping).lower())
