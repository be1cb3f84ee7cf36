"""Valid numbers, bad data, counts, and data that looks wrong: what is suspected, what the status then says."""

from __future__ import annotations

import math
from typing import Any, Iterable, Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.judge.quality import as_float, number_of
from robot_health_monitor.core.values.model import Status


def valid_number(datum: object, **settings: Any) -> float:
    """Returns the number of a datum as a monitor judges it; NaN if it is bad."""
    monitor = Monitor(load_config({"signals": {"battery": settings}}))
    monitor.observe(Sample("battery", datum, 0.0))
    judgement = monitor.judgements(0.0)["battery"]
    assert judgement.good_samples + judgement.bad_samples == 1
    number = number_of(judgement.config, datum)
    assert judgement.judged is None or judgement.judged == number
    return math.nan if judgement.judged is None else judgement.judged


@pytest.mark.parametrize(
    ("value", "number"), [(19.5, 19.5), (True, 1.0), (20, 20.0), (-0.0, 0.0), (1.7e308, 1.7e308), (5e-324, 5e-324)]
)
def test_real_numbers_are_good(value: object, number: float) -> None:
    assert valid_number(value) == number


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, None, "19.5", [1.0], 10**400, 1 + 2j])
def test_what_is_no_finite_real_number_is_bad(value: object) -> None:
    assert math.isnan(valid_number(value))


@pytest.mark.parametrize(("value", "good"), [(0.0, True), (100.0, True), (-0.001, False), (100.001, False)])
def test_the_ends_of_the_valid_range_are_valid(value: float, good: bool) -> None:
    assert math.isnan(valid_number(value, valid_min=0.0, valid_max=100.0)) is not good


def test_a_placeholder_is_bad_and_scale_converts_the_rest() -> None:
    assert math.isnan(valid_number(-1.0, scale=100.0, placeholders=[-1.0]))
    assert valid_number(0.25, scale=100.0, placeholders=[-1.0]) == 25.0


def test_good_and_bad_samples_are_counted_also_after_a_new_configuration() -> None:
    monitor = Monitor(load_config({"signals": {"battery": {}}}))
    monitor.observe(Sample("battery", 5.0, 0.0))
    monitor.configure(load_config({"signals": {"battery": {"valid_max": 1.0}}}))
    monitor.observe(Sample("battery", 5.0, 1.0))
    judgement = monitor.judgements(1.0)["battery"]
    assert (judgement.good_samples, judgement.bad_samples, judgement.latest) == (1, 1, 5.0)


def test_a_number_whose_conversion_raises_is_no_number() -> None:
    class Broken(float):
        def __float__(self) -> float:
            raise RuntimeError

    assert math.isnan(as_float(Broken(1.0)))


BATTERY = {"unit": "%", "valid_min": 0.0, "valid_max": 100.0, "warn_below": 20.0}
CELSIUS = {"unit": "degC", "valid_max": 150.0, "warn_above": 80.0}


def float32(number: float) -> float:
    """Returns what is left of a number in a Float32: 24 bits."""
    mantissa, exponent = math.frexp(number)
    return math.ldexp(round(mantissa * 2**24), exponent - 24)


def status_after(values: Iterable[object], **config: Any) -> Status:
    monitor = Monitor(load_config({"signals": {"battery": config}}))
    now_s = 0.0
    for value in values:
        monitor.observe(Sample("battery", value, now_s))
        now_s += 1.0
    return monitor.report(now_s).statuses["battery"]


def suspicion_after(values: Iterable[object], **config: Any) -> str:
    """Returns what the status suspects, empty when it suspects nothing."""
    return status_after(values, **config).message.partition("suspicious data: ")[2]


def test_a_fraction_where_a_percentage_should_be_is_suspected_from_the_20th_sample_on() -> None:
    assert suspicion_after([0.85] * 19, **BATTERY) == ""
    assert suspicion_after([0.85] * 20, **BATTERY) == (
        "values from 0 to 1, the last 0.85, look like a fraction, not like %; if so, set scale: 100"
    )


def test_a_suspected_value_is_shown_and_judged_as_it_came() -> None:
    status = status_after([0.85] * 20, **BATTERY)
    assert status.level is Level.WARN
    assert status.values["value"] == "0.85"
    assert status.message.startswith("0.85 % is below 20 %, suspicious data: ")


