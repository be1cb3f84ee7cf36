"""The delays between attempts that fail."""

from __future__ import annotations

from robot_health_monitor.runtime.backoff import Backoff


def test_delays_double_up_to_the_longest_and_start_again_after_a_success() -> None:
    backoff = Backoff(5.0, 60.0)
    assert not backoff.is_failing
    assert [backoff.next_s() for _ in range(6)] == [5.0, 10.0, 20.0, 40.0, 60.0, 60.0]
    assert backoff.is_failing
    backoff.reset()
    assert not backoff.is_failing and backoff.next_s() == 5.0


def test_a_longest_delay_below_the_first_is_kept() -> None:
    assert Backoff(1.0, 0.5).next_s() == 0.5


def test_an_attempt_may_have_another_longest_delay() -> None:
    backoff = Backoff(8.0, 30.0)
    assert [backoff.next_s(), backoff.next_s(), backoff.next_s(12.0), backoff.next_s()] == [8.0, 16.0, 12.0, 24.0]


def test_the_spread_is_the_random_part_of_a_delay() -> None:
    assert Backoff(8.0, 30.0, spread=0.5, chance=lambda: 0.0).next_s() == 4.0
    assert Backoff(8.0, 30.0, spread=0.5, chance=lambda: 1.0).next_s() == 8.0
    assert len({Backoff(8.0, 30.0, spread=0.5).next_s() for _ in range(100)}) > 50
