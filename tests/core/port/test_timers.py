from __future__ import annotations

import math

from robot_health_monitor.core.port.timers import ClockTimer, ClockTimers


def calls(times_s: list[float], start_s: float = 0.0, period_s: float = 1.0) -> list[float]:
    timers = ClockTimers()
    timers.add(ClockTimer(period_s, lambda now_s: None, start_s))
    return [now_s for now_s in times_s for _ in timers.take_due(now_s)]


def test_a_timer_is_due_after_each_period() -> None:
    assert calls([0.0, 0.5, 0.99, 1.0, 1.5, 2.1, 3.0]) == [1.0, 2.1, 3.0]


def test_a_jump_ahead_is_one_call_and_keeps_the_beat() -> None:
    assert calls([0.0, 10.5, 10.75, 11.0, 12.0]) == [10.5, 11.0, 12.0]


def test_time_that_goes_back_starts_a_new_period() -> None:
    assert calls([100.5, 101.0, 50.2, 51.0, 51.2, 52.2], start_s=100.0) == [101.0, 51.2, 52.2]


def test_timers_are_called_in_the_order_of_their_times() -> None:
    timers = ClockTimers()
    slow, fast = ClockTimer(0.5, lambda now_s: None, 0.0), ClockTimer(0.4, lambda now_s: None, 0.0)
    timers.add(slow)
    timers.add(fast)
    assert timers.next_s() == 0.4
    assert timers.take_due(0.6) == [fast, slow]
    fast.cancel()
    assert timers.next_s() == 1.0
    timers.cancel_all()
    assert timers.next_s() == math.inf and timers.take_due(5.0) == []


def test_cancelled_timers_are_forgotten() -> None:
    timers = ClockTimers()
    for _ in range(10):
        timer = ClockTimer(1.0, lambda now_s: None, 0.0)
        timers.add(timer)
        timer.cancel()
    assert len(timers._timers) == 1  # until the next one is added
    assert timers.take_due(1.0) == []


def test_a_timer_skips_the_periods_that_were_missed_and_keeps_its_phase() -> None:
    timer = ClockTimer(0.5, print, 10.0)
    assert timer.due_s == 10.5
    timer.advance(10.5)
    assert timer.due_s == 11.0
    timer.advance(13.2)
    assert timer.due_s == 13.5
    timer.restart(3.0)
    assert timer.due_s == 3.5


def test_a_timer_that_is_advanced_early_does_not_go_back() -> None:
    timer = ClockTimer(1.0, print, 0.0)
    timer.advance(0.9)
    assert timer.due_s == 2.0


def test_all_periods_restart_together() -> None:
    timers = ClockTimers()
    timers.add(ClockTimer(1.0, lambda now_s: None, 0.0))
    timers.restart(100.25)
    assert timers.take_due(101.0) == []
    assert timers.next_s() == 101.25
