"""What recordings suggest, computed by hand from the rules of docs/statistics.md, and quantiles of streams."""

from __future__ import annotations

from typing import Any, Sequence

import pytest
from harness.seeds import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.proposal import suggestion
from robot_health_monitor.core.proposal.measured import Measured
from robot_health_monitor.core.proposal.suggestion import Signal


def measured(values: Sequence[float], interval_s: float = 1.0, **signal: Any) -> Measured:
    result = Measured(read_signal("battery", signal))
    result.begin_recording()
    for number, value in enumerate(values):
        result.add(number * interval_s, value)
    return result


def suggest(found: Measured, longest_s: float = 0.0) -> Signal:
    signal = Signal("battery", "/battery", "number", {}, measured=found)
    suggestion.suggest(signal, longest_s)
    return signal


STEPS = [50.5, 60.5] * 500
"""1,000 values; each is 10 from the one before."""
RAMP = [40.0 + 0.02 * (each if each < 500 else 1000 - each) for each in range(1000)]
"""From 40 to 50 and back in steps of 0.02."""


def test_bounds_are_the_quantiles_with_a_margin_rounded_outward() -> None:
    # 0.1 % of 1,000 values: above the lowest, 40.02; 99.9 %: 49.98. Margin 0.996, outward to a multiple of 0.1.
    settings = suggest(measured(RAMP)).proposed
    assert settings["warn_below"].value == 39.0
    assert settings["warn_above"].value == 51.0
    assert settings["warn_below"].evidence == "0.1 % of the samples are below 40.02, lowest 40; margin 0.996"


def test_a_count_has_a_bound_above_and_no_staleness() -> None:
    found = suggest(
        measured([float(each % 23) for each in range(1200)], statistic="count", field="", where="level >= ERROR")
    )
    assert set(found.proposed) <= {"warn_above", "hysteresis"}
    assert found.proposed["warn_above"].value > 22.0


def test_hysteresis_is_the_noise_rounded_up() -> None:
    setting = suggest(measured(RAMP)).proposed["hysteresis"]
    assert (setting.value, setting.evidence) == (0.02, "95 % of the steps between samples are at most 0.02")


def test_a_margin_is_at_least_the_noise_and_an_alert_can_clear() -> None:
    # Noise 10: bounds 50.5 - 10 and 60.5 + 10, outward to a multiple of 10. Half of the 10.5 from 40 to the median.
    settings = suggest(measured(STEPS)).proposed
    assert {key: setting.value for key, setting in settings.items()} == {
        "warn_below": 40.0,
        "warn_above": 80.0,
        "hysteresis": 5.2,
        "stale_after_s": 5.0,
    }


def test_a_margin_is_at_least_1_percent_of_the_value() -> None:
    settings = suggest(measured([100.0, 100.01, 100.02] * 300)).proposed
    assert settings["warn_below"].value == 98.0  # 100 - 1.0002, a multiple of 1
    assert settings["warn_above"].value == 102.0


def test_short_excursions_give_a_duration_and_long_ones_move_the_bound() -> None:
    values = RAMP * 5
    values[300:302] = [90.0] * 2  # beyond the quantile of 99.9 %; one value alone may be an error of the sensor
    short = suggest(measured(values), 4.0).proposed
    assert (short["warn_above"].value, short["for_s"].value) == (51.0, 6.0)
    assert short["for_s"].evidence == "longest healthy excursion beyond a bound 4 s"
    long = suggest(measured(values), 61.0).proposed
    assert long["warn_above"].value == 91.0  # 90 + 1
    assert "for_s" not in long
    assert long["warn_above"].evidence.startswith("highest 90; margin ")


@pytest.mark.parametrize(
    ("values", "signal", "reason"),
    [
        (RAMP[:99], {}, "only 99 valid samples in 98 s; a range needs 100: listen for 120 s"),
        ([float("nan")] * 200, {}, "no valid value"),
        ([7.0] * 1000, {}, "the value is always 7"),
        ([0.0, 1.0, 4.0] * 400, {}, "only the values 0, 1, 4: looks like a code"),
        ([float(each) for each in range(1000)], {}, "the value only rises: looks like a counter"),
    ],
)
def test_bounds_that_the_data_cannot_justify_are_left_out(values: Sequence[float], signal: Any, reason: str) -> None:
    found = suggest(measured(values, **signal))
    assert found.left_out == [f"no bounds: {reason}"]
    assert list(found.proposed) == ["stale_after_s"]


def test_a_battery_that_only_falls_is_no_counter() -> None:
    assert suggest(measured([90.0 - 0.01 * each for each in range(1000)])).has_bounds


@pytest.mark.parametrize(
    ("values", "signal", "left_out"),
    [
        (
            [99.0 + 0.001 * each for each in range(999)][::-1],
            {"unit": "%"},
            "no warn_above: 101 is not below 100, the limit of its values",
        ),
        (
            [99.0 + 0.001 * each for each in range(999)][::-1],
            {"valid_max": 99.999},
            "no warn_above: 101 is not below 99.999, the limit of its values",
        ),
        (
            [0.001 * each for each in range(1000)][::-1],
            {},
            "no warn_below: -0.1 is not above 0, the limit of its values",
        ),
    ],
)
def test_a_bound_that_no_value_can_cross_is_left_out(values: Sequence[float], signal: Any, left_out: str) -> None:
    found = suggest(measured(values, **signal))
    assert len(found.left_out) == 1
    assert found.left_out[0].split(" is ")[1] == left_out.split(" is ")[1]
    assert found.has_bounds


