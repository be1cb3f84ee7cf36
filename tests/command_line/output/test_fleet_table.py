"""The table of several robots at any size: the worst first, and the reason always in full."""

from __future__ import annotations

import re
from typing import Any, Dict, List, Mapping, Optional

import pytest

pytest.importorskip("rich", reason="rich, which draws the table, is not installed")

from rich.cells import cell_len

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.core.model import Sample
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.output.fleet_table import FleetState, fleet_lines, fleet_state, fleet_summary

REFUSED = "connection refused: no server listens on this port"
SIGNALS = {
    "battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0},
    "motor_temperature": {"unit": "degC", "warn_above": 80.0},
}


class Robot:
    """A robot with a battery and a motor."""

    def __init__(self, bus: LocalBus, name: str, silences: Mapping[str, str]) -> None:
        self._bus = bus
        namespace = re.sub(r"\W", "_", name)
        parameters = {"robot_name": name, "signals": SIGNALS}
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

    system_health: Optional[float] = None

    def __init__(self) -> None:
        self._bus = LocalBus(on_log=lambda line: None)
        self.robots: List[Robot] = []
        self.silences: Dict[str, str] = {}

    def add(self, name: str) -> Robot:
        self.robots.append(Robot(self._bus, name, self.silences))
        return self.robots[-1]

    def lines(self, width: int, height: int) -> List[str]:
        state = self.state(height)
        return [line.plain for line in fleet_lines(state, width, height, printable)]

    def state(self, height: int = 24) -> FleetState:
        return fleet_state(self, height)  # type: ignore[arg-type]  # its clock is a property of the bus


@pytest.fixture
def five() -> Robots:
    robots = Robots()
    robots.add("calm").measure(77.0, 40.0)
    robots.add("warm").measure(77.0, 93.0)
    robots.add("gone").lose()
    robots.add("silent")
    robots.add("empty").measure(8.5, 93.0)
    return robots


def rows(lines: List[str]) -> List[str]:
    """Returns robot, level and signal of the rows, without the times."""
    return [" ".join(re.sub(r"\d\d:\d\d(:\d\d)?", "", line).split()) for line in lines]


def test_each_robot_has_a_row_with_its_worst_signal_the_worst_robot_first(five: Robots) -> None:
    assert rows(five.lines(110, 7)) == [
        "robot level since signal reason",
        f"gone ERROR link down: {REFUSED}",
        "empty ERROR battery_level 8.5 % is below 10 %",
        "WARN motor_temperature 93 degC is above 80 degC",
        "warm WARN motor_temperature 93 degC is above 80 degC",
        "silent waiting no connection yet",
        "calm OK",
    ]


def test_robots_that_are_ok_take_one_line_however_much_room_there_is(five: Robots) -> None:
    assert five.lines(110, 40) == five.lines(110, 7)


def test_signals_for_which_there_is_no_room_are_counted() -> None:
    robots = Robots()
    robots.add("a").measure(8.5, 93.0)
    robots.add("b").measure(8.5, 93.0)
    assert rows(robots.lines(110, 4))[1:] == [
        "a ERROR battery_level 8.5 % is below 10 %",
        "b ERROR battery_level 8.5 % is below 10 %",
        "and 2 more signals not OK",
    ]
    assert len(robots.lines(110, 5)) == 5


def test_nine_robots_fit_into_forty_lines() -> None:
    robots = Robots()
    for number in range(9):
        robots.add(f"husky{number}").measure(8.5 if number < 3 else 77.0, 40.0)
    lines = robots.lines(120, 40)
    assert len(lines) == 10
    assert rows(lines)[-1] == "husky8 OK"


def test_robots_for_which_there_is_no_room_are_counted_by_level(five: Robots) -> None:
    assert rows(five.lines(110, 4)) == [
        "robot level since signal reason",
        f"gone ERROR link down: {REFUSED}",
        "empty ERROR battery_level 8.5 % is below 10 %",
        "and 3 more robots: 1 WARN, 1 unknown, 1 OK; 1 more signal not OK",
    ]


@pytest.mark.parametrize("width", [24, 30, 40, 50, 60, 80, 100, 120, 200, 300])
@pytest.mark.parametrize("height", [3, 5, 10, 50])
@pytest.mark.parametrize("count", [2, 5, 200])
def test_it_fits_and_never_cuts_a_reason(width: int, height: int, count: int) -> None:
    robots = Robots()
    for number in range(count):
        name = f"warehouse-north-carter-with-a-long-name-{number}" if number % 3 else f"r{number}"
        robot = robots.add(name)
        robot.lose() if number % 2 else robot.measure(8.5, 93.0)
    lines = robots.lines(width, height)
    assert max(map(cell_len, lines)) <= width
    assert len(lines) <= max(height, 8)  # one robot is always shown, with the whole reason
    text = " ".join(" ".join(lines).split())
    assert "8.5 % is below 10 %" in text
    if height > 10 or (count == 2 and height == 10):
        assert f"down: {REFUSED}" in re.sub(r"\s+", " ", text)


def test_the_title_names_the_worst_robot_and_counts_the_levels(five: Robots) -> None:
    assert (
        fleet_summary(five.state(), printable).plain == "5 robots, worst: gone ERROR   2 ERROR, 1 WARN, 1 unknown, 1 OK"
    )
    calm = Robots()
    for name in ("a", "b"):
        calm.add(name).measure(77.0, 40.0)
    assert fleet_summary(calm.state(), printable).plain == "2 robots   2 OK"


def test_silenced_alarms_are_marked_and_counted(five: Robots) -> None:
    five.silences["warm"] = "until 12:00, by ana"
    assert fleet_summary(five.state(), printable).plain.endswith("   1 silenced")
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
    asked: List[Any] = []
    original = AlertSystem.status
    monkeypatch.setattr(AlertSystem, "status", lambda system, name: asked.append(name) or original(system, name))
    state = robots.state(24)
    assert state.total == 200 and len(state.robots) == 24
    assert len(asked) <= 48
