"""What a status and an alert line say about one signal."""

from __future__ import annotations

import math
from typing import Any

import pytest

from robot_health_monitor.core import Level, Status, Transition
from robot_health_monitor.core.config.signal_config import LINK_CONFIG, read_signal
from robot_health_monitor.core.judge import wording
from robot_health_monitor.core.judge.signal_monitor import SignalMonitor
from robot_health_monitor.core.values.elements import LinkDown


def watch(name: str = "battery_level", **settings: Any) -> SignalMonitor:
    return SignalMonitor(read_signal(name, settings), "atlas", 0.0)


def status(signal: SignalMonitor, now_s: float) -> Status:
    return wording.status(signal.judgement(now_s))


def message(signal: SignalMonitor, now_s: float) -> str:
    return status(signal, now_s).message


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
    assert (found.state, found.lasts_s, found.silence) == ("invalid", 1.0, None)
    assert found.values == {
        "value": "nan",
        "unit": "%",
        "statistic": "last",
        "last": "14",
        "mean": "15",
        "min": "14",
        "max": "16",
        "stddev": "1",
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


def test_state_change_is_shown_where_flap_detection_is_enabled() -> None:
    assert "state_change_percent" not in status(watch(), 0.0).values
    assert status(watch(flap_detection=True), 0.0).values["state_change_percent"] == "0"


# --- why, in words --------------------------------------------------------------------------------------------------


def last_text(transitions: list[Transition | None]) -> str:
    (found,) = [each for each in transitions if each is not None][-1:]
    return found.text


@pytest.mark.parametrize(
    ("settings", "samples", "text"),
    [
        ({"warn_above": 80.0, "unit": "degC"}, [80.5], "WARN: 80.5 degC is above 80 degC (was unknown for 1 s)"),
        ({"warn_above": 80.0}, [80.5, 79.0], "OK: 79 is no longer above 80 (was WARN for 1 s)"),
        ({"error_below": 10.0, "warn_below": 20.0}, [5.0, 15.0], "WARN: 15 is below 20 (was ERROR for 1 s)"),
        ({"error_below": 10.0, "warn_below": 20.0}, [5.0, 50.0], "OK: 50 is no longer below 20 (was ERROR for 1 s)"),
        ({"error_below": 10.0, "warn_above": 90.0}, [5.0, 50.0], "OK: 50 is no longer below 10 (was ERROR for 1 s)"),
        ({"warn_below": 20.0}, [19.299999237060547], "WARN: 19.3 is below 20 (was unknown for 1 s)"),
        ({"warn_below": 20.0}, [19.99999], "WARN: 19.99999 is below 20 (was unknown for 1 s)"),
        ({"warn_below": 0.15}, [0.1], "WARN: 0.1 is below 0.15 (was unknown for 1 s)"),
        ({"warn_below": 50.0, "warn_above": 50.0}, [51.0], "WARN: 51 is above 50 (was unknown for 1 s)"),
        ({}, [math.nan, 50.0], "OK: 50 (was ERROR for 1 s)"),
    ],
)
def test_a_line_contains_value_bound_and_duration(settings: dict[str, Any], samples: list[float], text: str) -> None:
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
    assert message(signal, 2.0) == "25 is no longer below 20, still firing until keep_firing_for_s has passed"


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


def test_the_silence_in_a_message_grows_with_the_time_of_the_report() -> None:
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
    assert message(signal, 5.0) == "up, still firing until keep_firing_for_s has passed"
    assert signal.tick(14.9) is None
    up = signal.tick(15.0)
    assert up is not None and up.text == "link OK: up (was ERROR for 11 s)"


def test_a_link_that_is_down_names_the_cause() -> None:
    signal = link()
    down = signal.observe(LinkDown("connection refused"), 4.0)
    assert down is not None and down.text == "link ERROR: down: connection refused (was never up)"


@pytest.mark.parametrize(
    ("settings", "samples", "expected"),
    [
        ({}, [], "waiting for the first sample"),
        ({"statistic": "mean", "unit": "%"}, [50.0], "mean is undefined until window_min_s (30 s) has passed"),
        ({"statistic": "rate", "window_min_s": 0.0}, [50.0], "rate is undefined: too few samples"),
        ({"statistic": "mean", "window_min_s": 0.0, "unit": "%"}, [50.0], "50 %"),
        ({"statistic": "frequency_hz", "window_min_s": 0.0}, [1.0, 1.0], "1 Hz"),
        ({"invalid_for_s": 9.0}, [None], "no valid sample yet: None"),
    ],
)
def test_the_message_of_a_signal_that_is_not_judged_or_healthy(
    settings: dict[str, Any], samples: list[Any], expected: str
) -> None:
    signal = watch(**settings)
    for second, value in enumerate(samples):
        signal.observe(value, float(second))
    assert message(signal, 1.0) == expected


def test_the_judged_statistic_is_not_shown_before_it_is_defined() -> None:
    signal = watch(statistic="mean")
    signal.observe(50.0, 0.0)
    values = status(signal, 0.0).values
    assert "mean" not in values
    assert values["max"] == "50"  # only shown


def test_a_status_of_an_unreachable_signal_has_its_last_value_and_age() -> None:
    signal = watch(unit="%")
    signal.observe(50.0, 1.0)
    signal.inhibit(3.0)
    assert message(signal, 10.0) == "link down, last value 50 % 9 s ago"
    assert status(signal, 10.0).values["since"] == "3.000"
    assert status(signal, 10.0).level is Level.STALE


FORECAST: dict[str, Any] = {"statistic": "forecast", "unit": "%", "window_s": 40.0, "forecast_s": 60.0}


def falling(to_s: int, per_s: float = 0.5, **settings: Any) -> SignalMonitor:
    """A signal at 100 % at 0 s, which then loses `per_s` per second."""
    signal = watch(**{**FORECAST, **settings})
    for second in range(to_s + 1):
        signal.observe(100.0 - per_s * second, float(second))
    return signal


@pytest.mark.parametrize(
    ("settings", "now_s", "text"),
    [
        ({"warn_below": 20.0}, 100, "reaches 20 % in 60 s"),
        ({"warn_below": 20.0}, 30, ""),  # undefined until 40 s
        ({"warn_below": 70.0, "error_below": 20.0}, 100, "reaches 20 % in 60 s"),  # the other one is crossed
        ({"warn_below": 70.0}, 100, ""),
        ({"warn_below": -280.0, "unit": "m"}, 100, ""),  # 660 s ahead: more than 10 times the horizon
        ({"warn_below": -246.2, "unit": "m"}, 100, "reaches -246.2 m in 592 s"),
        ({}, 100, ""),
    ],
)
def test_a_forecast_says_when_its_line_reaches_the_nearest_bound_ahead(
    settings: dict[str, Any], now_s: int, text: str
) -> None:
    assert status(falling(now_s, **settings), float(now_s)).outlook == text


def test_the_outlook_of_a_forecast_has_no_seconds_from_ten_minutes_on() -> None:
    """100 % - 0.05 %/s: 98 % at 40 s, 93 % 100 s later, 68 % 599.6 s later."""
    assert status(falling(40, 0.05, warn_below=93.0), 40.0).outlook == "reaches 93 % in 100 s"
    assert status(falling(40, 0.05, warn_below=68.6), 40.0).outlook == "reaches 68.6 % in 588 s"
    signal = watch(**{**FORECAST, "forecast_s": 120.0}, warn_below=54.7)
    for second in range(41):
        signal.observe(100.0 - 0.05 * second, float(second))
    assert status(signal, 40.0).outlook == "reaches 54.7 % in 14 min"  # 866 s


def test_what_is_not_known_now_has_no_outlook() -> None:
    signal = falling(100, warn_below=20.0, stale_after_s=5.0, invalid_for_s=60.0)
    signal.observe(math.nan, 100.5)
    assert status(signal, 100.5).outlook == ""
    signal.observe(49.5, 101.0)
    assert status(signal, 101.0).outlook == "reaches 20 % in 59 s"
    signal.tick(107.0)
    assert status(signal, 107.0).outlook == ""
    linked = falling(100, warn_below=20.0)
    linked.inhibit(101.0)
    assert status(linked, 103.0).outlook == ""
    assert message(linked, 103.0) == "link down, last value 50 % 3 s ago"


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"statistic": "mean"}, "2 m"),
        ({"statistic": "rate"}, "1 m/s"),
        ({"statistic": "frequency_hz"}, "2 Hz"),
        ({"statistic": "largest_gap_s"}, "0.5 s"),
        ({"statistic": "forecast", "forecast_s": 6.0}, "forecast 9 m in 6 s"),
        ({"statistic": "last"}, "3 m"),
    ],
)
def test_a_signal_leads_with_its_statistic(settings: dict[str, Any], text: str) -> None:
    """1 m at 0 s and half a metre more every half second: 3 m at 2 s."""
    signal = watch(unit="m", window_s=2.0, window_min_s=0.0, **settings)
    samples = 10 if settings["statistic"] == "forecast" else 4
    for number in range(samples + 1):
        at_s = 2.0 * number / samples
        signal.observe(1.0 + at_s, at_s)
    found = status(signal, 2.0)
    assert (found.level, found.message, found.values["value"]) == (Level.OK, text, "3")
    assert wording.shown_text(signal.judgement(2.0)) == text


