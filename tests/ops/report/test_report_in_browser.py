"""The report of a replay in a real browser: nothing is clipped on a laptop or a phone."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness.driven_browser import open_browser

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.ops.report.plotted_signal import PlottedSignal
from robot_health_monitor.ops.report.report import Report, render

HEADER = [
    "signal", "samples", "bad", "OK", "WARN", "ERROR", "STALE", "unknown", "alerts", "min", "mean", "max", "longest gap"
]  # fmt: skip
ROW = [
    "4000", "12", "70.4 %", "29.6 %", "0 %", "12.5 %", "3.1 %", "2", "-35.04 degC", "65.12 degC", "85.97 degC",
    "1 h 6 min",
]  # fmt: skip
NAMES = ("battery_level", "left_gripper_motor_temperature_behind_the_gearbox", "gps")


def page(folder: Path) -> Path:
    """Writes a report of three signals."""
    rows = [[name, *ROW] for name in NAMES[:-1]] + [["gps", "not recorded", *[""] * (len(ROW) - 1)]]
    plots = [PlottedSignal(read_signal(name, {"warn_above": 80.0}), "", 0.0, 9.0, 16) for name in NAMES]
    made = Report("Replay of night.bag", ["a"], "One.", "2 alerts", [], 0.0, 9.0, 0.0, HEADER, rows, plots, [], 0)
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


HISTORY_HEADER = [
    "signal", "robot", "samples", "bad", "OK", "WARN", "ERROR", "STALE", "unknown", "available", "alerts", "min",
    "mean", "max", "longest outage", "recovery",
]  # fmt: skip
HISTORY_ROW = [
    "warehouse-robot-12", "1728000", "1234", "70.4 %", "29.6 %", "10.5 %", "12.5 %", "33.1 %", "70.4 %", "1234",
    "-35.04 degC", "65.12 degC", "85.97 degC", "1 h 6 min", "18 min 10 s",
]  # fmt: skip


@pytest.mark.newest_python
def test_a_history_of_several_robots_fits_a_laptop_and_breaks_no_names(tmp_path: Path) -> None:
    names = ["battery_level", "drivers[motor_driver: left]", "left_gripper_motor_temperature_behind_the_gearbox"]
    rows = [[name, *HISTORY_ROW] for name in names]
    plots = [PlottedSignal(read_signal("a", {}), "warehouse-robot-12", 0.0, 9.0, 16)]
    made = Report("History", ["a"], "", "", [], 0.0, 9.0, 0.0, HISTORY_HEADER, rows, plots, [], 0, "robot")
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
    rows = [["/scan", *ROW], ["left", *ROW], ["right", *ROW], ["gps", *ROW]]
    made = Report("A", [], "One.", "1 alert", [], 0.0, 9.0, 0.0, HEADER, rows, [], [], 0, effects=[2, -1, -1, 0])
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
