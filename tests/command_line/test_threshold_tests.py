"""Tests of thresholds: virtual time, transitions, comparison, and every mistake in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List, Mapping, Tuple

import pytest

from robot_health_monitor.core import Level, load_config
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.series import parse_series
from robot_health_monitor.threshold_tests import Alert, ThresholdTest, compare, read_tests, run_test

WARN, OK, STALE, ERROR = Level.WARN, Level.OK, Level.STALE, Level.ERROR


def alerts(
    signals: Mapping[str, Any], series: Mapping[str, str], interval_s: float = 1.0
) -> List[Tuple[float, str, Level]]:
    parsed = {name: parse_series(text) for name, text in series.items()}
    found = run_test(load_config({"signals": signals}), ThresholdTest("", interval_s, parsed, []))
    return [(round(alert.at_s, 9), alert.signal, alert.level) for alert in found]


BATTERY = {"battery": {"warn_below": 20.0, "for_s": 5.0}}


def test_a_bound_must_be_crossed_for_its_duration() -> None:
    assert alerts(BATTERY, {"battery": "25x9 15x60"}) == [(15.0, "battery", WARN)]
    assert alerts(BATTERY, {"battery": "25x9 15x4 25x9"}) == []
    assert alerts(BATTERY, {"battery": "25x9 15x4"}) == []  # ends at 14 s


def test_a_duration_that_ends_between_two_samples_ends_with_a_tick() -> None:
    assert alerts(BATTERY, {"battery": "25 15x5"}, 4.0) == [(9.0, "battery", WARN)]


def test_intervals_that_are_not_exact_in_binary_do_not_shift_a_duration() -> None:
    # 3 * 0.1 is 0.30000000000000004.
    assert alerts(BATTERY, {"battery": "25x2 15x60"}, 0.1) == [(5.3, "battery", WARN)]


def test_a_missing_sample_lets_time_pass() -> None:
    assert alerts(BATTERY, {"battery": "25 _x9 25"}) == [(6.0, "battery", STALE), (10.0, "battery", OK)]


def test_a_series_that_ends_before_the_others_has_no_further_samples() -> None:
    signals = {"a": {"stale_after_s": 3.0}, "b": {}}
    assert alerts(signals, {"a": "1x1", "b": "1x9"}) == [(5.0, "a", STALE)]


def test_signals_without_a_series_are_not_judged() -> None:
    assert alerts({**BATTERY, "arm": {"startup_grace_s": 1.0}}, {"battery": "25x30"}) == []


def test_a_condition_on_a_signal_without_a_series_is_unknown_so_that_the_bounds_apply() -> None:
    signals = {"battery": {"warn_below": 20.0, "only_if": {"signal": "charging", "is_not": 1.0}}, "charging": {}}
    assert alerts(signals, {"battery": "25 15"}) == [(1.0, "battery", WARN)]
    assert alerts(signals, {"charging": "1x1", "battery": "25 15"}) == []


def test_numbers_are_those_of_the_messages_before_scale() -> None:
    assert alerts({"charge": {"scale": 100.0, "warn_below": 20.0}}, {"charge": "0.25 0.15"}) == [(1.0, "charge", WARN)]


def test_repeated_announcements_are_no_transitions() -> None:
    signals = {"battery": {"warn_below": 20.0, "repeat_s": 10.0}}
    assert alerts(signals, {"battery": "15x60"}) == [(0.0, "battery", WARN)]


def test_the_link_needs_no_configuration() -> None:
    assert alerts(BATTERY, {"link": "1 0 1x19", "battery": "25x20"}) == [(1.0, "link", ERROR), (12.0, "link", OK)]


def test_alerts_of_one_instant_match_in_any_order() -> None:
    a, b = Alert(1.0, "a", WARN), Alert(1.0, "b", WARN)
    assert [difference.mark for difference in compare([b, a], [a, b])] == [" ", " "]


def test_every_missing_and_every_unexpected_alert_is_marked() -> None:
    expected = [Alert(1.0, "a", WARN), Alert(3.0, "a", OK), Alert(9.0, "a", ERROR)]
    actual = [Alert(1.0, "a", WARN), Alert(4.0, "a", OK), Alert(9.0, "a", WARN)]
    assert [(mark, alert.at_s, alert.level) for mark, alert in compare(expected, actual)] == [
        (" ", 1.0, WARN),
        ("-", 3.0, OK),
        ("+", 4.0, OK),
        ("-", 9.0, ERROR),
        ("+", 9.0, WARN),
    ]


def test_an_alert_that_occurs_twice_must_be_expected_twice() -> None:
    alert = Alert(1.0, "a", WARN)
    assert [mark for mark, _ in compare([alert], [alert, alert])] == [" ", "+"]
    assert [mark for mark, _ in compare([alert, alert], [alert])] == ["-", " "]


THRESHOLDS = "alert_system: {ros__parameters: {signals: {battery: {warn_below: 20.0}, arm: {}}}}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "thresholds.yaml").write_text(THRESHOLDS)
    return tmp_path


def errors(folder: Path, text: str) -> List[str]:
    file = folder / "a.test.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as raised:
        read_tests(str(file))
    return [str(error).replace(f"{folder}/", "") for error in raised.value.all]


def test_a_file_is_read(folder: Path) -> None:
    file = folder / "a.test.yaml"
    file.write_text(
        "thresholds: thresholds.yaml\n"
        "tests:\n"
        "  - name: low\n"
        "    interval_s: 0.5\n"
        "    input: {battery: 25 15x1, arm: 7}\n"
        "    alerts: [{at_s: 9, signal: battery, level: OK}, {at_s: 1, signal: battery, level: WARN}]\n"
    )
    config, tests = read_tests(str(file))
    assert list(config.signals) == ["battery", "arm"]
    assert tests == [
        ThresholdTest(
            "low",
            0.5,
            {"battery": [25.0, 15.0, 15.0], "arm": [7.0]},
            [Alert(1.0, "battery", WARN), Alert(9.0, "battery", OK)],
        )
    ]


def test_every_mistake_is_reported_with_its_line(folder: Path) -> None:
    found = errors(
        folder,
        "thresholds: thresholds.yaml\n"
        "tests:\n"
        "  - name: first\n"
        "    interval: 1.0\n"
        "    input: {batery: 25x9}\n"
        "  - interval_s: 0\n"
        "    input:\n"
        "      battery: 25y9\n"
        "      arm: [1, 2]\n"
        "    alerts:\n"
        "      - {at_s: 1.0, signal: battery, level: WARM}\n"
        "      - {at_s: 1.0, signal: battery}\n"
        "  - 7\n",
    )
    assert [line.split(", got")[0] for line in found] == [
        "a.test.yaml:3: tests.0.alerts: is missing; expected a list of alerts, [] for none",
        "a.test.yaml:4: tests.0.interval: unknown key; did you mean interval_s? "
        "expected one of name, interval_s, input, alerts",
        "a.test.yaml:5: tests.0.input.batery: expected a signal of the thresholds (battery, arm, link)",
        "a.test.yaml:6: tests.1.interval_s: expected a number from 0.0001 to 1000000",
        "a.test.yaml:8: tests.1.input.battery: expected a series such as '25x9 15-0.5x20 _x3 nan'",
        "a.test.yaml:9: tests.1.input.arm: expected printable text",
        "a.test.yaml:11: tests.1.alerts.0.level: expected one of OK, WARN, ERROR, STALE",
        "a.test.yaml:12: tests.1.alerts.1.level: is missing; expected the new level",
        "a.test.yaml:13: tests.2: expected a mapping of keys to values",
    ]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            "tests: []\n",
            "a.test.yaml: thresholds: is missing; expected the path of a thresholds.yaml, relative to this file",
        ),
        ("thresholds: thresholds.yaml\n", "a.test.yaml: tests: is missing; expected a list of tests"),
        ("thresholds: thresholds.yaml\ntests: []\n", "a.test.yaml:2: tests: expected at least one test, got none"),
        ("thresholds: thresholds.yaml\ntests: {}\n", "a.test.yaml:2: tests: expected a list of tests, got a mapping"),
        (
            "thresholds: none.yaml\ntests: [{name: a, input: {b: 1}, alerts: []}]\n",
            "none.yaml: cannot be read: No such file or directory",
        ),
        (
            "thresholds: thresholds.yaml\ntests:\n- &a {name: a, input: {arm: 1}, alerts: []}\n- *a\n",
            "a.test.yaml:3: tests.1.name: another test of this file has the same name",
        ),
        (
            "thresholds: thresholds.yaml\ntests:\n- name: a\n  input: {arm: 1}\n  alerts:\n"
            "  - {at_s: 1, signal: battery, level: OK}\n",
            "a.test.yaml:6: tests.0.alerts.0.signal: expected a signal of `input` (arm), got 'battery'",
        ),
        (
            "thresholds: thresholds.yaml\ntests:\n- name: a\n  interval_s: 100\n  input: {arm: 1x20000}\n\n",
            "a.test.yaml:5: tests.0.input.arm: expected at most 1000000 s",
        ),
    ],
)
def test_a_mistake_in_a_file(folder: Path, text: str, error: str) -> None:
    assert error in errors(folder, text)


def test_a_mistake_in_the_thresholds_names_their_file_and_line(folder: Path) -> None:
    (folder / "thresholds.yaml").write_text("alert_system:\n  ros__parameters:\n    signals: {arm: {warn: 1}}\n")
    (error, *_) = errors(folder, "thresholds: thresholds.yaml\ntests: [{name: a, input: {arm: 1}, alerts: []}]\n")
    assert error.startswith("thresholds.yaml:3: alert_system.ros__parameters.signals.arm.warn: unknown key")
