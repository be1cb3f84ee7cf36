"""Silence, waiting and downtime of the link."""

from __future__ import annotations

from typing import Any

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.judge.staleness import Staleness


def staleness(now_s: float = 0.0, **settings: Any) -> Staleness:
    return Staleness(read_signal("battery", settings), now_s)


def seen(now_s: float) -> Staleness:
    found = staleness()
    found.arrive(now_s)
    return found


def test_before_the_first_sample_the_startup_grace_counts() -> None:
    waiting = staleness(100.0, startup_grace_s=10.0)
    assert waiting.waiting and waiting.unknown and waiting.frozen
    assert not waiting.is_due(110.0)
    assert waiting.is_due(110.5)
    assert waiting.fall_silent() == 110.0
    assert (waiting.stale, waiting.waiting, waiting.unknown, waiting.frozen) == (True, False, False, True)


def test_silence_is_too_long_only_beyond_the_limit() -> None:
    assert not seen(1.0).is_due(6.0)
    assert seen(1.0).is_due(6.001)


def test_a_limit_of_0_disables_staleness() -> None:
    assert not staleness(stale_after_s=0.0).is_due(1.7e308)


def test_downtime_does_not_count_as_silence() -> None:
    found = seen(0.0)
    found.unreachable_since_s = 2.0
    assert (found.unknown, found.frozen, found.is_due(100.0), found.silence_s(100.0)) == (True, True, False, 2.0)
    assert found.end_downtime(12.0) == 10.0
    assert (found.silence_s(13.0), found.is_due(15.0), found.is_due(15.5)) == (3.0, False, True)
    assert (found.last_seen_s, found.without_link_s) == (0.0, 10.0)  # the age of the value is real


def test_after_a_long_downtime_the_startup_grace_counts_again() -> None:
    found = seen(0.0)
    found.unreachable_since_s = 2.0
    assert found.end_downtime(100.0) == 98.0
    assert (found.silence_s(101.0), found.is_due(110.0), found.is_due(110.5)) == (3.0, False, True)
    found.arrive(111.0)
    assert (found.is_due(116.0), found.is_due(116.5), found.without_link_s) == (False, True, 0.0)


def test_a_time_that_was_not_watched_is_no_downtime_of_the_link() -> None:
    found = seen(0.0)
    found.unreachable_since_s = 2.0
    found.end_downtime(100.0, is_link=False)
    assert (found.is_due(103.0), found.is_due(103.5), found.without_link_s) == (False, True, 0.0)


def test_a_sample_during_the_downtime_starts_silence_anew() -> None:
    found = seen(0.0)
    found.unreachable_since_s = 2.0
    found.arrive(3.0)
    found.end_downtime(100.0)
    assert found.silence_s(101.0) == 1.0


def test_a_stale_signal_waits_when_time_goes_back() -> None:
    found = seen(100.0)
    found.fall_silent()
    found.restart(0.0)
    assert (found.stale, found.waiting) == (False, True)
    assert not found.is_due(5.0) and found.is_due(5.5)
