"""Flap detection: the percentages of Nagios's documentation, worked out by hand."""

from __future__ import annotations

import pytest

from robot_health_monitor.core import Level
from robot_health_monitor.core.flapping import FlapDetector

OK, WARN, ERROR = Level.OK, Level.WARN, Level.ERROR


def fed(*levels: Level, high: float = 50.0, low: float = 25.0) -> FlapDetector:
    detector = FlapDetector(high, low)
    for level in levels:
        detector.add(level)
    return detector


def test_no_change_is_0_percent() -> None:
    assert fed(*[OK] * 30).percent == 0.0


def test_a_change_in_every_sample_is_100_percent() -> None:
    assert fed(*[WARN, OK] * 20).percent == 100.0


def test_the_newest_change_weighs_1_25_of_20() -> None:
    assert fed(WARN).percent == pytest.approx(100 * 1.25 / 20)


def test_the_oldest_change_weighs_0_75_of_20() -> None:
    assert fed(*[WARN] * 20).percent == pytest.approx(100 * 0.75 / 20)


def test_a_change_older_than_21_levels_is_forgotten() -> None:
    assert fed(*[WARN] * 21).percent == 0.0


def test_a_change_between_warn_and_error_counts_as_much_as_one_to_ok() -> None:
    assert fed(WARN, ERROR).percent == fed(WARN, OK).percent


def test_flapping_begins_exactly_at_the_high_limit() -> None:
    # Changes at places 0..4 (oldest) and 15..19 (newest) pair up to 2.0 each: 10 of 20, exactly 50 %.
    paired = [WARN, OK, WARN, OK, WARN] + [WARN] * 10 + [OK, WARN, OK, WARN, OK]
    assert fed(*paired).percent == 50.0
    assert fed(*paired, high=50.0).flapping
    assert not fed(*paired, high=50.01).flapping


def test_flapping_ends_only_below_the_low_limit() -> None:
    paired = [WARN, OK, WARN, OK, WARN] + [WARN] * 10 + [OK, WARN, OK, WARN, OK]
    detector = fed(*paired, low=50.0)
    assert detector.flapping  # 50 is not below 50
    detector.add(OK)
    assert not detector.flapping


def test_new_limits_decide_from_the_next_sample_on() -> None:
    detector = fed(WARN, OK, WARN, OK)
    assert not detector.flapping
    detector.configure(10.0, 5.0)
    assert not detector.flapping
    detector.add(OK)
    assert detector.flapping
