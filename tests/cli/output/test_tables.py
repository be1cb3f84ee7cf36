"""The tables at any size: a line per row, the worst first, nothing twice."""

from __future__ import annotations

import io
import re
from functools import lru_cache
from pathlib import Path
from typing import Any, Mapping, Sequence

import pytest

pytest.importorskip("rich", reason="rich, which draws the table, is not installed")

from rich.cells import cell_len
from rich.console import Console

from robot_health_monitor.cli.output.tables import (
    UNKNOWN_STATES,
    View,
    drawn,
    fleet_view,
    level_text,
    rank,
    rank_counts,
    robot_view,
)
from robot_health_monitor.core.config.signal_config import LINK, read_signal
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.announcements import Announcements
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.model import Level, Sample, Status

ROOT = Path(__file__).resolve().parents[3]


def status(level: Level, **facts: str) -> Status:
    return Status("battery", level, "", "atlas", {}, **facts)  # type: ignore[arg-type]


def test_the_order_is_ok_unknown_warn_stale_error() -> None:
    statuses = [
        status(Level.OK),
        status(Level.STALE, state="unreachable"),
        status(Level.WARN),
        status(Level.STALE),
        status(Level.ERROR),
    ]
    assert sorted(statuses, key=rank) == statuses
    assert rank(status(Level.STALE, state="waiting")) == rank(statuses[1])


def test_an_unknown_level_is_named_and_coloured_as_such() -> None:
    unknown = status(Level.STALE, state="waiting")
    assert level_text(unknown).plain == "waiting" and level_text(status(Level.STALE)).plain == "STALE"
    colours = [level_text(shown).spans[0].style for shown in (unknown, *(status(level) for level in Level))]
    assert len(set(colours)) == 5


def test_a_silenced_alert_says_so_and_a_healthy_signal_does_not() -> None:
    assert level_text(status(Level.WARN, silence="until 12:00, by ana")).plain == "WARN silenced"
    assert level_text(status(Level.OK, silence="until 12:00, by ana")).plain == "OK"


def test_levels_are_counted_the_worst_first() -> None:
    assert rank_counts([0, 6, 0, 1, 6]) == "2 ERROR, 1 unknown, 2 OK"


def test_the_page_uses_the_same_words() -> None:
    levels = (ROOT / "ops" / "web" / "page" / "levels.js").read_text(encoding="utf-8")
    labels = re.findall(r'\w+: "([^"]+)"', levels)
    assert sorted(labels) == sorted(["NO LINK", *(level.name for level in Level), *UNKNOWN_STATES])


CONFIGS = {
    "battery_level": read_signal("battery_level", {"unit": "%", "warn_below": 20.0, "error_below": 10.0}),
    "temperature": read_signal("temperature", {"warn_above": 80.0}),
    "soon": read_signal("soon", {"warn_below": 20.0}),
}


def row(name: str, level: int, message: str, **values: str) -> Status:
    return Status(name, Level(level), message, "atlas", values)


def table_of(view: View, width: int, height: int) -> list[str]:
    """Returns the lines of a table without its title and the blanks at their end."""
    console = Console(file=io.StringIO(), width=width, height=height, highlight=False)
    with console.capture() as written:
        console.print(drawn(view, console))
    return [line.rstrip() for line in written.get().splitlines()][1:]


def lines(rows: Sequence[Status], width: int = 80, height: int = 24) -> list[str]:
    return table_of(robot_view("atlas", rows, CONFIGS), width, height)


def test_a_row_has_level_value_and_bounds_and_no_value_twice() -> None:
    assert lines([row("battery_level", 0, "77 %"), row("temperature", 1, "93 degC is above 80 degC")], 100) == [
        "signal         level  value                     bounds                             mean  min  max",
        "battery_level  OK     77 %                      WARN below 20 %, ERROR below 10 %",
        "temperature    WARN   93 degC is above 80 degC  WARN above 80",
    ]