def test_long_durations_are_in_hours() -> None:
    signal = watch(warn_below=20.0, stale_after_s=0.0)
    signal.observe(50.0, 0.0)
    low = signal.observe(15.0, 90061.0)
    assert low is not None
    assert low.text == "battery_level WARN: 15 is below 20 (was OK for 25 h 1 min)"


def test_a_transition_and_its_status_have_one_reason() -> None:
    signal = watch(warn_below=20.0)
    signal.observe(50.0, 0.0)
    low = signal.observe(15.0, 4.0)
    assert low is not None
    assert low.text == f"battery_level WARN: {low.status.message} (was OK for 4 s)"
    assert low.status == status(signal, 4.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (100.04, "invalid data: 100.04 % is above valid_max 100"),
        (-0.00001, "invalid data: -1e-05 % is below valid_min 0"),
        (130.0, "invalid data: 130 % is above valid_max 100"),
    ],
)
def test_an_invalid_value_is_shown_on_its_side_of_the_limit(value: float, text: str) -> None:
    signal = watch(unit="%", valid_min=0.0, valid_max=100.0)
    signal.observe(value, 1.0)
    assert message(signal, 1.0) == text


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"warn_below": 20.0, "error_below": 10.0, "unit": "%"}, "WARN below 20 %, ERROR below 10 %"),
        ({"error_above": 95.5, "warn_above": 80.0}, "WARN above 80, ERROR above 95.5"),
        ({"warn_below": 27.0, "statistic": "frequency_hz", "unit": "m"}, "WARN below 27 Hz"),
        ({"warn_above": 0.5, "statistic": "rate", "unit": "degC"}, "WARN above 0.5 degC/s"),
        ({"stale_after_s": 3.0}, ""),
    ],
)
def test_bounds_are_put_in_words_with_the_unit_of_the_statistic(settings: dict[str, Any], text: str) -> None:
    assert wording.bounds_text(read_signal("a", settings)) == text


def test_the_source_of_a_signal_names_topic_statistic_and_bounds() -> None:
    scan = {"topic": "/scan", "statistic": "frequency_hz", "warn_below": 8.0}
    assert wording.source_text(read_signal("scan", scan), "/a/scan") == "scan on /a/scan: frequency_hz WARN below 8 Hz"
    assert wording.source_text(read_signal("battery", {"warn_below": 20.0}), "/b") == "battery on /b: WARN below 20"
    assert wording.source_text(read_signal("imu", {}), "/imu") == "imu on /imu"