def test_fractions_are_suspected_without_any_bound() -> None:
    assert suspicion_after([0.5] * 20, unit="%").startswith("values from 0 to 1, the last 0.5, ")


def test_a_value_outside_of_0_to_1_in_the_window_ends_the_suspicion() -> None:
    assert suspicion_after([0.85] * 20 + [85.0], **BATTERY) == ""
    assert suspicion_after([0.85] * 20 + [85.0] + [0.85] * 60, **BATTERY) == ""
    assert suspicion_after([0.85] * 20 + [85.0] + [0.85] * 61, **BATTERY) != ""
    assert suspicion_after([0.85] * 19 + [-0.5] + [0.85] * 19, unit="%") == ""


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_a_run_of_only_0_or_only_1_is_no_fraction(value: float) -> None:
    assert "fraction" not in suspicion_after([value] * 40, **BATTERY)


@pytest.mark.parametrize("value", [-0.01, float32(-0.01)])
def test_minus_001_is_suspected_to_mean_not_measured(value: float) -> None:
    expected = "-0.01 is what some drivers send for 'not measured'; if so, set placeholders: [-0.01]"
    assert suspicion_after([50.0, value], **BATTERY) == expected
    assert suspicion_after([value], **{**BATTERY, "valid_min": 0.0}) == expected


@pytest.mark.parametrize("value", [-0.011, -0.0099, -1.0, 0.01])
def test_other_small_numbers_are_no_placeholder(value: float) -> None:
    assert "placeholder" not in suspicion_after([value], **BATTERY)


def test_nothing_but_zero_is_suspected_from_the_20th_sample_on() -> None:
    assert suspicion_after([0.0] * 19, **BATTERY) == ""
    assert suspicion_after([0.0] * 20, **BATTERY) == (
        "nothing but 0; if it means 'not measured', set placeholders: [0.0]"
    )
    assert suspicion_after([0.0] * 20 + [12.0], **BATTERY) == ""
    assert suspicion_after([3.0] + [0.0] * 40, **BATTERY) == ""  # a battery that has run empty


def test_zero_is_no_news_for_a_flag_or_for_what_has_no_lower_bound() -> None:
    assert suspicion_after([0.0] * 40, warn_below=1.0) == ""
    assert suspicion_after([0.0] * 40, **CELSIUS) == ""


@pytest.mark.parametrize("value", [math.nan, None, "45.5 C", [math.nan, math.nan]])
def test_20_values_that_are_no_numbers_are_suspected_not_to_be_measured(value: object) -> None:
    expected = "20 values are not numbers; if the source does not measure this, use another field"
    assert suspicion_after([value] * 19, **BATTERY) == ""
    assert suspicion_after([value] * 20, **BATTERY) == expected
    assert suspicion_after([value] * 20 + [50.0], **BATTERY) == ""
    assert suspicion_after([50.0] + [value] * 20, **BATTERY) == expected


def test_a_run_of_0_and_1_mixed_is_no_fraction_until_one_lies_between() -> None:
    assert suspicion_after([0.0, 1.0] * 20, **BATTERY) == ""
    assert "fraction" in suspicion_after([0.0, 1.0] * 20 + [0.5], **BATTERY)


def test_a_fraction_is_no_news_where_the_unit_is_none() -> None:
    assert suspicion_after([0.85] * 40, valid_min=0.0, valid_max=1.0, warn_below=0.2) == ""


def test_a_scale_that_makes_fractions_is_named_with_the_one_that_does_not() -> None:
    assert suspicion_after([85.0] * 20, unit="%", scale=0.01).endswith("if so, set scale: 1")


def test_a_percentage_where_the_scale_expects_a_fraction_is_suspected() -> None:
    status = status_after([85.0], **{**BATTERY, "scale": 100.0})
    assert status.level is Level.ERROR
    assert status.message == (
        "invalid data: 8500 % is above valid_max 100, suspicious data:"
        " 85 looks like a percentage already, not like a fraction; if so, set scale: 1"
    )


def test_a_percentage_where_the_scale_expects_a_fraction_is_suspected_without_a_valid_range_too() -> None:
    assert suspicion_after([85.0], unit="%", scale=100.0) == (
        "85 looks like a percentage already, not like a fraction; if so, set scale: 1"
    )