def test_columns_are_padded_and_shortened_to_their_width_in_cells() -> None:
    found = lines([row("電池電池電池電池電池電池", 0, "77 %"), row("ab", 2, "one two three four five six seven")], 42)[
        1:
    ]
    assert all("…" in line for line in found) and max(map(cell_len, found)) <= 42
    assert [re.split("  +", line)[1] for line in found] == ["OK", "ERROR"]


def test_the_reason_ends_with_the_hint_why_there_are_no_samples() -> None:
    status = Status("battery", Level.STALE, "no sample for 6 s", "atlas", {}, "no publisher on /battery")
    shown = lines([status])
    assert shown[1] == "battery  STALE  no sample for 6 s [no publisher on /battery]"


def test_a_forecast_says_when_it_reaches_a_bound_before_any_hint() -> None:
    status = Status(
        "soon", Level.OK, "forecast 26 % in 30 min", "atlas", {}, "a voltage", outlook="reaches 20 % in 45 min"
    )
    assert lines([status], 90)[1] == "soon    OK     forecast 26 % in 30 min, reaches 20 % in 45 min [a voltage]"


def test_a_rate_of_arrivals_has_no_statistics_of_its_values() -> None:
    values = {"mean": "1", "min": "1", "max": "1"}
    rows = [
        row("scan", 0, "9.9 Hz", statistic="frequency_hz", **values),
        row("gap", 0, "0.1 s", statistic="largest_gap_s", **values),
        row("load", 0, "1 %", statistic="mean", **values),
    ]
    assert [line.split()[2:] for line in lines(rows, 120)[1:]] == [
        ["9.9", "Hz"],
        ["0.1", "s"],
        ["1", "%", "1", "1", "1"],
    ]


def test_effects_are_counted_at_their_cause_and_take_no_line() -> None:
    cause = Status("/joint_states", Level.STALE, "no message for 6 s (limit 5 s): 2 signals", "atlas", {}, affects=2)
    effects = [Status(name, Level.STALE, "no sample", "atlas", {}, cause="/joint_states") for name in ("left", "right")]
    shown = lines([cause, *effects], 100)[1:]
    assert [" ".join(line.split()) for line in shown] == [
        "/joint_states STALE no message for 6 s (limit 5 s): 2 signals (+ 2 affected)"
    ]


def test_of_a_fleet_effects_are_no_signals_of_their_own() -> None:
    robots = Robots()
    robots.add("a", depends_on=("battery_level",)).measure(8.5, 93.0)
    assert rows(robots.lines(110, 20))[1:] == ["a ERROR battery_level 8.5 % is below 10 % (+ 1 affected)"]


def test_bounds_and_statistics_are_shown_where_there_is_room() -> None:
    rows = [row("battery_level", 0, "77 %", mean="76.5", min="75", max="78")]
    assert lines(rows, 80)[1] == "battery_level  OK     77 %   WARN below 20 %, ERROR below 10 %  76.5  75   78"
    assert lines(rows, 70)[1] == "battery_level  OK     77 %"


def test_without_a_signal_there_is_what_to_run() -> None:
    text = "no signal is watched: run `robot-health init`"
    assert lines([]) == lines([row(LINK, 0, "up")]) == [text]
    assert lines([row(LINK, 2, "down: refused")])[1] == "link    ERROR  down: refused"
    assert " ".join(map(str.strip, lines([], width=20))) == text


def test_a_link_that_is_up_takes_no_line() -> None:
    assert len(lines([row(LINK, 0, "up"), row("a", 0, "1")])) == 2
    assert lines([row(LINK, 2, "down: refused")])[1] == "link    ERROR  down: refused"


