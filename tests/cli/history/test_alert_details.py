"""`robot-health history --alert ID`: one alert, and the plot of its samples."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from harness.past import START_S, output, write_past

from robot_health_monitor.cli.history.history_entries import text_plot
from robot_health_monitor.cli.history.history_file import change_history
from robot_health_monitor.ops.store.notes import add_note

pytestmark = pytest.mark.usefixtures("utc")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns the history of `harness.past`."""
    return write_past(tmp_path / "history.db")


def test_one_alert_with_a_plot_of_its_samples(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, file, "--alert", "#1").splitlines()
    assert lines[:4] == [
        "2023-11-14 22:13:40 +0000 #1 r1: battery_level WARN: number 1",
        "  level before: OK for 20 s",
        "  bound: 20 (on last)",
        "  window: 21 samples stored; last 15",
    ]
    assert lines[4].startswith("35 |*")
    assert [line for line in lines if line.startswith("20 |---")]
    shown = json.loads(output(capsys, file, "--alert", "1", "--json"))
    assert shown["evidence"][20] == ["2023-11-14T22:13:40.000Z", 15.0]
    assert len(output(capsys, file, "--alert", "1", "--csv").splitlines()) == 22


def test_an_alert_that_does_not_exist(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "robot-health history: there is no transition 4 in this history\n"
    assert output(capsys, file, "--alert", 4, code=2) == text


def test_the_notes_on_an_alert_are_shown(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change_history(file, lambda connection: add_note(connection, 1, "wheel blocked", "ana", START_S))
    assert (
        "  2023-11-14 22:13:20 +0000 #1 note by ana: wheel blocked" in output(capsys, file, "--alert", 1).splitlines()
    )
    shown = json.loads(output(capsys, file, "--alert", 1, "--json"))
    assert shown["notes"] == [{"time": "2023-11-14T22:13:20.000Z", "author": "ana", "text": "wheel blocked"}]


# Plots as text


def test_a_falling_value_crosses_its_bound() -> None:
    samples = [(1000.0 + second, 31.0 - second) for second in range(12)]
    assert text_plot(samples, 25.0, 16) == [
        "31 |*",
        "   | *",
        "   |  *",
        "   |   *",
        "   |    *",
        "   |     *",
        "25 |------*-----",
        "   |       *",
        "   |        *",
        "   |         *",
        "   |          *",
        "20 |           *",
        "   +------------",
        "    00:16:40",
    ]


def test_the_axis_shows_begin_and_end() -> None:
    assert text_plot([(1000.0, 1.0), (1011.0, 2.0)], None, 23)[-1] == "   00:16:40    00:16:51"


def test_a_peak_of_one_sample_is_never_lost() -> None:
    samples = [(float(n), 100.0 if n == 777 else 0.0) for n in range(10_000)]
    lines = text_plot(samples, None, 30)
    assert lines[0] == "100 |  *"


def test_values_that_are_no_numbers_are_marked() -> None:
    assert text_plot([(0.0, 1.0), (1.0, math.nan), (2.0, 2.0)], None, 14)[12] == "  +-----x-----"
    assert text_plot([(0.0, math.nan)], None, 80) == ["no samples that are numbers"]


@pytest.mark.parametrize("values", [(5.0, 5.0), (-1.7e308, 1.7e308), (5e-324, 0.0), (1e15, 1e15 + 1)])
def test_any_range_can_be_plotted(values: tuple[float, float]) -> None:
    lines = text_plot([(0.0, values[0]), (1.0, values[1])], 3.0, 40)
    assert len(lines) == 14
    assert sum(line.count("*") for line in lines) >= 2


def test_one_sample_and_times_out_of_range_can_be_plotted() -> None:
    assert len(text_plot([(1e300, 1.0)], None, 40)) == 14
    assert len(text_plot([(5.0, 1.0), (4.0, 2.0)], None, 1)) == 14
