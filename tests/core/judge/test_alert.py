"""What holds an alert back, and until when: docs/rules.md, "One cause, one alert"."""

from __future__ import annotations

import math

from robot_health_monitor.core import Level
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.judge.alert import Alert, Held


def test_a_silence_holds_until_it_ends() -> None:
    held = Held()
    assert not held.holds(0.0)
    held.silence = "/scan"
    assert held.holds(1e9)
    held.silence = ""
    assert not held.holds(0.0)


def test_what_awaits_its_own_sample_is_held_until_then() -> None:
    held = Held()
    held.awaits_until_s = 10.0
    assert held.holds(10.0) and not held.holds(10.1)
    held.leave_out(5.0)
    assert held.holds(15.0) and not held.holds(15.1)


def test_a_cause_holds_and_settles_when_it_has_ended() -> None:
    held = Held()
    held.begin("motor", 20.0)
    held.begin("power", 30.0)
    assert (held.cause, held.holds(1e9)) == ("power", True)
    held.end(60.0, 5.0)
    assert (held.cause, held.holds(64.9), held.holds(65.0)) == ("", True, False)
    assert held.text == "was caused by power for 40 s"


def test_time_that_goes_back_restarts_a_running_wait() -> None:
    held = Held()
    held.awaits_until_s = 100.0
    held.begin("motor", 20.0)
    held.end(60.0, 5.0)
    held.restart(30.0, 5.0)
    assert held.awaits_until_s == -math.inf
    assert (held.holds(34.9), held.holds(35.0), held.text) == (True, False, "was caused by motor for 10 s")


def test_an_alert_by_itself_is_unknown_until_it_is_silent_for_too_long() -> None:
    alert = Alert(read_signal("source", {"stale_after_s": 5.0, "startup_grace_s": 10.0}), "atlas", 0.0)
    assert (alert.level, alert.state, alert.is_announced) == (Level.STALE, "waiting", False)
    alert.staleness.arrive(1.0)
    assert (alert.level, alert.state) == (Level.OK, "inactive")
    alert.staleness.fall_silent()
    assert alert.state == "stale"
    alert.inhibit(7.0)
    assert (alert.level, alert.state) == (Level.STALE, "unreachable")