def test_only_the_word_of_the_level_is_coloured() -> None:
    view = robot_view("atlas", [row("a", 2, "5 is above 3")], {})
    console = Console(file=io.StringIO(), width=80, force_terminal=True, color_system="standard", no_color=False)
    with console.capture() as written:
        console.print(drawn(view, console))
    line = written.get().splitlines()[2]
    assert re.findall(r"\x1b\[1;31m(.*?)\x1b\[0m", line) == ["ERROR"] and line.count("\x1b") == 2


def test_signals_for_which_there_is_no_room_are_counted_and_the_worst_are_shown() -> None:
    rows = [row(f"s{number}", 0, "1") for number in range(9)] + [row("bad", 2, "5"), row("low", 1, "2")]
    assert lines(rows, height=7) == [
        "signal  level  value  bounds  mean  min  max",
        "s0      OK     1",
        "bad     ERROR  5",
        "low     WARN   2",
        "and 8 more: 8 OK",
    ]


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_a_row_is_one_line_and_none_is_too_wide(width: int) -> None:
    reason = "no sample since the start 11 s ago (limit 10 s)"
    found = lines([row("a_rather_long_name_of_a_signal", 3, reason), row("battery_level", 0, "77 %")], width)
    assert max(map(cell_len, found)) <= width
    assert [line.split()[1] for line in found] == ["level", "STALE", "OK"]
    assert found[1].endswith(reason if width > 80 else "…") or width > 80


REFUSED = "connection refused: no server listens on this port"
SIGNALS = {
    "battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0},
    "motor_temperature": {"unit": "degC", "warn_above": 80.0},
}


class Robot:
    """A robot with a battery and a motor."""

    def __init__(self, bus: LocalBus, name: str, silences: Mapping[str, str], depends_on: Sequence[str] = ()) -> None:
        self._bus = bus
        namespace = re.sub(r"\W", "_", name)
        motor = {**SIGNALS["motor_temperature"], "depends_on": list(depends_on)}
        parameters = {"robot_name": name, "signals": {**SIGNALS, "motor_temperature": motor}}
        node = bus.node("alert_system", namespace=f"r{namespace}", parameters=parameters)
        self.alert_system = AlertSystem(node, log_alerts=False, silence_of=lambda signal: silences.get(name))

    @property
    def now_s(self) -> float:
        return self._bus.now_s

    def measure(self, battery: float, motor: float) -> Robot:
        self.alert_system.observe_link(True)
        self.alert_system.observe(Sample("battery_level", battery, self.now_s))
        self.alert_system.observe(Sample("motor_temperature", motor, self.now_s))
        return self

    def lose(self, cause: str = REFUSED) -> Robot:
        self.alert_system.observe_link(False, cause)
        return self


class Robots:
    """What is shown."""

    def __init__(self) -> None:
        self._bus = LocalBus(on_log=lambda line: None)
        self.robots: list[Robot] = []
        self.silences: dict[str, str] = {}

    def add(self, name: str, **options: Any) -> Robot:
        self.robots.append(Robot(self._bus, name, self.silences, **options))
        return self.robots[-1]

    @property
    def alert_systems(self) -> list[AlertSystem]:
        return [robot.alert_system for robot in self.robots]

    def lines(self, width: int, height: int) -> list[str]:
        return table_of(self.view(height), width, height)

    def view(self, height: int = 24) -> View:
        return fleet_view(self, height)  # type: ignore[arg-type]  # a fleet in all that is shown


@pytest.fixture
def five() -> Robots:
    robots = Robots()
    robots.add("calm").measure(77.0, 40.0)
    robots.add("warm").measure(77.0, 93.0)
    robots.add("gone").lose()
    robots.add("silent")
    robots.add("empty").measure(8.5, 93.0)
    return robots


def rows(lines: list[str]) -> list[str]:
    """Returns robot, level and signal of the rows, without the times."""
    return [" ".join(re.sub(r"[A-Z][a-z]{2} \d\d \d\d:\d\d", "", line).split()) for line in lines]