def test_staleness_is_twice_the_longest_gap_or_five_intervals() -> None:
    assert suggest(measured(RAMP, 0.5)).proposed["stale_after_s"].value == 2.5
    late = measured(RAMP[250:750])
    late.add(506.0, 45.0)  # 7 s after the last
    setting = suggest(late).proposed["stale_after_s"]
    assert (setting.value, setting.evidence) == (14.0, "longest gap 7 s, median 1 s")


def test_the_time_between_two_recordings_is_no_gap() -> None:
    both = measured(RAMP)
    both.begin_recording()
    for number, value in enumerate(RAMP):
        both.add(1e6 + number, value)
    assert suggest(both).proposed["stale_after_s"].value == 5.0
    assert both.duration_s == 1998.0


def test_a_few_samples_do_not_show_a_rate() -> None:
    assert suggest(measured(RAMP[:5])).proposed["stale_after_s"].value == 0.0


def test_invalid_samples_are_counted_and_left_out() -> None:
    values = measured([*RAMP, float("nan")])
    assert values.bad_samples == 1
    assert suggest(values).proposed["warn_above"].value == 51.0


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(-1000.0, 1000.0),
    st.sampled_from([0.0, 1.0, 100.0, -1e308, 1.7e308, 5e-324]),
)


@pytest.mark.newest_python
@settings(max_examples=examples(100))
@given(
    st.lists(NUMBERS, min_size=1, max_size=30), st.sampled_from(["", "%", "degC", "V"]), st.floats(0.0, 1e6), st.data()
)
def test_every_suggestion_is_a_valid_configuration(
    values: list[float], unit: str, excursion_s: float, data: Any
) -> None:
    repeated = measured(values * 20, data.draw(st.sampled_from([0.001, 1.0, 1e6])), unit=unit)
    found = suggest(repeated, excursion_s)
    keys = {key: setting.value for key, setting in found.proposed.items()}
    read_signal("battery", {"unit": unit, **keys})
    low, high = keys.get("warn_below"), keys.get("warn_above")
    if excursion_s > 60.0 and low is not None:
        assert low <= min(values)
    if excursion_s > 60.0 and high is not None:
        assert high >= max(values)


@pytest.mark.parametrize("outlier", [3e38, 1e6])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_one_error_of_a_sensor_does_not_widen_a_bound(outlier: float, sign: float) -> None:
    values = [50.0 + (number % 10) / 10.0 for number in range(700)]
    expected = {key: setting.value for key, setting in suggest(measured(values)).proposed.items()}
    values[300] = sign * outlier
    for longest_s in (0.0, 1.0, 100.0):
        found = suggest(measured(values), longest_s).proposed
        assert {key: found[key].value for key in ("warn_below", "warn_above")} == {
            key: expected[key] for key in ("warn_below", "warn_above")
        }


def test_values_that_are_not_rare_are_no_errors() -> None:
    values = [50.0 + (number % 10) / 10.0 for number in range(700)]
    values[100:110] = [200.5 + number for number in range(10)]
    assert suggest(measured(values)).proposed["warn_above"].value > 200.0


@pytest.mark.parametrize(
    ("messages", "interval_s", "bounds", "evidence"),
    [
        (1470, 1 / 30, (21.0, 39.0), "margin 30 %, seen for 49 s only"),
        (12_000, 1 / 30, (24.0, 36.0), "margin 20 %"),
        (20, 1 / 30, (21.0, 39.0), "margin 30 %, seen for 0.633 s only"),
    ],
)
def test_a_rate_has_a_margin_of_20_or_30_percent(messages: int, interval_s: float, bounds: Any, evidence: str) -> None:
    found = suggest(measured([30.0] * messages, interval_s, field="", statistic="frequency_hz", unit=""))
    assert (found.proposed["warn_below"].value, found.proposed["warn_above"].value) == bounds
    assert found.proposed["warn_below"].evidence.endswith(evidence)


def test_a_rate_needs_20_messages() -> None:
    found = suggest(measured([30.0] * 19, 1 / 30, field="", statistic="frequency_hz", unit=""))
    assert "warn_below" not in found.proposed
    assert found.left_out == ["no bounds: only 19 messages in 0.6 s: a rate needs 20"]


def test_a_range_that_was_seen_for_less_than_10_minutes_is_no_bound() -> None:
    found = suggest(measured(RAMP[250:750]))
    assert (set(found.proposed), set(found.seen)) == ({"stale_after_s"}, {"warn_below", "warn_above", "hysteresis"})
    assert found.left_out == ["the range was seen for 499 s only, expected at least 10 min"]
    assert suggest(measured(RAMP[250:950])).seen == {}
