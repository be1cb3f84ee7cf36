"""One signal: its state, and the text about it."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Optional

import pytest

from robot_health_monitor.core import Level, Status, Transition, explanation
from robot_health_monitor.core.config import read_signal
from robot_health_monitor.core.monitor import LINK_CONFIG
from robot_health_monitor.core.signal_monitor import SignalMonitor


def watch(name: str = "battery_level", **settings: Any) -> SignalMonitor:
    return SignalMonitor(read_signal(name, settings), "atlas", 0.0)


def status(signal: SignalMonitor, now_s: float) -> Status:
    return explanation.status(signal.judgement(now_s))


def message(signal: SignalMonitor, now_s: float) -> str:
    return status(signal, now_s).message


def state(signal: SignalMonitor, now_s: float) -> str:
    return status(signal, now_s).values["state"]


# --- the key-values of a status -------------------------------------------------------------------------------------


def test_a_status_carries_value_unit_statistics_bounds_state_since_and_counts() -> None:
    signal = watch(
        unit="%",
        valid_min=0.0,
        valid_max=100.0,
        warn_below=20.0,
        error_below=10.0,
        hysteresis=2.0,
        for_s=1.0,
        window_min_s=0.0,
    )
    signal.observe(16.0, 10.0)
    signal.observe(14.0, 12.0)
    signal.observe(math.nan, 12.0)
    found = status(signal, 13.0)

    assert (found.name, found.level, found.hardware_id) == ("battery_level", Level.ERROR, "atlas")
    assert found.values == {
        "value": "nan",
        "unit": "%",
        "statistic": "last",
        "last": "14",
        "mean": "15",
        "min": "14",
        "max": "16",
        "stddev": "1",
        "rate": "-1",
        "frequency_hz": "0.5",
        "window_samples": "2",
        "good_samples": "2",
        "bad_samples": "1",
        "age_s": "1",
        "warn_below": "20",
        "error_below": "10",
        "valid_min": "0",
        "valid_max": "100",
        "hysteresis": "2",
        "for_s": "1",
        "keep_firing_for_s": "0",
        "stale_after_s": "5",
        "state": "invalid",
        "since": "12.000",
        "lasts_s": "1",
        "flapping": "false",
        "fingerprint": found.values["fingerprint"],
    }


def test_before_the_first_sample_there_is_no_value_and_no_age() -> None:
    values = status(watch(), 5.0).values
    assert values["value"] == "" and "age_s" not in values and "mean" not in values
    assert (values["good_samples"], values["bad_samples"]) == ("0", "0")


def test_state_change_is_told_where_flapping_is_looked_for() -> None:
    assert "state_change_percent" not in status(watch(), 0.0).values
    assert status(watch(flap_detection=True), 0.0).values["state_change_percent"] == "0"


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


# --- why, in words --------------------------------------------------------------------------------------------------


def last_text(transitions: List[Optional[Transition]]) -> str:
    (found,) = [each for each in transitions if each is not None][-1:]
    return found.text


@pytest.mark.parametrize(
    ("settings", "samples", "text"),
    [
        ({"warn_above": 80.0, "unit": "degC"}, [80.5], "WARN: 80.5 degC is above 80 degC (was OK for 1 s)"),
        ({"warn_above": 80.0}, [80.5, 79.0], "OK: 79 is no longer above 80 (was WARN for 1 s)"),
        ({"error_below": 10.0, "warn_below": 20.0}, [5.0, 15.0], "WARN: 15 is below 20 (was ERROR for 1 s)"),
        ({"error_below": 10.0, "warn_below": 20.0}, [5.0, 50.0], "OK: 50 is no longer below 10 (was ERROR for 1 s)"),
        ({"warn_below": 20.0}, [19.299999237060547], "WARN: 19.3 is below 20 (was OK for 1 s)"),
        ({"warn_below": 20.0}, [19.99999], "WARN: 19.99999 is below 20 (was OK for 1 s)"),
        ({"warn_below": 0.15}, [0.1], "WARN: 0.1 is below 0.15 (was OK for 1 s)"),
        ({"warn_below": 50.0, "warn_above": 50.0}, [51.0], "WARN: 51 is above 50 (was OK for 1 s)"),
        ({}, [math.nan, 50.0], "OK: 50 (was ERROR for 1 s)"),
    ],
)
def test_a_line_says_which_value_which_bound_and_since_when(
    settings: Dict[str, Any], samples: List[float], text: str
) -> None:
    signal = watch(**settings)
    transitions = [signal.observe(value, second) for second, value in enumerate(samples, 1)]
    assert last_text(transitions) == f"battery_level {text}"


def test_a_value_inside_the_hysteresis_is_not_said_to_be_beyond_the_bound() -> None:
    signal = watch(warn_below=20.0, hysteresis=2.0, unit="%", stale_after_s=5.0, repeat_s=3.0)
    signal.observe(19.0, 1.0)
    signal.observe(21.0, 2.0)
    assert message(signal, 2.0) == "21 % was below 20 %, clears at 22 %"
    repeated = signal.tick(4.0)
    assert repeated is not None
    assert repeated.text == "battery_level WARN: 21 % was below 20 %, clears at 22 % (for 3 s)"
    signal.tick(8.0)
    back = signal.observe(21.0, 9.0)
    assert back is not None
    assert back.text == "battery_level WARN: 21 % was below 20 %, clears at 22 % (was STALE for 1 s)"


def test_a_warning_that_keeps_firing_says_that_the_value_is_back() -> None:
    signal = watch(warn_below=20.0, keep_firing_for_s=10.0)
    signal.observe(15.0, 1.0)
    signal.observe(25.0, 2.0)
    assert message(signal, 2.0) == "25 is no longer below 20, held by keep_firing_for_s"


def test_a_pending_rule_says_for_how_long() -> None:
    signal = watch(warn_below=20.0, for_s=10.0)
    signal.observe(15.0, 1.0)
    signal.observe(14.0, 4.0)
    assert message(signal, 4.0) == "14 is below 20, pending for 3 s"


def test_a_healthy_signal_says_its_value() -> None:
    signal = watch(unit="%", warn_below=20.0)
    signal.observe(55.5, 1.0)
    assert message(signal, 1.0) == "55.5 %"
    assert message(watch(), 1.0) == "waiting for the first sample"


def test_the_silence_in_a_message_goes_on_with_the_time_of_the_report() -> None:
    signal = watch(stale_after_s=5.0)
    signal.observe(50.0, 0.0)
    signal.tick(6.0)
    assert message(signal, 30.0) == "no sample for 30 s (limit 5 s)"


def link() -> SignalMonitor:
    return SignalMonitor(LINK_CONFIG, "atlas", 0.0)


def test_a_link_is_up_or_down_in_words() -> None:
    signal = link()
    signal.observe(1.0, 0.0)
    assert message(signal, 0.0) == "up"
    down = signal.observe(0.0, 4.0)
    assert down is not None and down.text == "link ERROR: down (was OK for 4 s)"
    signal.observe(1.0, 5.0)
    assert message(signal, 5.0) == "up, held by keep_firing_for_s"
    assert signal.tick(6.9) is None
    up = signal.tick(7.0)
    assert up is not None and up.text == "link OK: up (was ERROR for 3 s)"


def test_a_link_that_is_down_names_the_cause() -> None:
    signal = link()
    signal.cause = "connection refused"
    down = signal.observe(0.0, 4.0)
    assert down is not None and down.text == "link ERROR: down: connection refused (was OK for 4 s)"


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
