"""One signal: its state, and the value that other signals may use."""

from __future__ import annotations

from typing import Any

from robot_health_monitor.core import Level, Status
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.judge import wording
from robot_health_monitor.core.judge.signal_monitor import SignalMonitor


def watch(name: str = "battery_level", **settings: Any) -> SignalMonitor:
    return SignalMonitor(read_signal(name, settings), "atlas", 0.0)


def status(signal: SignalMonitor, now_s: float) -> Status:
    return wording.status(signal.judgement(now_s))


def message(signal: SignalMonitor, now_s: float) -> str:
    return status(signal, now_s).message


def state(signal: SignalMonitor, now_s: float) -> str:
    return status(signal, now_s).values["state"]


# --- the state in a word --------------------------------------------------------------------------------------------


def test_the_state_is_that_of_the_rule_behind_the_level() -> None:
    signal = watch(warn_below=20.0, error_below=10.0, error_for_s=5.0, error_keep_firing_for_s=5.0)
    assert state(signal, 0.0) == "waiting"
    signal.observe(50.0, 0.5)
    assert state(signal, 0.5) == "inactive"
    signal.observe(5.0, 1.0)  # WARN fires, ERROR is pending
    assert (signal.level, state(signal, 1.0)) == (Level.WARN, "firing")
    signal.observe(5.0, 6.0)
    assert (signal.level, state(signal, 6.0)) == (Level.ERROR, "firing")
    signal.observe(15.0, 7.0)  # ERROR keeps firing
    assert (signal.level, state(signal, 7.0)) == (Level.ERROR, "keeps firing")
    signal.observe(15.0, 12.0)
    assert (signal.level, state(signal, 12.0)) == (Level.WARN, "firing")


def test_a_pending_rule_is_seen_while_the_level_is_ok() -> None:
    signal = watch(warn_below=20.0, for_s=5.0)
    signal.observe(15.0, 1.0)
    assert (signal.level, state(signal, 1.0)) == (Level.OK, "pending")


def test_a_latched_error_is_latched_also_while_a_warning_fires() -> None:
    signal = watch(warn_below=20.0, error_below=10.0, latch=True)
    signal.observe(5.0, 1.0)
    signal.observe(15.0, 2.0)
    assert (signal.level, state(signal, 2.0)) == (Level.ERROR, "latched")
    assert message(signal, 2.0) == "15 is no longer below 10, latched until reset"


# --- the latest good value ----------------------------------------------------------------------------------


def test_the_latest_good_is_the_latest_good_one_and_none_while_it_cannot_be_trusted() -> None:
    signal = watch(stale_after_s=5.0, valid_max=100.0)
    assert signal.latest_good is None
    signal.observe(50.0, 0.0)
    assert signal.latest_good == 50.0
    signal.observe(101.0, 1.0)
    assert signal.latest_good is None
    signal.observe(60.0, 2.0)
    assert signal.latest_good == 60.0
    signal.tick(8.0)
    assert signal.latest_good is None


def test_the_latest_good_is_the_value_and_not_the_statistic() -> None:
    signal = watch(statistic="max")
    signal.observe(50.0, 0.0)
    signal.observe(10.0, 1.0)
    assert signal.latest_good == 10.0