def test_each_robot_has_a_row_with_its_worst_signal_the_worst_robot_first(five: Robots) -> None:
    assert rows(five.lines(110, 9)) == [
        "robot level since reason",
        f"gone ERROR link down: {REFUSED}",
        "empty ERROR battery_level 8.5 % is below 10 % (+ 1 more)",
        "warm WARN motor_temperature 93 degC is above 80 degC",
        "silent waiting no connection yet",
        "calm OK battery_level 77 %, motor_temperature 40 degC",
    ]


def test_nine_robots_fit_into_forty_lines() -> None:
    robots = Robots()
    for number in range(9):
        robots.add(f"husky{number}").measure(8.5 if number < 3 else 77.0, 40.0)
    lines = robots.lines(120, 40)
    assert len(lines) == 10
    assert rows(lines)[-1] == "husky8 OK battery_level 77 %, motor_temperature 40 degC"


def test_robots_for_which_there_is_no_room_are_counted_by_level(five: Robots) -> None:
    assert rows(five.lines(110, 6)) == [
        "robot level since reason",
        f"gone ERROR link down: {REFUSED}",
        "empty ERROR battery_level 8.5 % is below 10 % (+ 1 more)",
        "and 3 more: 1 WARN, 1 unknown, 1 OK",
    ]


@lru_cache(maxsize=None)
def several(count: int) -> Robots:
    """Returns robots that are shown in many sizes; showing them changes nothing."""
    robots = Robots()
    for number in range(count):
        name = f"warehouse-north-carter-with-a-long-name-{number}" if number % 3 else f"r{number}"
        robot = robots.add(name)
        robot.lose() if number % 2 else robot.measure(8.5, 93.0)
    return robots


@pytest.mark.parametrize("width", [60, 80, 100, 120, 200, 300])
@pytest.mark.parametrize("height", [3, 5, 10, 50])
@pytest.mark.parametrize("count", [2, 5, 200])
def test_it_fits(width: int, height: int, count: int) -> None:
    lines = several(count).lines(width, height)
    assert max(map(cell_len, lines)) <= width
    assert len(lines) <= max(height - 2, 3)  # one robot is always shown; the title and a line for alerts
    assert re.search("r0 +ERROR|…", " ".join(lines))


def test_the_title_names_the_worst_robot_and_counts_the_levels(five: Robots) -> None:
    assert five.view().title.plain == "5 robots, worst: gone ERROR   2 ERROR, 1 WARN, 1 unknown, 1 OK"
    calm = Robots()
    for name in ("a", "b"):
        calm.add(name).measure(77.0, 40.0)
    assert calm.view().title.plain == "2 robots   2 OK"


def test_silenced_alarms_are_marked_and_counted(five: Robots) -> None:
    five.silences["warm"] = "until 12:00, by ana"
    assert five.view().title.plain.endswith("   1 silenced")
    assert any(row.startswith("warm WARN silenced motor_temperature") for row in rows(five.lines(110, 20)))


def test_a_robot_without_any_news_is_waiting_and_not_ok() -> None:
    robots = Robots()
    robots.add("a")
    robots.add("b")
    assert rows(robots.lines(80, 10))[1:] == ["a waiting no connection yet", "b waiting no connection yet"]


def test_nothing_from_a_robot_controls_the_terminal() -> None:
    robots = Robots()
    robots.add("a").lose("down\x1b[2J\nnow \u202e")
    robots.add("b")
    for line in robots.lines(80, 10):
        assert line.isprintable()


def test_states_are_read_only_for_what_can_be_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    robots = Robots()
    for number in range(200):
        robots.add(f"r{number}").measure(77.0, 40.0)
    asked: list[Any] = []
    original = Announcements.status
    monkeypatch.setattr(Announcements, "status", lambda system, name: asked.append(name) or original(system, name))
    view = robots.view(24)
    assert view.title.plain == "200 robots   200 OK" and len(view.rows) == 24
    assert len(asked) <= 48
