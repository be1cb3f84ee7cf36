"""`robot-health test --from-alert`: what it writes passes `robot-health test`, for alerts of the real alert_system."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from harness.watched_signals import Of, Timeline, every_second, watched

from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.history.history_file import change_history
from robot_health_monitor.cli.testing.past_alert import series_text
from robot_health_monitor.cli.testing.threshold_cases import parse_series, read_tests
from robot_health_monitor.core import Level
from robot_health_monitor.core.values.elements import DriverStatus

pytestmark = pytest.mark.usefixtures("utc")


def written(capsys: pytest.CaptureFixture[str], file: Path, number: int, *options: str) -> str:
    """Returns what the command writes, after it has run it."""
    code = main(["test", "--from-alert", str(number), "--history", str(file), *options])
    captured = capsys.readouterr()
    assert (code, captured.err) == (0, f"the test of alert {number} of r3 passes\n")
    return captured.out


def passes(capsys: pytest.CaptureFixture[str], folder: Path, text: str) -> None:
    """Requires that the tests in a text pass."""
    path = folder / "alert.test.yaml"
    path.write_text(text, encoding="utf-8")
    code = main(["test", str(path)])
    captured = capsys.readouterr()
    assert (code, captured.out, captured.err) == (0, f"{path}: OK: 1 test\n", ""), text


BATTERY = {"battery": {"unit": "%", "warn_below": 20.0, "for_s": 3.0}}


def test_the_test_of_an_alert_is_its_series_and_the_thresholds_in_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Below 20 from 5 s on: the tick at 8.5 s is the first one after 3 s. It comes at a whole second of the test.
    file = watched(tmp_path / "history.db", BATTERY, "battery", every_second([25.0] * 5 + [19.5] * 5))
    text = written(capsys, file, 1)
    assert text.splitlines() == [
        "# Alert 1 of r3, 2023-11-14 22:13:28 +0000: battery WARN: 19.5 % is below 20 % (was OK for 8 s)",
        "thresholds:",
        "  signals:",
        "    battery: {unit: '%', warn_below: 20.0, for_s: 3.0}",
        "tests:",
        "- name: 'alert 1 of r3: battery WARN'",
        "  interval_s: 1.0",
        "  input: {battery: 25x4 19.5x3}",
        "  alerts:",
        "  - {at_s: 8.0, signal: battery, level: WARN}",
    ]
    passes(capsys, tmp_path, text)


def test_a_false_alarm_becomes_a_failing_test_then_a_better_threshold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = watched(tmp_path / "history.db", BATTERY, "battery", every_second([25.0] * 5 + [19.5] * 5))
    (tmp_path / "thresholds.yaml").write_text(
        json.dumps({"alert_system": {"ros__parameters": {"signals": BATTERY}}}), encoding="utf-8"
    )
    text = written(capsys, file, 1, "--thresholds", "thresholds.yaml")
    assert "thresholds: thresholds.yaml" in text
    passes(capsys, tmp_path, text)
    path = tmp_path / "alert.test.yaml"
    path.write_text(text[: text.index("  alerts:")] + "  alerts: []\n", encoding="utf-8")
    assert main(["test", str(path)]) == 1
    assert "+ at_s: 8, signal: battery, level: WARN" in capsys.readouterr().out
    better = {"battery": {**BATTERY["battery"], "warn_below": 19.0}}
    (tmp_path / "thresholds.yaml").write_text(
        json.dumps({"alert_system": {"ros__parameters": {"signals": better}}}), encoding="utf-8"
    )
    assert main(["test", str(path)]) == 0


STATUS = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'}
CASES: dict[str, tuple[dict[str, Any], str, Timeline]] = {
    "two levels": (
        {"b": {"warn_below": 20.0, "error_below": 10.0}}, "b", every_second([25.0, 24.0, 19.0, 18.0, 9.0, 8.0]),
    ),
    "recovery": ({"b": {"warn_below": 20.0, "keep_firing_for_s": 3.0}}, "b", every_second([19.0, 25.0] + [26.0] * 6)),
    "stale": ({"b": {"warn_below": 20.0, "stale_after_s": 2.5}}, "b", every_second([25.0] * 4 + [...] * 5)),
    "never a sample": ({"b": {"warn_below": 20.0, "startup_grace_s": 4.0}}, "b", every_second([...] * 8)),
    "samples again": (
        {"b": {"warn_below": 20.0, "stale_after_s": 2.5}}, "b", every_second([25.0] * 4 + [...] * 5 + [25.0] * 3),
    ),
    "invalid": ({"b": {"warn_below": 20.0}}, "b", every_second([25.0] * 4 + [float("nan")] * 5)),
    "a text where a number belongs": ({"b": {"warn_below": 20.0}}, "b", every_second([25.0] * 4 + ["hot", "hot"])),
    "out of range": ({"b": {"warn_below": 20.0, "valid_max": 100.0}}, "b", every_second([25.0] * 4 + [150.0])),
    "mean": (
        {"b": {"statistic": "mean", "window_s": 6.0, "warn_above": 80.0}}, "b", every_second([70.0] * 5 + [90.0] * 6),
    ),
    "rate": ({"b": {"statistic": "rate", "window_s": 5.0, "warn_below": -1.0}}, "b",
             every_second([50.0] * 6 + [48.0, 46.0, 44.0, 42.0, 40.0])),
    "a scale": ({"b": {"scale": 0.1, "warn_below": 20.0}}, "b", every_second([250.0] * 3 + [193.0])),
    "an element": (
        {"cells": {"type": "sensor_msgs/BatteryState", "field": "cell_voltage[*]", "warn_below": 3.2}}, "cells[7]",
        every_second([3.9] * 4 + [3.1]),
    ),
    "a driver": (
        {"drivers": {**STATUS, "for_s": 2.0}}, 'drivers[motor: "left", *]',
        every_second([DriverStatus(0, "fine")] * 4 + [DriverStatus(2, "no returns")] * 5),
    ),
    "a condition": (
        {"b": {"warn_below": 20.0, "only_if": {"signal": "c", "is": 1.0}}, "c": {"warn_above": 5.0}}, "b",
        every_second([25.0] * 3 + [19.0]),
    ),
    "times that are not even": (
        {"b": {"warn_below": 20.0, "for_s": 1.2}}, "b",
        [(0.013, 25.0), (0.771, 24.5), (1.0, None), (1.402, 19.25), (2.0, None), (2.117, 19.0), (2.733, 18.0)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_test_of_every_transition_passes(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    signals, name, timeline = CASES[case]
    file = watched(tmp_path / "history.db", signals, name, timeline)
    levels = change_history(
        str(file),
        lambda connection: connection.execute("SELECT id, to_level FROM transitions ORDER BY id").fetchall(),
    )
    assert levels
    for number, level in levels:
        text = written(capsys, file, number)
        passes(capsys, tmp_path, text)
        _, (test,) = read_tests(str(tmp_path / "alert.test.yaml"))
        assert test.alerts[-1].level is Level(level)


@pytest.mark.parametrize(
    ("period_s", "interval_s", "exact_s"),
    [(0.0985, "0.1", "0.001"), (0.0333, "0.033", "0.001"), (0.97, "1.0", "0.001")],
)
def test_period_and_digits_are_those_that_a_person_would_write(
    period_s: float, interval_s: str, exact_s: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    signals = {"age": {"unit": "s", "warn_above": 0.5, "window_s": 20.0}}
    timeline = [(number * period_s, 0.0123456789 if number < 15 else 0.6524529457092285) for number in range(16)]
    file = watched(tmp_path / "history.db", signals, "age", timeline)
    text = written(capsys, file, 1)
    assert f"  interval_s: {interval_s}\n" in text
    assert "  input: {age: 0.012x14 0.652}\n" in text
    passes(capsys, tmp_path, text)
    text = written(capsys, file, 1, "--exact")
    assert f"  interval_s: {exact_s}\n" in text
    assert " 0.6524529457092285}\n" in text
    passes(capsys, tmp_path, text)


def refused(capsys: pytest.CaptureFixture[str], file: Path, number: int) -> str:
    """Returns why an alert has no test."""
    code = main(["test", "--from-alert", str(number), "--history", str(file)])
    captured = capsys.readouterr()
    assert (code, captured.out, captured.err.count("\n")) == (2, "", 1)
    return captured.err


GOOD = "a history has the good samples in the window of an alert, at most 300, and no others"
RECORDER = "; a black box (ops.yaml: black_box) would have recorded them"


@pytest.mark.parametrize(
    ("signal", "timeline", "missing"),
    [
        (
            {"warn_below": 20.0, "for_s": 30.0, "window_s": 10.0}, every_second([25.0] * 5 + [19.5] * 40),
            GOOD + RECORDER,
        ),
        (
            {"warn_below": 20.0, "invalid_for_s": 2.0}, every_second([25.0] * 4 + [float("nan")] * 5),
            GOOD + RECORDER,
        ),
        (
            {"field": "", "statistic": "frequency_hz", "window_s": 5.0, "warn_below": 1.5, "stale_after_s": 9.0},
            [(0.5 * number, 1.0) for number in range(30)] + [(15.0 + number, 1.0) for number in range(10)],
            "a history has no times of arrivals" + RECORDER,
        ),
    ],
    ids=["longer than the window", "bad samples", "arrivals"],
)  # fmt: skip
def test_what_is_missing_is_named_and_how_a_black_box_would_have_had_it(
    signal: dict[str, Any], timeline: Timeline, missing: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = watched(tmp_path / "history.db", {"b": signal}, "b", timeline)
    assert (
        refused(capsys, file, 1) == f"robot-health test: --from-alert: alert 1 of r3 does not occur again: {missing}\n"
    )


def test_without_samples_of_a_condition_the_alert_has_no_test(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    latched = {"warn_below": 20.0, "latch": True, "latch_release_if": {"signal": "c", "is": 1.0}}
    signals = {"b": latched, "c": {"warn_above": 5.0}}
    timeline = [*every_second([25.0] * 3 + [19.0] + [25.0] * 5), (9.2, Of("c", 1.0)), (9.5, None)]
    file = watched(tmp_path / "history.db", signals, "b", timeline)
    assert GOOD in refused(capsys, file, 2)


def test_a_test_of_other_thresholds_is_run_with_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = watched(tmp_path / "history.db", BATTERY, "battery", every_second([25.0] * 5 + [19.5] * 5))
    path = tmp_path / "better.yaml"
    path.write_text("alert_system: {ros__parameters: {signals: {battery: {warn_below: 19.0}}}}", encoding="utf-8")
    assert main(["test", "--from-alert", "1", "--history", str(file), "--thresholds", str(path)]) == 1
    captured = capsys.readouterr()
    assert captured.out.endswith("- {at_s: 8.0, signal: battery, level: WARN}\n")
    assert captured.err == (
        f"the test of alert 1 of r3 fails with {path}: 1 difference, first - at_s: 8, signal: battery, level: WARN\n"
    )


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("DELETE FROM transitions", "there is no alert 1 in this history"),
        (
            "UPDATE transitions SET repeat = 1",
            "--from-alert: 1 repeats an earlier alert; expected the id of that one",
        ),
        ("DELETE FROM configuration_changes", "--from-alert: this history has no configuration of r3"),
        ("UPDATE transitions SET signal = 'old\x1b'", "--from-alert: old? is not in the configuration of r3"),
        (
            "UPDATE configurations SET text = '{\"b\": 1}'",
            "--from-alert: the configuration of r3 cannot be read: b: expected a mapping of keys to values, got 1",
        ),
    ],
)
def test_what_has_no_test_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, problem: str
) -> None:
    file = watched(tmp_path / "history.db", BATTERY, "battery", every_second([25.0] * 5 + [19.5] * 5))
    change_history(str(file), lambda connection: connection.execute(change))
    assert main(["test", "--from-alert", "1", "--history", str(file)]) == 2
    assert capsys.readouterr() == ("", f"robot-health test: {problem}\n")


def test_odd_evidence_gives_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = watched(tmp_path / "history.db", BATTERY, "battery", every_second([25.0] * 5 + [19.5] * 5))
    for blob in (b"", b"odd", b"\xff" * 20, b"\x00" * 32):
        with closing(sqlite3.connect(str(file))) as connection, connection:
            connection.execute("UPDATE evidence SET samples = ?", (blob,))
        assert "alert 1 of r3 does not occur again: " in refused(capsys, file, 1)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ([], "expected either FILE or --from-alert, got neither"),
        (["a.yaml", "--from-alert", "1"], "expected either FILE or --from-alert, got both"),
        (["--from-alert", "x"], "argument --from-alert: expected the number of an alert or the .mcap file"),
    ],
)
def test_arguments_that_do_not_fit(capsys: pytest.CaptureFixture[str], arguments: list[str], problem: str) -> None:
    assert main(["test", *arguments]) == 2
    assert capsys.readouterr().err.startswith(f"robot-health test: {problem}")


@pytest.mark.parametrize(
    "series",
    [
        [1.0], [None, None, 2.5], [1.0, 1.0, 1.0, None, 1.0], [float("nan"), float("nan"), -0.1, 1e-9, 1e22, 1 / 3],
        [float("inf"), -float("inf"), None],
    ],
)  # fmt: skip
def test_a_series_is_written_as_it_is_read(series: list[float | None]) -> None:
    assert list(map(repr, parse_series(series_text(series)))) == list(map(repr, series))
