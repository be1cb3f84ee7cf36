"""Keys of a signal: defaults, and the error line of each mistake."""

from __future__ import annotations

import dataclasses
import math
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from harness.packaging_workspace import FOLDERS, NAME

from robot_health_monitor.core import ConfigError, load_config
from robot_health_monitor.core.config.signal_config import (
    CONDITIONS,
    SIGNAL_PARAMETERS,
    SignalConfig,
    read_signal,
)

ROOT = Path(__file__).resolve().parents[3]


def signal(**settings: Any) -> SignalConfig:
    return read_signal("battery_level", settings)


def refusal(**settings: Any) -> str:
    with pytest.raises(ConfigError) as raised:
        load_config({"signals": {"battery_level": settings}})
    text = str(raised.value)
    prefix = "signals.battery_level."
    assert text.startswith(prefix) and len(text.splitlines()) == 1
    return text[len(prefix) :]


def test_a_reduction_needs_a_field_with_several_elements() -> None:
    assert signal(field="cell_voltage[*]", reduce="min").reduce == "min"
    assert signal(field='effort["wheel_*"]', reduce="spread").reduce == "spread"
    expected = 'reduce: expected a field with [*] or a pattern such as ["*"], got '
    assert refusal(field="cell_voltage[0]", reduce="min") == f"{expected}'cell_voltage[0]'"
    assert refusal(field='effort["arm"]', reduce="min") == f"{expected}'effort[\"arm\"]'"


@pytest.mark.parametrize(
    ("settings", "unit"),
    [
        ({"field": "header.stamp"}, "s"),
        ({"field": "transforms[*].header.stamp", "reduce": "max"}, "s"),
        ({"field": "last_seen_stamp"}, "s"),
        ({"type": "sensor_msgs/msg/TimeReference", "field": "time_ref"}, "s"),
        ({"type": "std_msgs/Time"}, "s"),
        ({"field": "header.stamp", "unit": "ms", "scale": 1000.0}, "ms"),
        ({"field": "transforms[*].header.stamp", "reduce": "count"}, ""),
        ({"field": "header.stamp.sec"}, ""),
        ({"type": "std_msgs/Float32"}, ""),
    ],
)
def test_the_age_of_a_stamp_is_in_seconds_unless_a_unit_is_given(settings: dict[str, Any], unit: str) -> None:
    assert signal(**settings).unit == unit


def test_an_unknown_reduction_is_refused_with_those_that_exist() -> None:
    assert refusal(field="cell_voltage[*]", reduce="median") == (
        "reduce: expected one of nothing, min, max, mean, spread, sum, count, got 'median'"
    )


def test_a_field_selects_several_elements_once() -> None:
    assert refusal(field="packs[*].cells[*]", reduce="min").startswith(
        "field: expected the path of a field, got 'packs[*].cells[*]': only one part of a path may select several"
    )


def test_a_signal_needs_nothing() -> None:
    assert signal() == SignalConfig(
        name="battery_level",
        topic="battery_level",
        type="",
        field="data",
        reduce="",
        scale=1.0,
        unit="",
        placeholders=(),
        valid_min=None,
        valid_max=None,
        invalid_for_s=0.0,
        window_s=60.0,
        window_min_s=30.0,
        window_samples=6000,
        statistic="last",
        forecast_s=None,
        warn_below=None,
        warn_above=None,
        error_below=None,
        error_above=None,
        hysteresis=0.0,
        for_s=0.0,
        keep_firing_for_s=0.0,
        error_for_s=0.0,
        error_keep_firing_for_s=0.0,
        latch=False,
        flap_detection=False,
        flap_high=50.0,
        flap_low=25.0,
        stale_after_s=5.0,
        startup_grace_s=10.0,
        max_elements=200,
        forget_after_s=0.0,
        repeat_s=0.0,
        only_if=None,
        latch_release_if=None,
    )


def test_every_parameter_of_a_signal_has_a_field_and_every_field_a_parameter() -> None:
    fields = {field.name for field in dataclasses.fields(SignalConfig)}
    assert fields == {"name", *(parameter.name for parameter in SIGNAL_PARAMETERS), *CONDITIONS}


def test_durations_of_error_are_those_of_warn_unless_they_are_given() -> None:
    both = signal(for_s=3.0, keep_firing_for_s=4.0)
    assert (both.error_for_s, both.error_keep_firing_for_s) == (3.0, 4.0)
    own = signal(for_s=3.0, keep_firing_for_s=4.0, error_for_s=0.0, error_keep_firing_for_s=1.0)
    assert (own.error_for_s, own.error_keep_firing_for_s) == (0.0, 1.0)


def test_bounds_are_those_that_are_set() -> None:
    assert signal(warn_below=20, error_below=0.0).bounds == {"warn_below": 20.0, "error_below": 0.0}


