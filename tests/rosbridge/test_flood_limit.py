"""The limit of frames without content."""

from __future__ import annotations

from robot_health_monitor.rosbridge.flood_limit import MOST_PER_SECOND, FloodLimit


def test_the_limit_is_a_hundred_frames_in_a_second() -> None:
    limit = FloodLimit()
    assert MOST_PER_SECOND == 100
    assert [limit.is_exceeded(50.0 + 0.009 * frame) for frame in range(101)] == [False] * 100 + [True]


def test_a_new_second_counts_anew() -> None:
    limit = FloodLimit()
    assert not any(limit.is_exceeded(50.0) for _ in range(100))
    assert limit.is_exceeded(50.999)
    assert not any(limit.is_exceeded(51.0) for _ in range(100))
    assert limit.is_exceeded(51.5)
