"""Unit tests of thresholds: series, virtual time, comparison, and every mistake in a file."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path
from typing import Any, Mapping

import pytest

from robot_health_monitor.cli.testing.threshold_cases import (
    MOST_SAMPLES,
    Alert,
    ThresholdTest,
    compare,
    parse_series,
    read_tests,
    run_test,
)
from robot_health_monitor.core import Level, load_config
from robot_health_monitor.core.values.errors import ConfigError

PROMTOOL = shutil.which("promtool")


def elements_tested(tmp_path: Path, text: str) -> list[str]:
    """Returns the lines of a test of the weakest cell."""
    (tmp_path / "thresholds.yaml").write_text(
        "alert_system:\n  ros__parameters:\n    signals:\n"
        "      weakest: {topic: battery, field: 'cell_voltage[*]', reduce: min, unit: V, warn_below: 3.2}\n"
    )
    (tmp_path / "tests.yaml").write_text(f"thresholds: thresholds.yaml\ntests: [{{name: t, {text}, alerts: []}}]\n")
    config, tests = read_tests(str(tmp_path / "tests.yaml"))
    return [alert.text for alert in run_test(config, tests[0])]


def test_the_elements_of_a_reduction_are_one_message(tmp_path: Path) -> None:
    assert elements_tested(tmp_path, "input: {'weakest[0]': '3.7 3.7 _', 'weakest[7]': '3.7 3.1 3.7'}") == [
        "weakest WARN: 3.1 V (cell_voltage[7]) is below 3.2 V (was OK for 1 s)",
        "weakest OK: 3.7 V (cell_voltage[7]) is no longer below 3.2 V (was WARN for 1 s)",
    ]


def test_a_series_of_a_reduction_itself_is_its_value(tmp_path: Path) -> None:
    assert elements_tested(tmp_path, "input: {weakest: '3.7 3.1'}") == [
        "weakest WARN: 3.1 V is below 3.2 V (was OK for 1 s)"
    ]


def test_only_a_signal_with_several_elements_has_elements(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"expected a signal of the thresholds \(weakest, link\)"):
        elements_tested(tmp_path, "input: {'link[0]': 1}")


@pytest.mark.parametrize(
    ("text", "samples"),
    [
        ("25", [25.0]),
        ("25x9", [25.0] * 10),
        ("25x0", [25.0]),
        ("1 2  3", [1.0, 2.0, 3.0]),
        ("15-0.5x4", [15.0, 14.5, 14.0, 13.5, 13.0]),
        ("20+2x3", [20.0, 22.0, 24.0, 26.0]),
        ("-2-1x2", [-2.0, -3.0, -4.0]),
        ("-2+4x1", [-2.0, 2.0]),
        ("_", [None]),
        ("_x3 1", [None, None, None, 1.0]),
        ("_x0 1", [1.0]),
        ("1e3 1.5e-1x1 .5", [1000.0, 0.15, 0.15, 0.5]),
        ("inf -Inf", [math.inf, -math.inf]),
    ],
)
def test_a_series_is_its_samples(text: str, samples: list[float | None]) -> None:
    assert parse_series(text) == samples


def test_a_falling_series_ends_at_its_last_value_exactly() -> None:
    assert parse_series("20.5-0.1x5")[-1] == 20.0


@pytest.mark.parametrize("text", ["nan", "NaN", "-nan"])
def test_nan_is_a_sample(text: str) -> None:
    (sample,) = parse_series(text)
    assert sample is not None
    assert math.isnan(sample)


@pytest.mark.parametrize(
    "text", ["x3", "1x", "1y3", "1x-3", "1+x3", "1+2", "one", "0xF", "1,2", "_1", "1_000", "²", "1x1.5"]
)
def test_an_item_that_is_not_in_the_notation_is_named(text: str) -> None:
    with pytest.raises(ConfigError, match=r"expected a series such as .* got") as raised:
        parse_series(f"1 {text} 2", ("tests", "0"))
    assert repr(text)[1:-1] in str(raised.value)
    assert str(raised.value).startswith("tests.0: ")


@pytest.mark.parametrize("text", ["", "   ", "_x0"])
def test_a_series_without_samples_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="got no samples"):
        parse_series(text)


@pytest.mark.parametrize(
    "text", ["1x1000000", "1x999999999999999999999", "_x1000001", "1x600000 2x600000", "1x" + "9" * 10**6]
)
def test_a_series_that_is_too_long_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=f"expected at most {MOST_SAMPLES} samples"):
        parse_series(text)


@pytest.mark.skipif(PROMTOOL is None, reason="promtool is not installed (Debian's package prometheus)")
@pytest.mark.parametrize(
    "text", ["25x9 15-0.5x20", "1 _ 2 _x3 3x2 _ 4", "20+2x3 -2-1x2 -2+4x1", "_x5 7x0 8x1", "1e3 1.5e-1x1"]
)
def test_promtool_reads_the_same_samples(text: str, tmp_path: Path) -> None:
    assert PROMTOOL is not None
    lines = ["tests:", "  - interval: 10m", "    input_series:", f"      - {{series: s, values: '{text}'}}"]
    lines.append("    promql_expr_test:")
    samples = parse_series(text)
    # A step further than the series, to compare its length. The interval is longer than Prometheus looks back.
    for number, sample in enumerate([*samples, None]):
        found = "[]" if sample is None else f"[{{labels: s, value: {sample!r}}}]"
        lines.append(f"      - {{expr: s, eval_time: {number * 10}m, exp_samples: {found}}}")
    file = tmp_path / "test.yaml"
    file.write_text("\n".join(lines))
    run = subprocess.run(
        [PROMTOOL, "test", "rules", str(file)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert run.returncode == 0, run.stdout


WARN, OK, STALE, ERROR = Level.WARN, Level.OK, Level.STALE, Level.ERROR


def alerts(
    signals: Mapping[str, Any], series: Mapping[str, str], interval_s: float = 1.0
) -> list[tuple[float, str, Level]]:
    parsed = {name: parse_series(text) for name, text in series.items()}
    found = run_test(load_config({"signals": signals}), ThresholdTest("", parsed, [], interval_s))
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


CELLS = {"field": "cell_voltage[*]", "warn_below": 3.2, "startup_grace_s": 3.0}
DRIVERS = {"topic": "/diagnostics", "field": 'status["*"]'}


def test_an_element_has_a_series_under_its_full_name() -> None:
    test = ThresholdTest("", {"cells[3]": [3.9, 3.1], "cells[4]": [3.9, 3.9]}, [])
    alerts = run_test(load_config({"signals": {"cells": CELLS}}), test)
    assert alerts == [Alert(1.0, "cells[3]", Level.WARN)]
    assert alerts[0].text == "cells[3] WARN: 3.1 is below 3.2 (was OK for 1 s)"


def test_the_series_of_a_status_are_its_levels() -> None:
    test = ThresholdTest("", {"drivers[motor: left]": [0.0, 2.0, 3.0, 7.0, 0.0]}, [])
    alerts = run_test(load_config({"signals": {"drivers": DRIVERS}}), test)
    assert [(each.at_s, each.text.partition(" (")[0]) for each in alerts] == [
        (1.0, "drivers[motor: left] ERROR: reported as error"),
        (2.0, "drivers[motor: left] STALE: reported as stale"),
        (3.0, "drivers[motor: left] ERROR: invalid data: level 7"),
        (4.0, "drivers[motor: left] OK: reported as ok"),
    ]


def test_a_template_without_elements_can_be_expected_to_be_stale() -> None:
    test = ThresholdTest("", {"cells[3]": [None] * 5 + [3.9]}, [])
    alerts = run_test(load_config({"signals": {"cells": CELLS}}), test)
    assert [(each.at_s, each.signal, each.level.name) for each in alerts] == [
        (4.0, "cells", "STALE"), (5.0, "cells", "OK"),
    ]  # fmt: skip


def test_elements_in_a_file_are_read(tmp_path: Path) -> None:
    (tmp_path / "thresholds.yaml").write_text(
        "alert_system: {ros__parameters: {signals: {cells: {field: 'a[*]', warn_below: 3.2}, b: {}}}}"
    )
    text = """
        thresholds: thresholds.yaml
        tests:
          - name: "1"
            input: {"cells[3]": "3.9 3.1"}
            alerts: [{at_s: 1.0, signal: "cells[3]", level: WARN}, {at_s: 9.0, signal: cells, level: STALE}]
          - name: "2"
            input: {"cells": "3.9 3.1"}
            alerts: []
          - name: "3"
            input: {"b[3]": "3.9 3.1"}
            alerts: []
    """
    (tmp_path / "tests.yaml").write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_tests(str(tmp_path / "tests.yaml"))
    assert [each.problem for each in caught.value.all] == [
        "expected a series for each element, such as cells[0]",
        "expected a signal of the thresholds (cells, b, link)",
    ]


def test_the_link_needs_no_configuration() -> None:
    assert alerts(BATTERY, {"link": "1 0 1x19", "battery": "25x20"}) == [(1.0, "link", ERROR), (12.0, "link", OK)]


def test_alerts_of_one_instant_match_in_any_order() -> None:
    a, b = Alert(1.0, "a", WARN), Alert(1.0, "b", WARN)
    assert [mark for mark, _ in compare([b, a], [a, b])] == [" ", " "]


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


TWO_SIGNALS = "alert_system: {ros__parameters: {signals: {battery: {warn_below: 20.0}, arm: {}}}}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "thresholds.yaml").write_text(TWO_SIGNALS)
    return tmp_path


def errors(folder: Path, text: str) -> list[str]:
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
            {"battery": [25.0, 15.0, 15.0], "arm": [7.0]},
            [Alert(1.0, "battery", WARN), Alert(9.0, "battery", OK)],
            0.5,
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
        "a.test.yaml:3: tests.0.alerts: is missing; expected the list of alerts, [] for none",
        "a.test.yaml:4: tests.0.interval: unknown key; did you mean interval_s?",
        "a.test.yaml:5: tests.0.input.batery: expected a signal of the thresholds (battery, arm, link)",
        "a.test.yaml:6: tests.1.interval_s: expected a number from 0.0001 to 1000000",
        "a.test.yaml:6: tests.1.name: is missing; expected the text that says what the test shows",
        "a.test.yaml:8: tests.1.input.battery: expected a series such as '25x9 15-0.5x20 _x3 nan'",
        "a.test.yaml:9: tests.1.input.arm: expected a series such as '25x9 15-0.5x20 _x3 nan'",
        "a.test.yaml:11: tests.1.alerts.0.level: expected one of OK, WARN, ERROR, STALE",
        "a.test.yaml:12: tests.1.alerts.1.level: is missing; expected the new level",
        "a.test.yaml:13: tests.2: expected a mapping of keys to values",
    ]


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            "tests: []\n",
            "a.test.yaml: thresholds: is missing; expected the path of a thresholds.yaml, relative to this file, or "
            "its contents",
        ),
        ("thresholds: thresholds.yaml\n", "a.test.yaml: tests: is missing; expected the list of tests"),
        ("thresholds: thresholds.yaml\ntests: []\n", "a.test.yaml:2: tests: expected at least one test, got none"),
        ("thresholds: thresholds.yaml\ntests: {}\n", "a.test.yaml:2: tests: expected a list of tests, got a mapping"),
        (
            "thresholds: none.yaml\ntests: [{name: a, input: {b: 1}, alerts: []}]\n",
            "none.yaml: cannot be read: No such file or directory",
        ),
        (
            "thresholds: thresholds.yaml\ntests:\n- name: a\n  interval_s: 100\n  input: {arm: 1x20000}\n"
            "  alerts: []\n",
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


def test_a_file_may_contain_its_thresholds(folder: Path) -> None:
    path = folder / "own.test.yaml"
    path.write_text(
        "thresholds: {signals: {b: {warn_below: 20.0}}}\n"
        "tests: [{name: a, input: {b: 25 15}, alerts: [{at_s: 1, signal: b, level: WARN}]}]\n"
    )
    config, (test,) = read_tests(str(path))
    assert [alert.text for alert in run_test(config, test)] == ["b WARN: 15 is below 20 (was OK for 1 s)"]
    text = "thresholds: {signals: {b: {warn_belw: 20.0}}}\ntests: [{name: a, input: {b: 25}, alerts: []}]\n"
    assert errors(folder, text)[0].startswith(
        "a.test.yaml:1: thresholds.signals.b.warn_belw: unknown key; did you mean"
    )