def test_a_percentage_where_the_range_says_fraction_is_suspected() -> None:
    assert suspicion_after([85.0], valid_min=0.0, valid_max=1.0) == (
        "85 looks like a percentage, not like a fraction; if so, set scale: 0.01"
    )


@pytest.mark.parametrize("value", [0.0, -0.01, float32(-0.01)])
def test_a_placeholder_that_is_configured_is_invalid_and_not_suspected(value: float) -> None:
    status = status_after([value] * 30, **BATTERY, placeholders=[0.0, -0.01])
    assert status.level is Level.ERROR
    assert status.values["bad_samples"] == "30"
    shown = "0" if value == 0.0 else "-0.01"
    assert status.message == f"invalid data: {shown} is a placeholder for 'not measured'"


@pytest.mark.parametrize(
    ("value", "config", "expected"),
    [
        (45500.0, {"unit": "degC"}, "45500 is implausibly high for degC; check unit and scale, or set valid_max"),
        (200.5, {"unit": "°C"}, "200.5 is implausibly high for °C; check unit and scale, or set valid_max"),
        (24100.0, {"unit": "V"}, "24100 is implausibly high for V; check unit and scale, or set valid_max"),
        (2100.0, {"unit": "A"}, "2100 is implausibly high for A; check unit and scale, or set valid_max"),
        (130.0, {"unit": "%"}, "130 is implausibly high for %; check unit and scale, or set valid_max"),
    ],
)
def test_a_unit_that_does_not_fit_is_suspected(value: float, config: Mapping[str, Any], expected: str) -> None:
    assert suspicion_after([value], **config) == expected


@pytest.mark.parametrize(
    ("value", "config"),
    [
        (150.0, CELSIUS),
        (318.65, {"unit": "degC", "valid_max": 900.0}),
        (318.65, {"unit": "K"}),
        (1.0e6, {"unit": "W"}),
        (1.0e6, {}),
        (200.0, {"unit": "degC"}),
        (160.0, CELSIUS),
        (-300.0, {"unit": "degC", "valid_min": -40.0}),
    ],
)
def test_a_unit_that_may_fit_is_not_suspected(value: float, config: Mapping[str, Any]) -> None:
    assert suspicion_after([value], **config) == ""


@pytest.mark.parametrize(("value", "config"), [(25_000.0, {"unit": "degC"}), (130.0, {"unit": "%"})])
def test_the_suspicion_of_a_value_ends_with_the_next_ordinary_one(value: float, config: Mapping[str, Any]) -> None:
    assert suspicion_after([50.0, value], **config) != ""
    assert suspicion_after([50.0, value, 50.0], **config) == ""


def test_the_suspicion_ends_with_a_new_configuration() -> None:
    monitor = Monitor(load_config({"signals": {"battery": BATTERY}}))
    for now_s in range(20):
        monitor.observe(Sample("battery", 0.85, float(now_s)))
    monitor.configure(load_config({"signals": {"battery": {**BATTERY, "scale": 100.0}}}))
    monitor.observe(Sample("battery", 0.85, 20.0))
    status = monitor.report(20.0).statuses["battery"]
    assert (status.level, status.message) == (Level.OK, "85 %")


UNITS = st.sampled_from(["", "%", "degC", "°C", "V", "A", "K", "W"])
VALUES = st.one_of(st.floats(), st.sampled_from([0.0, 1.0, 0.5, -0.01, 100.0, 45500.0, 300.0, None, True, "7"]))


@given(UNITS, st.sampled_from([1.0, 100.0, 0.001, -1.0]), st.booleans(), st.lists(VALUES, max_size=60))
def test_a_suspicion_never_changes_a_level(unit: str, scale: float, bounded: bool, values: list) -> None:
    config = {"scale": scale, "warn_below": 20.0, "error_above": 90.0}
    if bounded:
        config["valid_max"] = 100.0
    with_unit = Monitor(load_config({"signals": {"battery": {**config, "unit": unit}}}))
    without = Monitor(load_config({"signals": {"battery": config}}))
    for now_s, value in enumerate(values):
        sample = Sample("battery", value, float(now_s))
        levels = [[transition.to_level for transition in monitor.observe(sample)] for monitor in (with_unit, without)]
        assert levels[0] == levels[1]
