"""The page in a real browser, on a real server; skipped where there is no browser."""

from __future__ import annotations

import signal
import sqlite3
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Iterator, Mapping

import pytest
from harness.driven_browser import Browser, Keys, ServedRobots, open_browser
from harness.line_process import LineProcess
from harness.waiting import wait_for
from harness.web import BATTERY, START_S, Robots

from robot_health_monitor.core.values.elements import Elements
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.samples import StoredSamples, store

TEMPERATURE: Mapping[str, Any] = {"unit": "degC", "warn_above": 80.0, "error_above": 95.0}
SIGNALS: Mapping[str, Any] = {**BATTERY, "temperature": TEMPERATURE}
BOUND: Mapping[str, Any] = {"warn_below": 20.0}
HOSTILE = '"><img src=x onerror=alert(1)><script>alert(2)</script>'
LONG = "Antriebsstrang_Vorderachse_links_Motortemperatur_nach_dem_Getriebe"
ROW = ".robot:nth-child({}) "


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Returns one window for all tests of this file."""
    with open_browser() as opened:
        yield opened


@pytest.fixture
def served(browser: Browser) -> Iterator[Any]:
    """Returns a function that serves robots until the end of the test."""
    running: list[ServedRobots] = []

    def serve(*names: str, **options: Any) -> ServedRobots:
        token, port = options.pop("token", ""), options.pop("port", 0)
        running.append(ServedRobots(Robots(*names, **options), token=token, port=port))
        return running[-1]

    yield serve
    browser.driver.get("about:blank")  # an open page would delay the end of the server
    for each in running:
        each.close()


def kinds(browser: Browser) -> dict[str, str]:
    """Returns the text of each robot's level."""
    names, levels = browser.texts(".robot-name"), browser.texts(".robot-head .badge-text")
    return dict(zip(names, levels))


def test_the_first_paint_has_every_robot_worst_first_with_cause_and_age(browser: Browser, served: Any) -> None:
    site = served("atlas", "boreas", "cronus", signals=SIGNALS)
    site.observe(50.0, robot=0)
    site.observe(40.0, "temperature", robot=0)
    site.observe(19.0, robot=1)
    site.observe(99.0, "temperature", robot=2)
    site.observe(60.0, robot=2)
    site.observe(40.0, "temperature", robot=1, after_s=0.0)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot').length === 3")
    assert browser.texts(".robot-name") == ["cronus", "boreas", "atlas"]
    assert browser.texts(".robot-head .badge-text") == ["ERROR", "WARN", "OK"]
    assert browser.texts(".cause bdi")[:2] == [
        "temperature: 99 °C is above 95 °C",
        "battery_level: 19 % is below 20 %",
    ]
    assert browser.find(ROW.format(1) + ".since").text.endswith(" s")
    assert browser.find("#summary").text.replace("\u00a0", " ") == "3 robots: 1 ERROR, 1 WARN"
    assert browser.driver.title.replace("\u00a0", " ") == "3 robots: 1 ERROR, 1 WARN \u2013 Robot health"
    assert browser.find("#icon").get_attribute("href").startswith("data:image/svg+xml,")
    assert browser.console() == []


def test_faults_of_the_monitor_itself_are_shown_above_the_robots_and_colour_none(browser: Browser, served: Any) -> None:
    site = served("atlas", "boreas")
    for robot in (0, 1):
        site.observe(50.0, robot=robot)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot.ok').length === 2")
    assert not browser.find("#monitor-faults").is_displayed()
    site.do(lambda robots: robots.bus.nodes[1].faults.report("history", "disk full"))
    browser.wait_for_text("#monitor-faults", "Monitor ERROR: boreas: history: disk full")
    assert kinds(browser) == {"atlas": "OK", "boreas": "OK"}
    assert browser.find("#summary").text == "2 robots: monitor ERROR"
    site.do(lambda robots: robots.bus.nodes[1].faults.clear("history"))
    browser.wait_for("document.getElementById('monitor-faults').hidden")
    assert browser.find("#summary").text == "2 robots: all OK"
    assert browser.console() == []


def test_an_alert_shows_without_a_reload_and_is_read_out(browser: Browser, served: Any) -> None:
    site = served("atlas", "boreas")
    for robot in (0, 1):
        site.observe(50.0, robot=robot)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot.ok').length === 2")
    icon = browser.find("#icon").get_attribute("href")
    site.observe(19.0, robot=1)
    browser.wait_for("document.querySelector('.robot').className === 'robot warn'")
    assert kinds(browser) == {"boreas": "WARN", "atlas": "OK"}  # it moved to the top
    assert browser.driver.title.startswith("2 robots: 1\u00a0WARN")
    assert browser.find("#icon").get_attribute("href") != icon
    browser.wait_for_text("#announcer", "boreas: battery_level WARN, 19 % is below 20 %")
    site.observe(18.0, robot=1)
    browser.wait_for_text(".cause", "18 % is below 20 %")
    assert browser.console() == []


def test_a_change_updates_only_the_robot_that_changed(browser: Browser, served: Any) -> None:
    site = served(*(f"robot{number}" for number in range(200)))
    for robot in range(200):
        site.observe(50.0, robot=robot, after_s=0.0)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot.ok').length === 200")
    browser.run(
        "window.touched = new Set();"
        "new MutationObserver((changes) => changes.forEach(({target}) => {"
        "  const row = target.closest('.robot');"
        "  if (row && !target.closest('time')) touched.add(row.querySelector('.robot-name').textContent); }))"
        ".observe(document.getElementById('robot-list'), {subtree: true, childList: true, attributes: true});"
    )
    site.observe(19.0, robot=137, after_s=0.0)
    browser.wait_for("document.querySelector('.robot.warn')")
    assert browser.run("return [...touched]") == ["robot137"]
    assert browser.texts(".robot-name")[0] == "robot137"
    browser.type("#filter", "robot13")
    assert browser.texts(".robot-name") == [
        "robot137",
        "robot13",
        *(f"robot13{digit}" for digit in "012345689"),
    ]
    browser.type("#filter", "is below")
    assert browser.texts(".robot-name") == ["robot137"]
    browser.type("#filter", "none of them")
    assert browser.find("#no-robot").text == "No robot matches the filter."
    browser.find("#filter").clear()
    browser.type("#filter", " ")
    browser.click(".level-button.warn")
    assert browser.texts(".robot-name") == ["robot137"]


def test_unknown_levels_look_like_neither_ok_nor_an_alarm(browser: Browser, served: Any) -> None:
    site = served(
        "ok",
        "warn",
        "error",
        "stale",
        "waiting",
        "away",
        signals={"temperature": {**TEMPERATURE, "startup_grace_s": 60.0}},
    )

    for robot in range(6):
        site.do(lambda robots, robot=robot: robots.all[robot].observe_link(True))
    site.observe(50.0, "temperature", 3)
    site.pass_time(7.0)
    for robot, value in ((0, 50.0), (1, 85.0), (2, 99.0), (5, 50.0)):
        site.observe(value, "temperature", robot, after_s=0.0)
    site.do(lambda robots: robots.all[5].observe_link(False, "no route to host"))
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot').length === 6")
    assert kinds(browser) == {
        "error": "ERROR", "away": "NO LINK", "stale": "STALE", "warn": "WARN", "waiting": "waiting", "ok": "OK",
    }  # fmt: skip
    browser.run("document.querySelector('.robot.nolink button').click()")
    browser.wait_for("document.querySelectorAll('.signal').length === 2")
    assert browser.texts(".signal .badge-text") == ["NO LINK", "unreachable"]
    shapes = browser.run("return [...document.querySelectorAll('.badge use')].map((use) => use.getAttribute('href'))")
    assert len(set(shapes)) == 7
    colors = browser.run(
        "return Object.fromEntries([...document.querySelectorAll('.badge')].map((badge) => {"
        " const style = getComputedStyle(badge);"
        " return [badge.textContent, [style.color, style.backgroundColor]]; }))"
    )
    for unknown, place in (("NO LINK", 1), ("unreachable", 0), ("waiting", 0)):
        assert all(colors[unknown][place] not in colors[level] for level in ("OK", "WARN", "ERROR", "STALE"))