@pytest.mark.parametrize(
    "settings",
    [
        {"warn_below": 20, "error_below": 20},
        {"warn_above": 80, "error_above": 80},
        {"warn_below": 20.0, "warn_above": 20.0},
        {"warn_below": 20.0, "warn_above": 22.0, "hysteresis": 2.0},
        {"valid_min": 5.0, "valid_max": 5.0},
        {"valid_min": 0.0, "warn_below": 0.0, "valid_max": 100.0, "warn_above": 100.0, "unit": "%"},
        {"valid_max": 100.0, "warn_below": 98.0, "hysteresis": 2.0},
        {"flap_high": 30.0, "flap_low": 30.0},
        {"unit": "degC", "valid_min": -273.15},
        {"unit": "%", "statistic": "rate", "warn_below": -200.0, "warn_above": 200.0},
        {"unit": "furlong", "warn_below": -1e300},
        {"valid_max": 10.0, "statistic": "stddev", "warn_above": 50.0},
    ],
)
def test_what_is_just_possible_loads(settings: dict[str, Any]) -> None:
    signal(**settings)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (
            {"warn_below": 20, "error_below": 30},
            "error_below: expected at most warn_below (20), got 30: a falling value crosses the WARN bound first",
        ),
        (
            {"warn_above": 80, "error_above": 70},
            "warn_above: expected at most error_above (70), got 80: a rising value crosses the WARN bound first",
        ),
        (
            {"warn_below": 80, "warn_above": 20},
            "warn_below: expected at most warn_above (20), got 80: no value would be OK",
        ),
        (
            {"error_below": 80, "warn_above": 20},
            "error_below: expected at most warn_above (20), got 80: no value would be OK",
        ),
        (
            {"valid_min": 5, "valid_max": 4},
            "valid_min: expected at most valid_max (4), got 5: no value would be valid",
        ),
        (
            {"warn_below": 20, "warn_above": 21, "hysteresis": 2},
            "hysteresis: expected at most 1, got 2: warn_below would clear above warn_above",
        ),
        ({"flap_low": 60}, "flap_low: expected at most flap_high (50), got 60"),
        ({"flap_high": 10}, "flap_high: expected at least flap_low (25), got 10"),
        ({"valid_max": 100, "warn_above": 120}, "warn_above: expected at most valid_max (100), got 120"),
        (
            {"valid_max": 100, "warn_above": 100.0000001},
            "warn_above: expected at most valid_max (100), got 100.0000001",
        ),
        ({"valid_min": 0, "error_below": -5}, "error_below: expected at least valid_min (0), got -5"),
        (
            {"valid_max": 100, "warn_below": 99, "hysteresis": 2},
            "hysteresis: expected at most 1, got 2: warn_below would clear above valid_max",
        ),
        (
            {"valid_min": 0, "warn_above": 1, "hysteresis": 2},
            "hysteresis: expected at most 1, got 2: warn_above would clear below valid_min",
        ),
        ({"scale": 0}, "scale: expected a number other than 0, got 0"),
    ],
)
def test_bounds_that_contradict_each_other_are_refused(settings: dict[str, Any], problem: str) -> None:
    assert refusal(**settings) == problem


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"warn_below": "low"}, "warn_below: expected a number, got 'low'"),
        ({"warn_below": math.nan}, "warn_below: expected a number, got nan"),
        ({"warn_above": math.inf}, "warn_above: expected a number, got inf"),
        ({"warn_below": True}, "warn_below: expected a number, got true"),
        ({"warn_below": None}, "warn_below: expected a number, got nothing"),
        ({"for_s": -1}, "for_s: expected a number from 0 to 31536000, got -1"),
        ({"window_s": 0}, "window_s: expected a number from 0.001 to 31536000, got 0"),
        ({"window_samples": 1.5}, "window_samples: expected a whole number from 1 to 1000000, got 1.5"),
        ({"flap_high": 101}, "flap_high: expected a number from 0 to 100, got 101"),
        ({"latch": "yes"}, "latch: expected true or false, got 'yes'"),
        ({"unit": 5}, "unit: expected printable text, got 5; quote it"),
        (
            {"statistic": "median"},
            "statistic: expected one of last, mean, min, max, stddev, rate, frequency_hz, largest_gap_s, count, "
            "forecast, got 'median'",
        ),
    ],
)
def test_wrong_kinds_and_ranges_are_refused(settings: dict[str, Any], problem: str) -> None:
    assert refusal(**settings) == problem


def test_an_unknown_key_is_refused_with_a_hint() -> None:
    assert refusal(warn_bellow=20) == "warn_bellow: unknown key; did you mean warn_below?"


@pytest.mark.parametrize(
    ("condition", "problem"),
    [
        ({"is": 0}, "only_if.signal: is missing; expected the name of the other signal"),
        ({"signal": "link"}, "only_if: expected one of is, is_not, below, above, between, got none"),
        (
            {"signal": "link", "is": 1, "above": 2},
            "only_if: expected one of is, is_not, below, above, between, got is and above",
        ),
        (
            {"signal": "battery_level", "is": 1},
            "only_if.signal: expected the name of another signal (link), got 'battery_level'",
        ),
        ({"signal": "charging", "is": 1}, "only_if.signal: expected the name of another signal (link), got 'charging'"),
        ("charging", "only_if: expected a mapping of keys to values, got 'charging'"),
    ],
)
def test_conditions_that_cannot_be_looked_at_are_refused(condition: object, problem: str) -> None:
    assert refusal(only_if=condition) == problem


