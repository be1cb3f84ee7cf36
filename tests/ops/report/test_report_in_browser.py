"""The report of a replay in a real browser: nothing is clipped on a laptop or a phone."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness.driven_browser import open_browser

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.ops.report.plotted_signal import PlottedSignal
from robot_health_monitor.ops.report.report import Report, render
from robot_health_monitor.ops.report.summaries import SHARES, SummaryRow

COLUMNS = ["samples", "bad", *SHARES, "alerts", "min", "mean", "max", "longest gap"]
FIGURES = {
    "samples": "4000", "bad": "12", "OK": "70.4 %", "WARN": "29.6 %", "ERROR": "0 %", "STALE": "12.5 %",
    "unknown": "3.1 %", "alerts": "2", "min": "-35.04 degC", "mean": "65.12 degC", "max": "85.97 degC",
    "longest gap": "1 h 6 min",
}  # fmt: skip
NAMES = ("battery_level", "left_gripper_motor_temperature_behind_the_gearbox", "gps")


def row(name: str, cause: str = "", robot: str = "", **figures: str) -> SummaryRow:
    """Returns the row of a signal."""
    return SummaryRow(name, robot, cause, {}, 0.0, 0, {**FIGURES, **figures})


def page(folder: Path) -> Path:
    """Writes a report of three signals."""
    missing = {**dict.fromkeys(FIGURES, ""), "samples": "not recorded"}
    rows = [*map(row, NAMES[:-1]), row("gps", **missing)]
    plots = {("", name): PlottedSignal(read_signal(name, {"warn_above": 80.0}), "", 0.0, 9.0, 16) for name in NAMES}
    made = Report("Replay of night.bag", "2 alerts", [], 0.0, 9.0, COLUMNS, rows, plots, [], 0)
    path = folder / "report.html"
    path.write_text(render(made), encoding="utf-8")
    return path


@pytest.mark.newest_python
def test_the_table_is_not_clipped_and_its_shares_have_colours(tmp_path: Path) -> None:
    url = page(tmp_path).as_uri()
    with open_browser() as browser:
        for width in (1280, 1000, 390):
            for dark in (False, True):
                browser.open(url, width, dark=dark)
                widest = "Math.max(...[...document.querySelectorAll('.signals, .signals *')].map(e => e.scrollWidth))"
                assert browser.run(f"return {widest}") <= browser.run(
                    "return document.querySelector('.signals').clientWidth"
                ), width
                assert browser.run("return document.documentElement.scrollWidth") <= width
                colours = [
                    browser.run("return getComputedStyle(document.querySelector(arguments[0])).color", selector)
                    for selector in ("td.share.ok", "td.share.warn", "td.share.stale", "td.name")
                ]
                assert len(set(colours)) == 4
        assert browser.run("return getComputedStyle(document.querySelector('td.zero')).display") == "none"
        head = "return getComputedStyle(document.querySelector('td.share.warn'), '::before').content"
        assert "data-head" in browser.run(head) or "WARN" in browser.run(head)


HISTORY_COLUMNS = [*COLUMNS[:-5], "available", *COLUMNS[-5:-1], "longest outage", "recovery"]
HISTORY = {
    "samples": "1728000", "bad": "1234", "ERROR": "10.5 %", "unknown": "33.1 %", "available": "70.4 %",
    "alerts": "1234", "longest outage": "1 h 6 min", "recovery": "18 min 10 s",
}  # fmt: skip


@pytest.mark.newest_python
def test_a_history_of_several_robots_fits_a_laptop_and_breaks_no_names(tmp_path: Path) -> None:
    names = ["battery_level", "drivers[motor_driver: left]", "left_gripper_motor_temperature_behind_the_gearbox"]
    rows = [row(name, robot="warehouse-robot-12", **HISTORY) for name in names]
    plots = {("", "a"): PlottedSignal(read_signal("a", {}), "warehouse-robot-12", 0.0, 9.0, 16)}
    made = Report("History", "", [], 0.0, 9.0, HISTORY_COLUMNS, rows, plots, [], 0, "robot")
    path = tmp_path / "report.html"
    path.write_text(render(made), encoding="utf-8")
    with open_browser() as browser:
        browser.open(path.as_uri(), 1280)
        assert browser.run("return document.documentElement.scrollWidth") <= 1280
        table = "document.querySelector('.signals')"
        assert browser.run(f"return {table}.scrollWidth - {table}.clientWidth") <= 0
        lines = (
            "return [...document.querySelectorAll('td.name, td.file')].slice(0, 4).map("
            "e => { const r = document.createRange(); r.selectNodeContents(e); return r.getClientRects().length; })"
        )
        assert browser.run(lines) == [1, 1, 1, 1]


@pytest.mark.newest_python
def test_effects_are_folded_below_their_cause(tmp_path: Path) -> None:
    rows = [row("/scan"), row("left", "/scan"), row("right", "/scan"), row("gps")]
    made = Report("A", "1 alert", [], 0.0, 9.0, COLUMNS, rows, {}, [], 0)
    path = tmp_path / "report.html"
    path.write_text(render(made), encoding="utf-8")
    rows_shown = "[...document.querySelectorAll('.signals tbody tr')].filter(e => e.offsetHeight)"
    shown = f"return {rows_shown}.map(e => e.cells[0].innerText.trim())"
    with open_browser() as browser:
        for width in (1280, 390):
            browser.open(path.as_uri(), width)
            assert browser.run(shown) == ["/scan + 2 affected", "gps"]
            browser.run("document.querySelector('[data-effects] button').click()")
            assert browser.run(shown) == ["/scan + 2 affected", "left", "right", "gps"]
            assert browser.run("return document.querySelector('[data-effects] button').ariaExpanded") == "true"