def test_texts_from_robots_are_never_html(browser: Browser, served: Any) -> None:
    site = served(HOSTILE, "__proto__", signals={"text": {"warn_below": 20.0, "unit": HOSTILE}, "__proto__": BOUND})
    site.observe(HOSTILE, "text")
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot').length === 2")
    for number in range(2):
        browser.run(f"document.querySelectorAll('.robot-head')[{number}].click()")
    browser.wait_for("document.querySelectorAll('.signal').length === 4")
    browser.run("document.querySelectorAll('.signal-name')[0].click()")
    browser.wait_for("document.querySelector('.plot svg')")
    assert HOSTILE in browser.texts(".robot-name")
    assert "__proto__" in browser.texts(".signal-name")
    assert any("<img src=x" in text for text in browser.texts(".value") + browser.texts(".reason"))
    assert browser.run("return [document.images.length, document.querySelectorAll('main script').length]") == [0, 0]
    assert browser.run("return typeof Object.prototype.level") == "undefined"
    assert browser.console() == []  # nothing was blocked either


@pytest.mark.parametrize("width", [320, 390, 768, 1280])
def test_nothing_is_wider_than_the_window(browser: Browser, served: Any, tmp_path: Path, width: int) -> None:
    names = [LONG * 2, "Kommissionierfahrzeug im Außenbereich der Halle 7", "روبوت", HOSTILE]
    site = served(
        *names,
        signals={LONG: {**TEMPERATURE, "unit": "Einheiten_je_Umdrehung"}, **BATTERY},
        history_file=str(tmp_path / "history.db"),
    )
    for robot in range(4):
        site.observe(99.123456, LONG, robot=robot)
    browser.open(site.url, width)
    browser.wait_for("document.querySelectorAll('.robot').length === 4")
    browser.run("document.querySelectorAll('.robot-head').forEach((head) => head.click())")
    browser.run("document.querySelectorAll('.signal-name')[0].click()")
    browser.wait_for("document.querySelector('.plot svg') && document.querySelector('.signals .alert')")
    size = "return [document.documentElement.scrollWidth, document.documentElement.clientWidth]"
    fits = lambda: len(set(browser.run(size))) == 1  # noqa: E731
    assert fits()
    browser.run("location.hash = 'alerts'")
    browser.wait_for("document.querySelectorAll('#alerts .alert').length === 4")
    browser.run("document.querySelector('#alerts .text a').click()")
    browser.wait_for("document.querySelector('#alerts .plot svg')")
    assert fits()
    browser.run("location.hash = 'silences'")
    browser.wait_for("!document.getElementById('silences').hidden")
    browser.click("#silence-list .buttons button")
    assert fits()


def test_a_plot_grows_with_the_samples(browser: Browser, served: Any) -> None:
    site = served("atlas")
    for value in (60.0, 50.0, 40.0):
        site.observe(value)
    browser.open(site.url)
    browser.wait_for("document.querySelector('.signal-name')")  # a single robot is open
    browser.click(".signal-name")
    low = "(document.querySelector('.plot svg') || document.body).getAttribute('aria-label')"
    browser.wait_for(f"({low} || '').startsWith('battery_level: 40 % to 60 %')")
    site.observe(30.0)
    browser.wait_for(f"{low}.startsWith('battery_level: 30 % to 60 %')")
    assert browser.texts(".plot .bound-name") == ["WARN below 20 %"]
    site.pass_time(61.0)
    site.observe(25.0)  # the others have left the window of 60 s
    browser.wait_for(f"{low}.startsWith('battery_level: 25 % to 25 %')")