@pytest.mark.parametrize(
    ("tree", "expected"),
    [({}, 30.0), ({"window_s": 4.0}, 2.0), ({"window_min_s": 0.0}, 0.0), ({"window_min_s": 60.0}, 60.0)],
)
def test_window_min_s_is_half_of_window_s_unless_it_is_given(tree: dict[str, float], expected: float) -> None:
    assert load_config({"signals": {"a": tree}}).signals["a"].window_min_s == expected


def test_window_min_s_above_window_s_is_an_error() -> None:
    with pytest.raises(ConfigError, match=r"^signals\.a\.window_min_s: expected at most window_s \(10\), got 11$"):
        load_config({"signals": {"a": {"window_s": 10.0, "window_min_s": 11.0}}})


def test_a_duration_is_at_most_a_year() -> None:
    for parameter in SIGNAL_PARAMETERS:
        if parameter.name.endswith("_s"):
            with pytest.raises(ConfigError, match=r"to 31536000, got 10000000000|window_s"):
                load_config({"signals": {"a": {parameter.name: 1e10}}})


@pytest.fixture
def with_a_new_key(tmp_path: Path) -> Path:
    """Returns a copy of the project whose table of keys has one more line."""
    for folder in (*FOLDERS, NAME, "launch"):
        shutil.copytree(ROOT / folder, tmp_path / folder, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "docs", tmp_path / "docs", ignore=shutil.ignore_patterns("pictures"))
    shutil.copy(ROOT / "package.xml", tmp_path)
    module = tmp_path / "core/config/signal_config.py"
    text = module.read_text(encoding="utf-8")
    first = "    topic: str = declared("
    assert text.count(first) == 1
    module.write_text(
        text.replace(first, f'    settle_s: float = _duration(2.5, "time to settle, in s", 0.5)\n{first}'), "utf-8"
    )
    return tmp_path


@pytest.mark.newest_python
def test_a_key_is_one_line_of_the_table(with_a_new_key: Path) -> None:
    def run(*command: str) -> str:
        done = subprocess.run(
            [sys.executable, *command],
            cwd=with_a_new_key,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=60,
            check=False,
        )
        return done.stdout.decode()

    def check(settings: str) -> str:
        file = with_a_new_key / "thresholds.yaml"
        file.write_text(f"alert_system: {{ros__parameters: {{signals: {{a: {settings}, b: {{}}}}}}}}\n")
        return run("-m", "robot_health_monitor", "check", str(file))

    assert "thresholds.yaml: OK" in check("{settle_s: 4}")
    assert "signals.a.settle_s: expected a number from 0.5 to 31536000, got 0.1" in check("{settle_s: 0.1}")
    code = """
from robot_health_monitor.core.config.monitor_config import described_parameters, load_config
config = load_config("thresholds.yaml")
print(config.signals["a"].settle_s, config.signals["b"].settle_s)
print([(each.name, each.default) for each in described_parameters(tuple(config.signals)) if "settle" in each.name])
"""
    check("{settle_s: 4}")
    assert run("-c", code).splitlines() == [
        "4.0 2.5",
        "[('signals.a.settle_s', 2.5), ('signals.b.settle_s', 2.5)]",
    ]
    run("docs/generate.py")
    page = (with_a_new_key / "docs/reference/parameters.md").read_text(encoding="utf-8")
    assert "| `settle_s` | a number from 0.5 to 31536000 | `2.5` | time to settle, in s |" in page


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"forecast_s": None}, "forecast_s: is missing; expected the time ahead in s"),
        ({"forecast_s": 0.0}, "forecast_s: expected a number from 0.001 to"),
        ({"forecast_s": 1801.0}, "forecast_s: expected at most 3 times window_s (1800), got 1801"),
        ({"warn_above": 90.0}, "a forecast has bounds on one side; use two signals, got warn_below and warn_above"),
        ({"statistic": "mean"}, "forecast_s: expected statistic: forecast with it, got 'mean'"),
    ],
)
def test_an_impossible_forecast_is_refused(settings: dict[str, Any], problem: str) -> None:
    given = {"statistic": "forecast", "forecast_s": 600.0, "warn_below": 20.0, **settings}
    with pytest.raises(ConfigError) as refused:
        signal(**{key: value for key, value in given.items() if value is not None})
    assert problem in str(refused.value)


def test_a_forecast_has_a_longer_window() -> None:
    found = signal(statistic="forecast", forecast_s=1800.0)
    assert (found.window_s, found.window_min_s, found.window_samples) == (600.0, 600.0, 100_000)
    found = signal(statistic="forecast", forecast_s=100.0, window_s=60.0, window_min_s=40.0, window_samples=50)
    assert (found.window_s, found.window_min_s, found.window_samples) == (60.0, 40.0, 50)