def test_a_plot_begins_where_the_history_begins(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", signals={"battery_level": BOUND}, history_file=str(tmp_path / "history.db"))
    for value in (50.0, 50.0, 19.0, 19.0, 50.0, 50.0, 15.0, 15.0, 40.0):
        site.observe(value)
    browser.open(site.url)
    browser.click(".signal-name")
    browser.wait_for("document.querySelectorAll('.plot .marker').length === 4")
    browser.wait_for("document.querySelectorAll('.plot .strip.warn').length === 2")
    assert browser.run("return document.querySelectorAll('.plot .strip.ok').length") == 3
    texts = browser.texts(".plot a title")
    assert [text.split(":")[0] for text in texts] == ["battery_level WARN", "battery_level OK"] * 2
    site.observe(12.0)
    browser.wait_for("document.querySelectorAll('.plot .marker').length === 5")
    links = "[...document.querySelectorAll('.plot a')].map((each) => each.getAttribute('href'))"
    browser.wait_for(f"{links}.every((link) => document.querySelector(link))")


def stored(site: ServedRobots, robot: str, begin_s: float, end_s: float, low: float, level: Level = Level.OK) -> None:
    """Stores samples of a battery, `low` to `low` + 10 in each 10 s, from and to so many seconds before the start."""
    history = site.robots.history
    assert history is not None
    starts = range(int(START_S + begin_s), int(START_S + end_s), 10)
    rows = [
        StoredSamples(robot, "battery_level", start, 10.0, low, low + 10.0, low, low, 10, 0, level) for start in starts
    ]
    history.run(lambda connection: store(connection, rows))


def alert_id(site: ServedRobots, signal: str, level: Level) -> int:
    """Returns the number of the latest alert of a signal and level."""
    history = site.robots.history
    assert history is not None
    query = "SELECT max(id) FROM transitions WHERE signal = ? AND to_level = ?"
    (number,) = history.read(lambda connection: connection.execute(query, (signal, level)).fetchone())
    return int(number)


def test_a_plot_reaches_back_to_what_was_stored(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    stored(site, "atlas", -7200.0, -6000.0, 10.0, Level.WARN)
    stored(site, "atlas", -1800.0, -60.0, 70.0)
    site.observe(50.0)
    browser.open(site.url)
    browser.click(".signal-name")
    buttons = "[...document.querySelectorAll('.ranges button')]"
    assert browser.run(f"return {buttons}.map((each) => each.textContent)") == [
        "Live", "10 min", "1 hour", "24 hours", "7 days", "30 days"
    ]  # fmt: skip
    label = "document.querySelector('.plot svg').getAttribute('aria-label')"
    browser.run(f"{buttons}[2].click()")
    browser.wait_for(f"{label}.startsWith('battery_level: 70 % to 80 %')")
    plot = "document.querySelector('.plot').plot"
    assert browser.run(f"return {plot}.view.to - {plot}.view.from") == pytest.approx(3600.0, abs=5.0)
    browser.run(f"{buttons}[3].click()")
    browser.wait_for(f"{label}.startsWith('battery_level: 10 % to 80 %')")
    levels = [level for _, level in browser.run(f"return {plot}.signal.levels")]
    assert levels[:4] == ["WARN", "", "OK", ""]
    assert browser.run("return document.querySelectorAll('.plot .strip.warn').length") == 1
    browser.run(f"{buttons}[0].click()")
    browser.wait_for(f"{label}.startsWith('battery_level: 50 % to 50 %')")


def test_merged_samples_leave_no_holes_in_a_shorter_range(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    assert site.robots.history is not None
    starts = range(int(START_S) // 300 * 300 - 3000, int(START_S) // 300 * 300, 300)
    rows = [
        StoredSamples("atlas", "battery_level", start, 300.0, 50.0, 60.0, 55.0, 55.0, 9, 0, Level.OK)
        for start in starts
    ]
    site.robots.history.run(lambda connection: store(connection, rows))
    site.observe(50.0)
    browser.open(site.url)
    browser.click(".signal-name")
    browser.run("document.querySelectorAll('.ranges button')[2].click()")
    plot = "document.querySelector('.plot').plot"
    browser.wait_for(f"{plot} && {plot}.times.length === 10")
    assert [level for _, level in browser.run(f"return {plot}.signal.levels")] == ["OK", ""]
    # One band, not ten dots.
    assert browser.run("return document.querySelector('.plot .area').getAttribute('d').split('M').length") == 2


def test_zooming_out_shows_the_next_longer_range(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    stored(site, "atlas", -3000.0, -60.0, 70.0)
    site.observe(50.0)
    browser.open(site.url)
    browser.click(".signal-name")
    pressed = "document.querySelector('.ranges [aria-pressed=true]').textContent"
    for name in ("10 min", "1 hour", "24 hours", "7 days", "30 days", "30 days"):
        browser.click(".plot-bar button:nth-of-type(2)")
        browser.wait_for(f"{pressed} === '{name}'")
    browser.wait_for("document.querySelector('.plot svg').getAttribute('aria-label').includes('70 % to 80 %')")


def test_a_history_that_cannot_be_read_is_said_beside_the_ranges(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    site.observe(50.0)
    browser.open(site.url)
    browser.click(".signal-name")
    assert site.robots.history is not None
    site.robots.history.close()  # a writer would begin a new file
    with closing(sqlite3.connect(tmp_path / "history.db")) as connection:
        connection.execute("DROP TABLE samples")
    browser.run("document.querySelectorAll('.ranges button')[1].click()")
    browser.wait_for_text(".ranges .error-text", "The history cannot be read: ")


def test_a_range_that_could_not_be_read_is_read_again(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    stored(site, "atlas", -7200.0, -6000.0, 10.0)
    site.observe(50.0)
    browser.open(site.url)
    browser.click(".signal-name")
    buttons = "[...document.querySelectorAll('.ranges button')]"
    browser.run("window.realFetch = window.fetch; window.fetch = () => Promise.reject(new TypeError('offline'))")
    browser.run(f"{buttons}[5].click()")
    browser.wait_for_text(".ranges .error-text", "The history cannot be read: no answer from the monitor")
    browser.run("window.fetch = window.realFetch")
    site.pass_time(11.0)
    plot = "document.querySelector('.plot').plot"
    browser.wait_for(f"{plot}.view.to - {plot}.view.from > 29 * 86400 && {plot}.signal.width === 3600")
    assert browser.texts(".ranges .error-text") == [""]


def test_a_robot_shows_its_main_values_and_the_levels_of_the_last_day(
    browser: Browser, served: Any, tmp_path: Path
) -> None:
    site = served("atlas", "boreas", signals=SIGNALS, history_file=str(tmp_path / "history.db"))
    stored(site, "atlas", -8 * 3600.0, -6 * 3600.0, 50.0)
    stored(site, "atlas", -6 * 3600.0, -5.5 * 3600.0, 5.0, Level.ERROR)
    for robot in (0, 1):
        site.observe(50.0, robot=robot)
        site.observe(40.0, "temperature", robot=robot)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.day .cell').length > 1")
    assert browser.texts(".main-values")[0].strip() == "battery_level 50 % temperature 40 °C"
    label = browser.find(".day").get_attribute("aria-label")
    # The robots start at 05:06:40: the hours before are not whole cells, and one cell has both levels.
    assert label == "last 24 hours: ERROR 0.75 h, OK 2 h, unknown 21.25 h"
    cells = browser.run(
        "return [...document.querySelectorAll('.day')[0].children].map((each) => each.className.baseVal)"
    )
    assert cells == ["cell ok", "cell error"]  # nothing is drawn where nothing is known


def test_twelve_healthy_robots_fit_a_screen_with_a_line_each(browser: Browser, served: Any, tmp_path: Path) -> None:
    names = [f"robot_{number}" for number in range(12)]
    site = served(*names, signals=SIGNALS, history_file=str(tmp_path / "history.db"))
    stored(site, "robot_0", -8 * 3600.0, -6 * 3600.0, 50.0)
    for robot in range(12):
        site.observe(50.0, robot=robot, after_s=0.1)
        site.observe(40.0, "temperature", robot=robot, after_s=0.1)
    rows = "[...document.querySelectorAll('.robot.ok')]"
    for width in (1280, 390):
        browser.open(site.url, width)
        browser.wait_for(f"{rows}.length === 12 && {rows}[11].getBoundingClientRect().bottom <= 900")
        heights = browser.run(f"return {rows}.map((row) => Math.round(row.getBoundingClientRect().height))")
        assert max(heights) <= 48, width


def test_a_main_value_that_is_stale_is_not_shown_as_if_it_were_present(browser: Browser, served: Any) -> None:
    site = served("atlas", signals=SIGNALS)
    site.observe(50.0)
    site.observe(99.0, "temperature")
    for _ in range(8):  # no more of the battery
        site.observe(99.0, "temperature")
    browser.open(site.url)
    browser.wait_for_text(".main-values", "temperature 99 °C")
    assert browser.texts(".main-values")[0].strip() == "battery_level STALE temperature 99 °C"


def test_a_wall_clock_that_is_set_moves_levels_with_the_samples(browser: Browser, served: Any) -> None:
    site = served("atlas")
    for _ in range(30):
        site.observe(50.0)
    browser.open(site.url)
    browser.click(".signal-name")
    plot = "document.querySelector('.plot').plot"
    browser.wait_for(f"{plot} && {plot}.times.length === 30")
    for hours in (-1, 2):
        site.do(lambda robots, hours=hours: setattr(robots, "wall_offset_s", robots.wall_offset_s + hours * 3600.0))
        start_s = START_S + 1.0 + (3600.0 if hours > 0 else -3600.0)  # as if the clock had always been so
        browser.wait_for(f"Math.abs({plot}.times[0] - {start_s}) < 1")
        browser.wait_for(f"{plot}.signal.levels.length === 1 && {plot}.signal.levels[0][0] <= {start_s}")
        browser.wait_for("document.querySelector('.signal .since').textContent === '30\u00a0s'")
        assert browser.run(f"return {plot}.signal.levels[0][1]") == "OK"


SOON: Mapping[str, Any] = {
    "statistic": "forecast",
    "unit": "degC",
    "window_s": 20.0,
    "forecast_s": 60.0,
    "warn_above": 50.0,
    "stale_after_s": 5.0,
}


def rise(site: ServedRobots) -> None:
    """Lets a temperature rise from 20 by half a degree per second: 30 at 20 s, 50 at 60 s, 60 at 80 s."""
    for second in range(21):
        site.observe(20.0 + 0.5 * second, "soon", after_s=min(float(second), 1.0))


def test_a_forecast_says_when_it_reaches_its_bound_and_its_plot_shows_where(browser: Browser, served: Any) -> None:
    site = served("atlas", signals={"soon": SOON})
    rise(site)
    browser.open(site.url)
    browser.wait_for_text(".signal .value", "forecast 60 °C in 60 s")
    browser.wait_for_text(".signal .reason", "forecast 60 °C in 60 s is above 50 °C, reaches 50 °C in 40 s")
    browser.click(".signal-name")
    browser.wait_for("document.querySelector('.plot .meets.warn')")
    assert browser.texts(".plot .ahead-text") == ["reaches 50 °C in 40 s"]
    plot = "document.querySelector('.plot').plot"
    ahead = browser.run(f"return {plot}.signal.ahead[0]")
    assert ahead["meets"] == [pytest.approx(ahead["from"][0] + 40.0), pytest.approx(50.0)]
    assert ahead["to"] == [pytest.approx(ahead["from"][0] + 60.0), pytest.approx(60.0)]
    assert browser.run(f"return {plot}.view.last") == ahead["to"][0]
    (facts,) = browser.texts(".facts")
    assert "bounds apply to forecast: 60 °C · latest value 30 °C · trend 30 °C/min" in facts
    site.observe(30.5, "soon")
    browser.wait_for_text(".signal .reason", "reaches 50 °C in 39 s")
    browser.wait_for_text(".plot .ahead-text", "reaches 50 °C in 39 s")
    site.pass_time(7.0)
    browser.wait_for_text(".signal .badge-text", "STALE")
    browser.wait_for("!document.querySelector('.plot .ahead')")
    assert "reaches" not in browser.texts(".signal")[0]
    assert browser.console() == []


def test_a_past_alert_of_a_forecast_shows_the_line_that_gave_it(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", signals={"soon": SOON}, history_file=str(tmp_path / "history.db"))
    rise(site)
    browser.open(site.url + "#alerts")
    browser.wait_for("document.querySelector('#alerts .text a')")
    browser.click("#alerts .text a")
    browser.wait_for("document.querySelector('#alerts .plot .ahead')")
    (line,) = browser.run("return document.querySelector('#alerts .plot').plot.signal.ahead")
    assert [line["from"][1], line["to"][1]] == [pytest.approx(30.0), pytest.approx(60.0)]
    assert line["to"][0] - line["from"][0] == pytest.approx(60.0)
    assert browser.console() == []


def test_a_healthy_forecast_has_its_bound_beside_its_value(browser: Browser, served: Any) -> None:
    site = served("atlas", signals={"soon": {**SOON, "warn_above": 65.0}})
    rise(site)
    browser.open(site.url)
    browser.wait_for_text(".signal .value", "forecast 60 °C in 60 s")
    assert browser.texts(".signal .reason > span") == ["reaches 65 °C in 70 ssilenced"]


@pytest.mark.parametrize("width", [390, 1280])
def test_the_healthy_elements_of_an_array_are_folded_and_come_and_go(browser: Browser, served: Any, width: int) -> None:
    joints = {"field": 'temperature["*"]', "unit": "degC", "warn_above": 80.0, "forget_after_s": 10.0}
    site = served("atlas", signals={"joints": joints, **BATTERY})
    names = [f"joint_{number}" for number in range(98)] + [LONG * 3]

    def see(names: list[str]) -> None:
        elements = Elements((name, 90.0 if name == "joint_7" else 50.0) for name in names)
        site.observe(60.0)
        site.do(lambda robots: robots.observe(elements, "joints"))

    see(names)
    browser.open(site.url, width)
    shown = "[...document.querySelectorAll('.signal-name')].map((each) => each.textContent)"
    browser.wait_for(f"{shown}.length === 3")
    assert browser.run(f"return {shown}") == ["joints[joint_7]", "joints", "battery_level"]
    assert browser.texts(".elements button") == ["Show 98 elements that are OK"]
    browser.find(".elements button").send_keys(Keys.ENTER)
    browser.wait_for(f"{shown}.length === 101")
    assert browser.texts(".elements button") == ["Hide 98 elements that are OK"]
    browser.wait_for("[...document.querySelectorAll('.spark')].length === 100")  # none of the array as a whole
    size = "return [document.documentElement.scrollWidth, document.documentElement.clientWidth]"
    assert len(set(browser.run(size))) == 1
    browser.run(
        "[...document.querySelectorAll('.signal-name')].find((each) => each.textContent.endsWith('_3]')).click()"
    )
    browser.run("document.querySelector('.elements button').click()")
    browser.wait_for(f"{shown}.length === 4")  # an open one stays
    for _ in range(12):
        see(["joint_3", "joint_7", "new"])
    browser.wait_for(f"{shown}.length === 5")
    assert set(browser.run(f"return {shown}")) == {f"joints[{name}]" for name in ("joint_3", "joint_7", "new")} | {
        "joints", "battery_level"
    }  # fmt: skip
    assert browser.run("return document.querySelectorAll('.elements, .plot svg').length") == 1  # the plot
    assert browser.console() == []


def test_a_robot_without_signals_is_not_ok_and_says_what_to_run(browser: Browser, served: Any) -> None:
    site = served("atlas")
    site.observe(50.0)
    browser.open(site.url)
    browser.wait_for_text(".main-values", "battery_level 50")

    def watch_nothing(robots: Robots) -> None:
        monitor = robots.all[0].monitor
        monitor.configure(replace(monitor.config, signals={}))

    site.do(watch_nothing)
    browser.wait_for_text(".cause", "no signal is watched: run `robot-health init`")
    assert browser.find("#summary").text == "atlas: waiting"
    assert browser.texts(".signal") == []
    assert browser.console() == []


def test_the_names_of_bounds_are_beside_the_plot(browser: Browser, served: Any) -> None:
    bounds = {"warn_below": 20.0, "error_below": 19.5, "warn_above": 90.0, "error_above": 90.1}
    site = served("atlas", signals={"voltage": {"unit": "V", **bounds}})
    for value in (50.0, 51.0):
        site.observe(value, "voltage")
    for width in (1280, 390):
        browser.open(site.url, width)
        browser.click(".signal-name")
        browser.wait_for("document.querySelectorAll('.plot .bound-name').length === 4")
        box = "(({left, right, top, bottom}) => [left, right, top, bottom])(each.getBoundingClientRect())"
        boxes = f"return [...document.querySelectorAll(arguments[0])].map((each) => {box})"
        names = browser.run(boxes, ".plot .bound-name")
        (svg,), (line, *_) = browser.run(boxes, ".plot svg"), browser.run(boxes, ".plot .bound")
        assert all(line[1] <= left and right <= svg[1] for left, right, _, _ in names)
        assert all(one[3] <= other[2] + 1.0 for one, other in zip(names, names[1:]))  # none covers another
        assert browser.run("return document.querySelector('.plot svg').getBoundingClientRect().height") >= 250
        ticks = browser.texts(".plot svg > text")
        assert "40 V" in ticks


def test_signals_are_sorted_worst_first_and_show_their_trend(browser: Browser, served: Any) -> None:
    site = served("atlas", signals=SIGNALS)
    for value in (50.0, 60.0):
        site.observe(value)
        site.observe(value, "temperature")
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.signal.ok .spark-line').length === 2")
    assert browser.texts(".signal-name bdi") == ["battery_level", "temperature"]
    bounds = "[...document.querySelectorAll('.signal')].map((row) => row.querySelectorAll('.spark-bound').length)"
    assert browser.run(f"return {bounds}") == [1, 2]
    site.observe(99.0, "temperature")
    browser.wait_for("document.querySelector('.signal').className === 'signal error'")
    assert browser.texts(".signal-name bdi") == ["temperature", "battery_level"]
    assert browser.texts(".signal .value")[0] == "99 °C"


def test_plots_of_several_robots_are_live_at_once(browser: Browser, served: Any) -> None:
    names = [f"robot{number}" for number in range(11)]
    site = served(*names)
    for robot in range(11):
        site.observe(50.0, robot=robot, after_s=0.0)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot.ok').length === 11")
    for number in range(10):
        browser.run(f"document.querySelectorAll('.robot-head')[{number}].click()")
        browser.run(f"document.querySelectorAll('.robot')[{number}].querySelector('.signal-name').click()")
    labels = "[...document.querySelectorAll('.plot svg')].map((svg) => svg.getAttribute('aria-label'))"
    start = "battery_level: 50 % to 50 %"
    browser.wait_for(f"{labels}.filter((label) => label.startsWith(arguments[0])).length === 10", start)
    site.observe(40.0, robot=0)
    site.observe(30.0, robot=9)
    browser.wait_for(f"{labels}[0].includes('40 % to 50 %') && {labels}[9].includes('30 % to 50 %')")
    browser.run("document.querySelectorAll('.robot-head')[10].click()")
    browser.run("document.querySelectorAll('.robot')[10].querySelector('.signal-name').click()")
    assert browser.run("return document.querySelectorAll('.plot').length") == 10  # the API sends the samples of ten
    browser.wait_for(f"({labels}[9] || '').startsWith(arguments[0])", start)
    assert browser.run("return document.querySelectorAll('.robot')[0].querySelector('.plot')") is None


def test_the_plot_of_a_signal_that_ended_shows_its_last_values(browser: Browser, served: Any) -> None:
    site = served("atlas")
    for _ in range(3):
        site.observe(50.0, after_s=40.0)  # a window of 60 s: two samples, 40 s apart
    browser.open(site.url)
    browser.wait_for("document.querySelector('.signal-name')")
    browser.click(".signal-name")
    browser.wait_for("document.querySelector('.plot svg[aria-label*=\"50 % to 50 %\"]')")
    site.pass_time(3600.0)
    browser.wait_for("document.querySelector('.robot.stale')")
    view = "document.querySelector('.plot').plot.view"
    browser.wait_for(f"Math.round({view}.to - {view}.from) === 100")  # 40 s of values and 60 s without


def test_past_alerts_have_their_evidence(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    for value in (50.0, 35.0, 19.0):
        site.observe(value)
    browser.open(site.url + "#alerts")
    browser.wait_for("document.querySelectorAll('#alerts .alert').length === 1")
    assert browser.texts("#alerts .badge-text") == ["WARN"]
    assert browser.texts("#alerts .text bdi")[0].startswith("battery_level WARN: 19 % is below 20 %")
    browser.click("#alerts .text a")
    browser.wait_for("document.querySelector('#alerts .plot svg')")
    label = browser.find("#alerts .plot svg").get_attribute("aria-label")
    assert label.startswith("battery_level: 19 % to 50 %, 1 alert.")
    browser.click("#all-alerts a")
    browser.wait_for("!document.querySelector('#alerts .plot svg')")
    site.observe(60.0)
    site.do(lambda robots: robots.all[0].reset())
    browser.wait_for("document.querySelectorAll('#alerts .alert').length === 2")  # the resolved one is on top
    assert browser.texts("#alerts .badge-text") == ["OK", "WARN"]
    browser.click("#alerts .robot-cell a")
    browser.wait_for("document.querySelector('.robot-head').getAttribute('aria-expanded') === 'true'")


def test_an_alert_has_its_own_page(browser: Browser, served: Any, tmp_path: Path) -> None:
    battery = {**BATTERY["battery_level"], "what_to_do": "https://example.org/battery"}
    site = served("atlas", signals={**SIGNALS, "battery_level": battery}, history_file=str(tmp_path / "history.db"))
    stored(site, "atlas", -600.0, -60.0, 70.0)
    site.observe(99.0, "temperature")
    for value in (50.0, 19.0):
        site.observe(value)
    browser.open(site.url)
    browser.click("#recent-alerts .alert:nth-child(2) .text a")
    browser.wait_for_text(".alert-title", "battery_level WARN: 19 % is below 20 % (was OK for 1 s)")
    assert browser.run("return location.hash").startswith("#alerts/")
    address = browser.run("return location.href")
    browser.wait_for("document.querySelectorAll('#alert-page .plot svg').length === 2")
    around = browser.run("return document.querySelectorAll('#alert-page .plot svg')[1].getAttribute('aria-label')")
    assert around.startswith("battery_level, half an hour before and after: 70 % to 80 %, 1 alert")
    parts = "[...document.querySelectorAll('#alert-page section')]"
    assert browser.run(f"return {parts}.map((each) => each.firstChild.textContent)") == [
        "What to do", "Samples in the window", "Half an hour before and after", "Also not OK then",
        "Thresholds in force", "Notes",
    ]  # fmt: skip
    assert "temperature ERROR: 99 °C is above 95 °C" in browser.texts("#alert-page section")[3]
    assert browser.find("#alert-page section a").get_attribute("href") == "https://example.org/battery"
    assert "warn_below: 20" in browser.texts("#alert-page pre")[0]
    assert not browser.find("#alert-filter").is_displayed()
    browser.type(".note-form input", f"wheel was blocked {HOSTILE}")
    browser.type(".note-form input:nth-of-type(2)", "ana")
    browser.click(".note-form button")
    browser.wait_for_text(".notes li", f"wheel was blocked {HOSTILE}")
    slow = "const {fetch} = window; window.sent = 0; window.fetch = (...all) => (sent++, new Promise((done) =>"
    browser.run(f"{slow} (window.answer = () => done(fetch(...all)))));")
    browser.type(".note-form input", "once")
    browser.find(".note-form input").send_keys(Keys.ENTER, Keys.ENTER)  # the second while the first is sent
    assert browser.run("const count = sent; answer(); return count;") == 1
    browser.wait_for("document.querySelectorAll('.notes li').length === 2")
    browser.open(address)  # a colleague
    browser.wait_for_text(".notes li", "ana, ")
    browser.click("#all-alerts a")
    browser.wait_for("!document.querySelector('#alert-page').childElementCount")
    assert browser.find("#alert-filter").is_displayed()
    assert browser.console() == []


def test_an_alert_that_is_no_longer_stored_is_said(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    site.observe(50.0)
    browser.open(f"{site.url.rstrip('/')}/#alerts/777")
    browser.wait_for_text(
        "#alert-page", "The alert cannot be shown: there is no alert 777; the history deletes old ones"
    )


@pytest.mark.parametrize("name", ["abc", "-1", "1.5", "..", "levels", "%E0%A4%A", "7%2F..", HOSTILE])
def test_an_address_without_the_number_of_an_alert_asks_for_none(
    browser: Browser, served: Any, tmp_path: Path, name: str
) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    browser.open(f"{site.url}#alerts/{name}")
    browser.wait_for_text("#alert-page", "The alert cannot be shown: its address does not end with a number")
    assert browser.console() == []  # no request was refused


def test_a_robot_that_does_not_exist_is_said(browser: Browser, served: Any) -> None:
    site = served("atlas", "boreas")
    browser.open(f"{site.url}#robots/carter")
    browser.wait_for_text("#no-robot", "There is no robot carter.")
    assert browser.find("#no-robot").is_displayed()
    assert kinds(browser).keys() == {"atlas", "boreas"}


def test_the_page_of_a_stale_alert_shows_the_last_samples_before_it(
    browser: Browser, served: Any, tmp_path: Path
) -> None:
    signals = {"rate": {"statistic": "rate", "window_s": 5.0, "stale_after_s": 8.0, "warn_below": 0.1}}
    site = served("atlas", signals=signals, history_file=str(tmp_path / "history.db"))
    for _ in range(4):
        site.observe(1.0, "rate")
    site.pass_time(20.0)
    browser.open(f"{site.url}#alerts/{alert_id(site, 'rate', Level.STALE)}")
    browser.wait_for_text(".alert-title", "rate STALE: no sample for 9 s (limit 8 s)")
    browser.wait_for("document.querySelectorAll('#alert-page .plot svg').length === 2")
    labels = browser.run("return [...document.querySelectorAll('#alert-page .plot svg')].map((each) => each.ariaLabel)")
    assert labels[0].startswith("rate: 1 to 1, 1 alert.")  # the values
    assert labels[1].startswith("rate, half an hour before and after: 0 to 0, 1 alert.")  # the rate
    around = "document.querySelectorAll('#alert-page .plot')[1]"
    assert browser.run(f"return {around}.plot.signal.levels.map(([, level]) => level)") == ["WARN", "STALE", ""]
    # Hatched: values and levels after the last period.
    assert browser.run(f"return {around}.querySelectorAll('rect[fill*=unknown]').length") == 2


def test_the_page_of_an_alert_without_any_sample_says_so(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    site.pass_time(30.0)
    browser.open(f"{site.url}#alerts/1")
    browser.wait_for_text(".alert-title", "battery_level STALE: no sample since the start")
    browser.wait_for_text("#alert-page", "The history has no samples of this time.")
    assert browser.texts("#alert-page section")[0] == "Samples in the windowNo samples."
    assert browser.run("return document.querySelectorAll('#alert-page svg.shape + * ~ .plot svg').length") == 0


def test_the_page_of_an_alert_is_loaded_again_after_a_lost_connection(
    browser: Browser, served: Any, tmp_path: Path
) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    site.observe(19.0)
    browser.open(site.url)
    browser.wait_for("document.querySelector('#recent .alert')")
    real = "window.realFetch = window.fetch; window.fetch = () => Promise.reject(new TypeError('offline'))"
    browser.run(f"{real}; location.hash = '#alerts/1'")
    browser.wait_for_text("#alert-page", "The alert cannot be shown: no answer from the monitor")
    browser.run("window.fetch = window.realFetch; document.getElementById('retry').click()")
    browser.wait_for_text(".alert-title", "battery_level WARN: 19 % is below 20 %")
    site.close()
    browser.wait_for("document.body.className === 'lost'")
    browser.run("location.hash = '#alerts/2'")  # not the alert before under the address of another one
    browser.wait_for_text("#alert-page", "The alert cannot be shown: no answer from the monitor")


def test_the_start_page_has_the_recent_alerts(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", signals={"battery_level": BOUND}, history_file=str(tmp_path / "history.db"))
    site.observe(19.0)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('#recent .alert').length === 1")
    for value in (50.0, 18.0, 50.0, 17.0, 50.0, 16.0):
        site.observe(value)
    browser.wait_for_text("#recent .alert .text", "16 is")
    assert browser.run("return document.querySelectorAll('#recent .alert').length") == 5
    browser.wait_for("document.querySelectorAll('#recent .alert.open').length === 1")
    assert browser.texts("#recent .alert.open .text bdi") == ["battery_level WARN: 16 is below 20 (was OK for 1 s)"]
    browser.click("#recent [href='#alerts']")
    browser.wait_for("document.querySelectorAll('#alerts .alert').length === 7")


def test_the_recent_alerts_are_by_robot_worst_first(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", "boreas", signals=SIGNALS, history_file=str(tmp_path / "history.db"))
    site.observe(99.0, "temperature", robot=1, after_s=0.1)
    site.observe(19.0, robot=0, after_s=0.1)
    site.observe(19.0, robot=1, after_s=0.1)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('#recent .alert').length === 3")
    rows = zip(browser.texts("#recent .robot-cell"), browser.texts("#recent .badge-text"))
    assert list(rows) == [("boreas", "ERROR"), ("boreas", "WARN"), ("atlas", "WARN")]


def test_alerts_are_filtered_and_silenced(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", "boreas", signals=SIGNALS, history_file=str(tmp_path / "history.db"))
    site.observe(85.0, "temperature", 0)
    site.observe(50.0, "temperature", 0)
    site.observe(99.0, "temperature", 1)
    site.observe(19.0, robot=1)
    site.observe(50.0, robot=0)
    browser.open(site.url + "#alerts")
    text = "row.querySelector('.robot-cell').textContent + ' ' + row.querySelector('.text').textContent.split(':')[0]"
    lines = f"[...document.querySelectorAll('#alerts .alert')].map((row) => {text})"
    everything = ["boreas battery_level WARN", "boreas temperature ERROR"]
    everything += ["atlas temperature OK", "atlas temperature WARN"]
    browser.wait_for(f"JSON.stringify({lines}) === JSON.stringify(arguments[0])", everything)
    assert len(browser.texts("#alerts .alert.open")) == 2
    for robot, name, wanted in (
        ("las", " ", everything[2:]),
        (" ", "temp?ra", everything[1:]),
        ("*b*r", " ", everything[:2]),
        ("bor", "none", []),
    ):
        browser.type("#alert-robot", robot)
        browser.type("#alert-signal", name)
        browser.wait_for(f"JSON.stringify({lines}) === JSON.stringify(arguments[0])", wanted)
    assert browser.find("#alerts .note").text == "No alert matches."
    browser.type("#alert-signal", " ")
    browser.type("#alert-robot", " ")
    browser.click("#alert-open")
    browser.wait_for(f"JSON.stringify({lines}) === JSON.stringify(arguments[0])", everything[:2])
    browser.click("#alert-level option:nth-child(2)")
    browser.wait_for(f"JSON.stringify({lines}) === JSON.stringify(arguments[0])", everything[1:2])
    browser.click("#alerts .alert .action button")
    assert browser.find("#silence-time").get_attribute("value") == "resolved"
    assert browser.find("#silence-signal").get_attribute("value") == "temperature"
    browser.type("#silence-reason", "on my way")
    browser.type("#silence-author", "ana")
    browser.click("#silence-dialog [type=submit]")
    browser.wait_for_text("#silence-count", "1")
    browser.wait_for("!document.querySelector('#alerts .alert .action .silenced-mark').hidden")
    assert not browser.find("#alerts .alert .action button").is_displayed()


def test_a_table_of_alerts_stays_short_and_has_no_hole(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", signals={"battery_level": BOUND}, history_file=str(tmp_path / "history.db"))

    def alert(count: int) -> None:
        def act(robots: Robots) -> None:
            for number in range(count):
                robots.at(robots.bus.now_s + 1.0)
                robots.observe(10.0 if number % 2 == 0 else 50.0)

        site.do(act)

    alert(8)
    browser.open(site.url)
    browser.wait_for("document.querySelector('.signal-name')")
    browser.click(".signal-name")
    of_signal = "document.querySelectorAll('.signal-body .alert').length"
    browser.wait_for(f"{of_signal} === 5")
    newest = "(document.querySelector('#alerts time') || document.body).dateTime"
    browser.run("location.hash = 'alerts'")
    browser.wait_for("document.querySelectorAll('#alerts .alert').length === 8")
    before = browser.run(f"return {newest}")
    alert(300)
    browser.wait_for(f"{newest} !== arguments[0]", before)
    assert browser.run("return document.querySelectorAll('#alerts .alert').length") == 100
    assert browser.find("#alert-history button:last-child").is_displayed()  # show older
    alert(2)
    browser.wait_for(f"{newest} !== arguments[0]", browser.run(f"return {newest}"))
    assert browser.run("return document.querySelectorAll('#alerts .alert').length") == 100
    assert browser.run(f"return {of_signal}") == 5


def test_the_page_silences_and_ends_a_silence(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", history_file=str(tmp_path / "history.db"))
    site.observe(19.0)
    browser.open(site.url)
    browser.wait_for("document.querySelector('.signal-name')")
    browser.click(".signal-name")
    browser.click(".signal-body .buttons button")
    assert browser.find("#silence-robot").get_attribute("value") == "atlas"
    assert browser.find("#silence-signal").get_attribute("value") == "battery_level"
    browser.click("#silence-time [value=resolved]")
    browser.type("#silence-reason", "on the charger")
    browser.type("#silence-author", "ana")
    browser.click("#silence-dialog [type=submit]")
    browser.wait_for_text(".robot-head .silenced-mark", "1 silenced")
    browser.wait_for_text(".signal-body", "Silenced: on the charger")
    assert kinds(browser) == {"atlas": "WARN"}  # it stays visible
    assert not browser.find("#silence-dialog").is_displayed()
    browser.click("#tabs [href='#silences']")
    assert browser.texts(".silences tbody td")[:4] == [
        "robot=atlas,signal=battery_level",
        "on the charger",
        "ana",
        "until resolved",
    ]
    browser.click(".silences tbody button")
    browser.click("#confirm-dialog [type=submit]")
    browser.wait_for("document.getElementById('silence-count').hidden")
    browser.click("#silence-list > .buttons button")
    assert browser.find("#silence-author").get_attribute("value") == "ana"
    browser.type("#silence-reason", "test")
    site.do(lambda robots: robots.history.close())
    browser.click("#silence-dialog [type=submit]")
    browser.wait_for_text("#silence-dialog .error-text", "Failed: ")
    assert browser.find("#silence-dialog").is_displayed()


def test_the_page_resets_latched_alerts_after_a_confirmation(browser: Browser, served: Any) -> None:
    site = served("atlas")
    site.observe(19.0)
    site.observe(60.0)
    browser.open(site.url + "#robots/%E0%A4%A")  # not UTF-8
    browser.wait_for("document.querySelector('.robot.warn .robot-tools')")
    browser.run(
        "window.said = [];"
        "const note = () => said.push([announcer.textContent, document.querySelectorAll('dialog[open]').length]);"
        "new MutationObserver(note).observe(announcer, {childList: true});"
    )
    browser.click(".reset")
    assert "atlas" in browser.find("#confirm-text").text
    browser.press(Keys.ESCAPE)
    browser.wait_for("!document.getElementById('confirm-dialog').open")
    assert kinds(browser) == {"atlas": "WARN"}
    browser.click(".reset")
    browser.click("#confirm-dialog [type=submit]")
    browser.wait_for("document.querySelector('.robot.ok')")
    browser.wait_for("said.length")
    assert browser.run("return said[0]") == ["reset: battery_level", 0]  # what is behind a dialog is not read out
    assert browser.console() == []


def test_a_robot_of_any_name_can_be_silenced(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served(HOSTILE, history_file=str(tmp_path / "history.db"))
    site.observe(19.0)
    browser.open(site.url)
    browser.wait_for("document.querySelector('.robot-tools')")
    browser.click(".robot-tools button")
    browser.type("#silence-reason", "test")
    browser.type("#silence-author", "ana")
    browser.click("#silence-dialog [type=submit]")
    browser.wait_for_text(".robot-head .silenced-mark", "1 silenced")


def test_silenced_alerts_are_counted_and_a_silence_has_the_name_of_its_signal(
    browser: Browser, served: Any, tmp_path: Path
) -> None:
    drivers = {"field": 'temperature["*"]', "unit": "degC", "warn_above": 80.0}
    history = str(tmp_path / "history.db")
    site = served("atlas", "boreas", signals={"drivers": drivers, **SIGNALS}, history_file=history)
    for robot in (0, 1):
        site.observe(40.0, "temperature", robot=robot, after_s=0.2)
        site.observe(50.0, robot=robot, after_s=0.2)
        elements = Elements([("motor_driver: left", 50.0 if robot else 90.0)])
        site.observe(elements, "drivers", robot=robot, after_s=0.2)
    browser.open(site.url + "#robots/atlas")
    browser.wait_for("document.querySelectorAll('.signal').length === 4")
    order = "[...document.querySelector('.robot-body').children].map((each) => each.className)"
    assert browser.run(f"return {order}") == ["robot-tools", "signals"]
    browser.click(".signal-name")  # the worst one
    browser.click(".signal-body .buttons button")
    assert browser.find("#silence-signal").get_attribute("value") == "drivers[motor_driver: left]"
    browser.run("document.getElementById('silence-dialog').close()")
    site.do(lambda robots: robots.silences.add(parse_matchers("robot=*"), for_s=3600.0, reason="test"))
    browser.wait_for_text(".robot.warn .silenced-mark", "1 silenced")
    assert browser.find(".robot.ok .silenced-mark").get_attribute("hidden") is not None
    shown = "[...document.querySelectorAll('.signal .silenced-mark')].filter((mark) => !mark.hidden).length"
    assert browser.run(f"return {shown}") == 1
    reason = browser.run("return document.querySelector('.robot.warn .cause').textContent")
    assert reason == "drivers[motor_driver: left]: 90\u00a0°C is above 80\u00a0°C"


def test_effects_are_folded_below_their_cause(browser: Browser, served: Any) -> None:
    depending = {"unit": "degC", "warn_above": 80.0, "depends_on": ["battery_level"]}
    battery = {**BATTERY["battery_level"], "error_below": 10.0}
    site = served("atlas", signals={"motor": depending, **SIGNALS, "battery_level": battery})
    for value in (5.0, 4.0):
        site.observe(value)
        site.observe(90.0, "motor", after_s=0.1)
        site.observe(50.0, "temperature", after_s=0.1)
    browser.open(site.url)
    shown = "[...document.querySelectorAll('.signal-name')].map((each) => each.textContent)"
    browser.wait_for(f"{shown}.length === 2")
    assert browser.run(f"return {shown}") == ["battery_level", "temperature"]
    assert browser.texts(".elements button") == ["Show 1 affected"]
    assert browser.texts(".cause")[0].startswith("battery_level: 4 % is below 10 %")
    assert "more" not in browser.texts(".cause")[0]
    browser.click(".elements button")
    browser.wait_for(f"{shown}.length === 3")
    assert browser.run(f"return {shown}") == ["battery_level", "motor", "temperature"]
    assert browser.console() == []


def test_an_alert_names_its_effects_and_so_does_its_silence(browser: Browser, served: Any, tmp_path: Path) -> None:
    depending = {"unit": "degC", "warn_above": 80.0, "depends_on": ["battery_level"]}
    battery = {**BATTERY["battery_level"], "error_below": 10.0}
    signals = {"motor": depending, "battery_level": battery}
    site = served("atlas", signals=signals, history_file=str(tmp_path / "history.db"))
    for value, name in ((50.0, "battery_level"), (50.0, "motor"), (4.0, "battery_level"), (99.0, "motor")):
        site.observe(value, name)
    site.observe(4.0, "battery_level")
    browser.open(site.url)
    browser.click("#recent-alerts .action button")
    browser.wait_for_text("#silence-effects", "Also covers 1 signal that it affects.")
    browser.click("#silence-dialog .cancel")
    browser.click("#recent-alerts .text a")
    browser.wait_for("document.querySelector('#alert-page section')")
    assert browser.texts("#alert-page section")[0] == "Affectsmotor"


def test_the_page_of_an_effect_links_to_the_alert_of_its_cause(browser: Browser, served: Any, tmp_path: Path) -> None:
    depending = {"unit": "degC", "warn_above": 80.0, "error_above": 90.0, "depends_on": ["battery_level"]}
    battery = {**BATTERY["battery_level"], "error_below": 10.0}
    signals = {"motor": depending, "battery_level": battery}
    site = served("atlas", signals=signals, history_file=str(tmp_path / "history.db"))
    settled = [(50.0, "battery_level"), (50.0, "motor")] * 4  # at the start, a signal that is not known is a cause
    for value, name in (*settled, (99.0, "motor"), (4.0, "battery_level"), (85.0, "motor")):
        site.observe(value, name)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('#recent .alert').length === 3")
    titles = []
    for name in ("motor ERROR", "motor WARN"):  # one from before the cause, and one from then
        browser.open(f"{site.url}#alerts/{1 if name == 'motor ERROR' else 3}")
        browser.wait_for_text("#alert-page .alert-title", name)
        titles.append(browser.texts("#alert-page section")[0])
    assert titles == ["Causebattery_level"] * 2
    browser.click("#alert-page section a")
    browser.wait_for_text("#alert-page .alert-title", "battery_level ERROR: 4 % is below 10 %")


def test_a_silent_topic_is_one_row_with_its_signals_folded(browser: Browser, served: Any) -> None:
    wheels = {"topic": "/wheels", "type": "geometry_msgs/Vector3"}
    site = served("atlas", signals={"left": {**wheels, "field": "x"}, "right": {**wheels, "field": "y"}})

    def drive(robots: Robots) -> None:
        driver = robots.bus.node("driver")
        driver.advertise("/wheels", "geometry_msgs/Vector3")
        for second in range(10):
            robots.at(robots.bus.now_s + 1.0)
            if second < 2:
                driver.publish("/wheels", {"x": 1.0, "y": 2.0, "z": 0.0})

    site.do(drive)
    browser.open(site.url)
    browser.wait_for_text(".elements button", "Show 2 affected")
    assert browser.texts(".signal-name") == ["/wheels"]
    assert browser.texts(".signal .value") == [""]  # a topic has none
    assert browser.texts(".cause")[0].startswith("/wheels: no message for ")


def test_screen_readers_get_names_and_levels_without_repetitions(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", "boreas", history_file=str(tmp_path / "history.db"))
    site.observe(19.0)
    site.observe(60.0, robot=1)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot').length === 2")
    browser.run("document.querySelectorAll('.robot-head')[0].click()")
    browser.click(".signal-name")
    browser.wait_for("document.querySelector('.signal-body .alert')")
    nodes = browser.driver.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    seen = [
        (
            node["role"]["value"],
            node["name"]["value"].replace("\u00a0", " "),
            {each["name"]: each["value"] for each in node["properties"]},
        )
        for node in nodes
        if not node["ignored"] and "name" in node and "properties" in node
    ]
    headings = [name for role, name, properties in seen if role == "heading" and properties["level"]["value"] == 3]
    assert headings[0].startswith("WARN atlas battery_level: 19 % is below 20 %")
    shown = "[...document.querySelectorAll('h1, h2, h3, h4, h5')].filter((each) => each.getClientRects().length)"
    assert browser.run(f"return {shown}.map((each) => each.tagName)") == ["H1", "H2", "H3", "H4", "H3", "H2"]
    assert [name for role, name, _ in seen if role == "button" and not name] == []
    assert [name for role, name, _ in seen if role == "rowheader"] == ["battery_level"]
    heads = [name for role, name, _ in seen if role == "columnheader"]
    begin = heads.index("Signal") - 1
    assert heads[begin : begin + 6] == ["Level", "Signal", "Value", "Trend", "Reason", "For"]
    # What is in a live region is read at each change: the time and the countdown are in none.
    assert browser.run(
        "return ['#connection', '#lost-text', '.since'].filter("
        "(each) => document.querySelector(each).closest('[role=alert], [role=status], [aria-live]'))"
    ) == []  # fmt: skip


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_axe_finds_no_violation(browser: Browser, served: Any, tmp_path: Path, width: int, dark: bool) -> None:
    """axe is the accessibility checker of Lighthouse and of the browsers' developer tools."""
    axe = pytest.importorskip("axe_core_python", reason="axe-core-python, which has axe, is not installed")
    script = (Path(axe.__file__).parent / "axe.min.js").read_text("utf-8")
    signals = {**SIGNALS, "soon": SOON}
    site = served("atlas", "boreas", signals=signals, history_file=str(tmp_path / "history.db"))
    rise(site)
    stored(site, "atlas", -600.0, -60.0, 70.0)
    site.observe(99.0, "temperature")
    site.observe(19.0)
    site.observe(60.0, robot=1)

    def violations() -> list[str]:
        found: list[str] = browser.driver.execute_async_script(
            "const done = arguments[0];"
            "axe.run(document).then(({violations}) => done(violations.flatMap("
            "({id, nodes}) => nodes.map(({html}) => `${id}: ${html}`))));"
        )
        return found

    browser.open(site.url, width, dark=dark)
    browser.run(f"{script}; null")
    browser.wait_for("document.querySelectorAll('.robot').length === 2")
    browser.run("document.querySelectorAll('.robot-head')[0].click()")
    browser.run("document.querySelectorAll('.signal-name').forEach((button) => button.click())")
    browser.wait_for("document.querySelector('.signal-body .alert') && document.querySelector('.plot .ahead-text')")
    assert violations() == []
    browser.click(".signal-body > .buttons button")
    assert violations() == []
    browser.press(Keys.ESCAPE)
    browser.click(".reset")
    assert violations() == []
    browser.press(Keys.ESCAPE)
    for view in ("alerts", "silences"):
        browser.run("location.hash = arguments[0]", view)
        browser.wait_for("!document.getElementById(arguments[0]).hidden", view)
        assert violations() == []
    alert = alert_id(site, "battery_level", Level.WARN)
    browser.run("location.hash = `alerts/${arguments[0]}`", alert)
    browser.wait_for("document.querySelectorAll('#alert-page .plot svg').length === 2")
    browser.type(".note-form input", "wheel was blocked")
    browser.click(".note-form button")
    browser.wait_for_text(".notes li", "wheel was blocked")
    assert violations() == []
    site.close()
    browser.wait_for("document.body.className === 'lost'")
    assert violations() == []


def test_the_page_prints_dark_on_white_with_readable_plots(browser: Browser, served: Any) -> None:
    site = served("atlas")
    site.observe(60.0)
    browser.open(site.url, 1280, dark=True)
    browser.wait_for("document.querySelector('.signal-name')")
    browser.click(".signal-name")
    browser.wait_for("document.querySelector('.plot svg')")
    browser.run(
        "window.printed = {};"
        "const width = () => document.querySelector('.plot svg').viewBox.baseVal.width;"
        "addEventListener('beforeprint', () => printed.width = width());"
        "matchMedia('print').addEventListener('change', ({matches}) => {"
        "  if (matches) printed.color = getComputedStyle(document.body).color; });"
    )
    browser.driver.execute_cdp_cmd("Page.printToPDF", {})
    assert browser.run("return printed") == {"width": 680, "color": "rgb(27, 31, 36)"}
    assert browser.run("return document.querySelector('.plot svg').viewBox.baseVal.width") > 1000


def test_everything_can_be_done_with_the_keyboard(browser: Browser, served: Any, tmp_path: Path) -> None:
    site = served("atlas", "boreas", history_file=str(tmp_path / "history.db"))
    site.observe(19.0)
    browser.open(site.url)
    browser.wait_for("document.querySelectorAll('.robot').length === 2")

    def tab_to(selector: str) -> None:
        for _ in range(40):
            browser.press(Keys.TAB)
            if browser.run("return document.activeElement.matches(arguments[0])", selector):
                assert browser.run("return getComputedStyle(document.activeElement).outlineStyle") != "none"
                return
        raise AssertionError(f"{selector} was not reached with the key Tab")

    tab_to(".skip")
    tab_to("#tabs a")
    tab_to("#filter")
    tab_to(".robot-head")
    browser.press(Keys.ENTER)
    tab_to(".signal-name")
    browser.press(Keys.SPACE)
    assert browser.run("return document.activeElement.getAttribute('aria-expanded')") == "true"
    browser.wait_for("document.querySelector('.plot svg')")
    tab_to(".plot svg")
    browser.press("+")
    tab_to(".signal-body > .buttons button")
    browser.press(Keys.ENTER)
    assert browser.run("return document.activeElement.id") == "silence-time"
    browser.press(Keys.ESCAPE)
    browser.wait_for("!document.getElementById('silence-dialog').open")
    assert browser.run("return document.activeElement.textContent") == "Silence…"


def test_the_token_is_asked_for_once(browser: Browser, served: Any) -> None:
    site = served("atlas", token="correct horse")
    site.observe(19.0)
    browser.open(site.url)
    browser.wait_for("!document.getElementById('login').hidden")
    assert browser.run("return document.activeElement.id") == "token"
    assert browser.driver.title.startswith("token required")
    assert browser.texts(".robot") == []
    browser.find("#token").send_keys("wrong", Keys.ENTER)
    browser.wait_for_text("#login-error", "The token is wrong.")
    browser.find("#token").send_keys("correct horse", Keys.ENTER)
    browser.wait_for("document.querySelector('.robot.warn')")
    assert not browser.find("#login").is_displayed()
    kept = "location.href + document.cookie + JSON.stringify(localStorage) + document.documentElement.outerHTML"
    assert "horse" not in browser.run(f"return {kept}")
    browser.driver.refresh()
    browser.wait_for("document.querySelector('.robot.warn')")
    browser.click("#logout")
    browser.wait_for("!document.getElementById('login').hidden")


def test_many_loads_in_one_tab_leave_no_stream_open(browser: Browser, served: Any) -> None:
    """A browser opens six connections to a server at most, and keeps pages for going back."""
    site = served("atlas")
    site.observe(50.0)
    for number in range(10):
        browser.driver.get(f"{site.url}?load={number}")
        browser.wait_for("document.querySelectorAll('.robot.ok').length === 1")
    wait_for(lambda: site.pages == 1)
    browser.driver.back()
    browser.wait_for("location.search === '?load=8'")
    site.observe(19.0)
    browser.wait_for("document.querySelectorAll('.robot.warn').length === 1")
    wait_for(lambda: site.pages == 1)


@pytest.mark.parametrize("name", ["levels.js", "page.js", "plot.js"])
def test_a_page_whose_files_did_not_all_come_loads_again(browser: Browser, served: Any, name: str) -> None:
    site = served("atlas")
    site.observe(50.0)
    browser.driver.execute_cdp_cmd("Network.enable", {})
    try:
        browser.driver.execute_cdp_cmd("Network.setBlockedURLs", {"urls": [f"*/{name}"]})
        browser.open(site.url)
        loaded = browser.run("return performance.timeOrigin")
        browser.wait_for("performance.timeOrigin !== arguments[0]", loaded)
    finally:
        browser.driver.execute_cdp_cmd("Network.setBlockedURLs", {"urls": []})
    browser.wait_for("document.querySelector('.robot.ok')")


def test_a_lost_monitor_shows_and_comes_back(browser: Browser, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "robot_health_monitor", "run", "--source", "simulated", "--port"]
    monitor = LineProcess([*command, "0"])
    try:
        url = monitor.wait_for_text("web page: ").split("web page: ")[1]
        browser.open(url)
        browser.wait_for("document.body.className === 'live' && document.querySelector('.robot.ok')")
        ok = browser.run("return getComputedStyle(document.querySelector('.robot-head .badge')).color")
    finally:
        monitor.signal(signal.SIGKILL)
        monitor.wait()
    browser.wait_for("document.body.className === 'lost'")
    assert browser.find("#lost").is_displayed()
    assert "may be outdated" in browser.find("#lost").text
    assert browser.driver.title.startswith("no connection to the monitor")
    assert browser.run("return getComputedStyle(document.querySelector('.badge-text'), '::before').content") == '"was "'
    assert browser.run("return getComputedStyle(document.querySelector('.robot-head .badge')).color") != ok
    monitor = LineProcess([*command, url.rstrip("/").rsplit(":", 1)[1]])
    try:
        monitor.wait_for_text("web page: ")
        browser.wait_for("document.body.className === 'live' || (document.getElementById('retry').click(), false)")
        assert not browser.find("#lost").is_displayed()
    finally:
        monitor.signal(signal.SIGKILL)
        monitor.wait()


CONTRAST = """
const channel = (value) => (value /= 255) <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
const parse = (color) => color.match(/[\\d.]+/g).map(Number);
const luminance = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
const back = (element) => {
  for (let each = element; each; each = each.parentElement) {
    const color = parse(getComputedStyle(each).backgroundColor);
    if (color.length < 4 || color[3] === 1) return color;
  }
  return [255, 255, 255];
};
const bad = [];
for (const element of document.querySelectorAll("body *")) {
  const own = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
  if (!own || !element.getClientRects().length || element.closest("svg, :disabled, .hidden-text, option")) continue;
  const [one, other] = [luminance(parse(getComputedStyle(element).color)), luminance(back(element))];
  const contrast = (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05);
  if (contrast < 4.5) bad.push(`${element.outerHTML.slice(0, 80)} ${contrast.toFixed(2)}`);
}
return bad;
"""


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_every_text_has_the_contrast_of_wcag_aa(browser: Browser, served: Any, tmp_path: Path, dark: bool) -> None:
    site = served(
        "ok",
        "warn",
        "error",
        "stale",
        "waiting",
        signals={**SIGNALS, "late": {"warn_below": 1.0, "startup_grace_s": 60.0}},
        history_file=str(tmp_path / "history.db"),
    )
    site.observe(50.0, robot=3)
    site.pass_time(7.0)
    for robot, value in enumerate((50.0, 85.0, 99.0)):
        site.observe(value, "temperature", robot, after_s=0.0)
    browser.open(site.url, dark=dark)
    browser.wait_for("document.querySelectorAll('.robot').length === 5")
    browser.run("document.querySelectorAll('.robot-head').forEach((head) => head.click())")
    browser.run("document.querySelectorAll('.signal-name')[0].click()")
    browser.wait_for("document.querySelector('.plot svg')")
    browser.wait_for("!document.querySelector('.signal-body .note').textContent.includes('loading')")
    assert browser.run(CONTRAST) == []
    browser.run("document.querySelector('.signal-body > .buttons button').click()")
    assert browser.run(CONTRAST) == []
    browser.press(Keys.ESCAPE)
    browser.run("location.hash = 'alerts'")
    browser.wait_for("document.querySelector('#alerts .alert')")
    assert browser.run(CONTRAST) == []


def test_an_alert_is_on_the_page_within_two_seconds(browser: Browser, served: Any) -> None:
    """The best of five: on a loaded machine, single ones may take longer."""
    site = served("atlas", signals={"battery_level": {"warn_below": 20.0}})
    site.observe(50.0)
    browser.open(site.url)
    browser.wait_for("document.querySelector('.robot.ok')")
    browser.run(
        "window.changedAt = [];"
        "new MutationObserver(() => changedAt.push(Date.now() / 1000))"
        ".observe(document.querySelector('.robot'), {attributes: true, attributeFilter: ['class']});"
    )
    delays: list[float] = []
    for number in range(5):
        value = 50.0 if number % 2 else 10.0
        alerted_s: list[float] = []

        def alert(robots: Robots, value: float = value, times: list[float] = alerted_s) -> None:
            robots.at(robots.bus.now_s + 1.0)
            times.append(time.time())
            robots.observe(value)

        site.do(alert)
        browser.wait_for("changedAt.length > arguments[0]", number)
        delays.append(browser.run("return changedAt[arguments[0]]", number) - alerted_s[0])
    assert min(delays) < 2.0
