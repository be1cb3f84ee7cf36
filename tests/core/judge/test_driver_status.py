"""A DiagnosticStatus as a whole: docs/rules.md, "A DiagnosticStatus as a whole"."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.values.elements import BadDatum, DriverStatus, Elements
from robot_health_monitor.core.values.errors import ConfigError

DRIVERS: dict[str, Any] = {
    "topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]', "stale_after_s": 0.0,
}  # fmt: skip
MOTOR = "motor_driver: left"


class Robot:
    """A monitor that watches the statuses of drivers."""

    def __init__(self, **keys: Any) -> None:
        self.monitor = Monitor(load_config({"signals": {"drivers": {**DRIVERS, **keys}, "charging": {}}}), "r1")
        self.monitor.tick(0.0)

    def report(self, now_s: float, level: Any, message: Any = "", name: str = MOTOR) -> list[str]:
        elements = Elements([(name, DriverStatus(level, message))])
        return [each.text for each in self.monitor.observe(Sample("drivers", elements, now_s))]

    def tick(self, now_s: float) -> list[str]:
        return [each.text for each in self.monitor.tick(now_s)]

    def shown(self, name: str = MOTOR) -> Any:
        status = self.monitor.report(0.0).statuses[f"drivers[{name}]"]
        return status.level.name, status.message, status.values["value"], status.state


class TestTheLevelOfADriver:
    def test_is_the_level_and_its_message_the_reason(self) -> None:
        robot = Robot()
        assert robot.report(0.0, 0, "running") == []
        assert robot.report(180.0, 2, "no returns") == [
            "drivers[motor_driver: left] ERROR: no returns (was OK for 180 s)"
        ]
        assert robot.shown() == ("ERROR", "no returns", "ERROR", "firing")
        assert robot.report(181.0, 1, "few returns") == [
            "drivers[motor_driver: left] WARN: few returns (was ERROR for 1 s)"
        ]
        assert robot.report(182.0, 0, "running") == ["drivers[motor_driver: left] OK: running (was WARN for 1 s)"]

    def test_may_be_a_byte(self) -> None:
        robot = Robot()
        assert robot.report(1.0, b"\x02", "hot") == ["drivers[motor_driver: left] ERROR: hot (was unknown for 1 s)"]

    def test_may_be_stale_which_is_not_silence(self) -> None:
        robot = Robot()
        robot.report(0.0, 0)
        assert robot.report(1.0, 3, "no data") == [
            "drivers[motor_driver: left] STALE: reported as stale: no data (was OK for 1 s)"
        ]
        assert robot.shown() == ("STALE", "reported as stale: no data", "STALE", "firing")
        assert robot.report(2.0, 3, "") == []
        assert robot.shown()[1] == "reported as stale"
        assert robot.report(3.0, 0, "") == ["drivers[motor_driver: left] OK: reported as ok (was STALE for 2 s)"]

    @pytest.mark.parametrize("message", ["OK", " Ok.", "ok!"])
    def test_is_not_repeated_by_a_message_that_only_names_it(self, message: str) -> None:
        robot = Robot()
        robot.report(0.0, 2, "hot")
        assert robot.report(1.0, 0, message) == ["drivers[motor_driver: left] OK: reported as ok (was ERROR for 1 s)"]
        assert robot.report(2.0, 1, message) != []
        assert robot.shown()[1] == message.strip()

    @pytest.mark.parametrize(
        ("level", "shown"),
        [(7, "7"), (-1, "-1"), (4, "4"), (b"\x07", "b'\\x07'"), (b"", "b''"), (None, "None"), ("2", "'2'"),
         (True, "True"), (float("nan"), "nan"), ([], "[]")],
    )  # fmt: skip
    def test_that_is_none_is_invalid_data(self, level: Any, shown: str) -> None:
        robot = Robot()
        assert robot.report(1.0, level, "fine") == [
            f"drivers[motor_driver: left] ERROR: invalid data: level {shown} (was unknown for 1 s)"
        ]

    def test_has_a_value_in_a_transition_but_no_bound(self) -> None:
        robot = Robot()
        elements = Elements([(MOTOR, DriverStatus(2, "hot"))])
        (transition,) = robot.monitor.observe(Sample("drivers", elements, 1.0))
        assert (transition.value, transition.bound, transition.statistic) == (2.0, None, "last")
        (transition,) = robot.monitor.observe(Sample("drivers", Elements([("b", DriverStatus(7, ""))]), 1.0))
        assert transition.value == 7

    def test_of_a_driver_that_falls_silent_is_stale_by_silence(self) -> None:
        robot = Robot(stale_after_s=5.0)
        robot.report(0.0, 1, "hot")
        assert robot.tick(6.0) == [
            "drivers[motor_driver: left] STALE: no sample for 6 s (limit 5 s) (was WARN for 6 s)"
        ]


class TestAMessage:
    def test_is_printable_and_on_one_line(self) -> None:
        robot = Robot()
        robot.report(0.0, 2, "no\n\x1b[31mreturns \u202e ")
        assert robot.shown()[1] == "no??[31mreturns ?"

    def test_is_at_most_200_characters_long(self) -> None:
        robot = Robot()
        robot.report(0.0, 2, "x" * 1_000_000)
        assert robot.shown()[1] == "x" * 197 + "..."

    @pytest.mark.parametrize("message", [None, 7, ["a"], {}, "", " \n "])
    def test_that_is_none_is_replaced_by_the_level(self, message: Any) -> None:
        robot = Robot()
        robot.report(0.0, 1, message)
        expected = "reported as warn" if message != " \n " else "?"
        assert robot.shown()[1] == expected

    def test_that_changes_is_no_transition(self) -> None:
        robot = Robot()
        robot.report(0.0, 1, "70 degrees")
        assert robot.report(1.0, 1, "71 degrees") == []
        assert robot.shown()[1] == "71 degrees"


class TestDurations:
    def test_for_s_holds_for_each_level(self) -> None:
        robot = Robot(for_s=3.0)
        robot.report(0.0, 0)
        assert robot.report(1.0, 1, "hot") == []
        assert robot.shown() == ("OK", "hot, pending for 0 s", "WARN", "pending")
        assert robot.report(3.0, 3, "gone") == []
        assert robot.tick(4.0) == ["drivers[motor_driver: left] WARN: reported as stale: gone (was OK for 4 s)"]
        assert robot.tick(6.0) == ["drivers[motor_driver: left] STALE: reported as stale: gone (was WARN for 2 s)"]

    def test_a_short_error_is_no_alert(self) -> None:
        robot = Robot(for_s=3.0)
        robot.report(0.0, 2, "no returns")
        robot.report(2.0, 0, "fine")
        assert robot.tick(10.0) == []

    def test_keep_firing_for_s_holds_for_each_level(self) -> None:
        robot = Robot(keep_firing_for_s=3.0)
        robot.report(0.0, 2, "no returns")
        assert robot.report(1.0, 0, "fine") == []
        assert robot.shown() == ("ERROR", "fine, still firing until keep_firing_for_s has passed", "OK", "keeps firing")
        assert robot.tick(4.0) == ["drivers[motor_driver: left] OK: fine (was ERROR for 4 s)"]

    @pytest.mark.parametrize(("level", "word"), [(1, "WARN"), (2, "ERROR"), (3, "STALE")])
    def test_a_latch_keeps_each_level(self, level: int, word: str) -> None:
        robot = Robot(latch=True)
        robot.report(0.0, level, "bad")
        assert robot.report(1.0, 0, "fine") == []
        assert robot.shown() == (word, "fine, latched until reset", "OK", "latched")
        assert [each.text for each in robot.monitor.reset()] == [f"drivers[{MOTOR}] OK: fine (was {word} for 1 s)"]

    def test_only_if_holds_it_back(self) -> None:
        robot = Robot(only_if={"signal": "charging", "is": 0.0})
        robot.monitor.observe(Sample("charging", 1.0, 0.0))
        assert robot.report(1.0, 2, "undervoltage") == []
        assert robot.shown()[:2] == ("OK", "undervoltage (ignored: charging is not 0)")
        assert [each.text for each in robot.monitor.observe(Sample("charging", 0.0, 5.0))] == [
            f"drivers[{MOTOR}] ERROR: undervoltage (was OK for 4 s)"
        ]

    @pytest.mark.parametrize("other", [1, 2, 3])
    def test_a_driver_that_changes_at_50_hertz_is_no_storm_of_alerts(self, other: int) -> None:
        robot = Robot()
        announced = sum(len(robot.report(n / 50.0, other if n % 2 else 0)) for n in range(50 * 120))
        assert announced == 61

    def test_flap_detection_withholds_a_stale_that_the_driver_reports(self) -> None:
        robot = Robot(flap_detection=True)
        announced = [text for n in range(60) for text in robot.report(float(n), 3 if n % 2 else 0)]
        assert len(announced) < 20
        assert "flapping" in announced[-1]


class TestARestart:
    def restarted(self, robot: Robot, **keys: Any) -> Robot:
        names = list(robot.monitor.signals())
        states = json.loads(json.dumps({name: robot.monitor.snapshot(name, 10.0, 1e9) for name in names}))
        after = Robot.__new__(Robot)
        after.monitor = Monitor(load_config({"signals": {"drivers": {**DRIVERS, **keys}, "charging": {}}}), "r1")
        assert after.monitor.restore(states, 0.0, 1e9 + 60.0) == []
        return after

    @pytest.mark.parametrize(("level", "word"), [(1, "WARN"), (2, "ERROR"), (3, "STALE")])
    def test_continues_an_open_alert(self, level: int, word: str) -> None:
        robot = Robot()
        robot.report(0.0, level, "bad")
        after = self.restarted(robot)
        assert after.report(0.0, level, "bad") == []
        assert after.report(5.0, 0, "fine") == [f"drivers[{MOTOR}] OK: fine (was {word} for 75 s)"]

    def test_keeps_a_latched_stale(self) -> None:
        robot = Robot(latch=True)
        robot.report(0.0, 3)
        robot.report(1.0, 0)
        after = self.restarted(robot, latch=True)
        assert after.report(0.0, 0, "fine") == []
        assert after.shown()[:2] == ("STALE", "fine, latched until reset")

    def test_continues_a_pending_rule(self) -> None:
        robot = Robot(for_s=15.0)
        robot.report(0.0, 2, "bad")
        after = self.restarted(robot, for_s=15.0)
        after.report(0.0, 2, "bad")
        assert after.tick(4.0) == []
        assert after.tick(5.0) == [f"drivers[{MOTOR}] ERROR: bad (was OK for 75 s)"]


class TestOneStatus:
    def test_is_watched_by_its_full_name(self) -> None:
        monitor = Monitor(load_config({"signals": {"motor": {**DRIVERS, "field": 'status["motor_driver: left"]'}}}))
        (transition,) = monitor.observe(Sample("motor", DriverStatus(2, "no returns"), 1.0))
        assert transition.text == "motor ERROR: no returns (was unknown for 0 s)"

    def test_and_numbers_may_take_turns(self) -> None:
        monitor = Monitor(load_config({"signals": {"x": {}}}))
        monitor.observe(Sample("x", DriverStatus(2, ""), 0.0))
        for value in (7.5, -1.0, 1e300, BadDatum("no"), None, DriverStatus(1, "")):
            monitor.observe(Sample("x", value, 1.0))
        assert monitor.report(1.0).statuses["x"].level is Level.WARN

    def test_that_becomes_a_number_by_a_new_configuration_is_one(self) -> None:
        monitor = Monitor(load_config({"signals": {"x": {}}}))
        monitor.observe(Sample("x", DriverStatus(2, ""), 0.0))
        changes = monitor.configure(load_config({"signals": {"x": {"topic": "other"}}}))
        assert [each.to_level for each in changes] == [Level.OK]
        assert monitor.observe(Sample("x", 3.0, 1.0)) == []


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        ({"warn_above": 0.0}, "warn_above"),
        ({"error_below": 1.0}, "error_below"),
        ({"statistic": "mean"}, "statistic"),
        ({"valid_max": 2.0}, "valid_max"),
        ({"scale": 2.0}, "scale"),
        ({"type": "", "warn_above": 0.0}, "warn_above"),
        ({"type": "diagnostic_msgs/msg/DiagnosticStatus", "field": '["*"]', "warn_above": 0.0}, "warn_above"),
    ],
)
def test_a_whole_status_has_no_bounds(keys: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=f"{key}: .* is a whole DiagnosticStatus, judged by its own level; remove"):
        load_config({"signals": {"drivers": {**DRIVERS, **keys}}})


@pytest.mark.parametrize(
    "keys",
    [
        {"field": 'status["*"].level', "warn_above": 0.0},
        {"field": 'status["*"]', "reduce": "max", "warn_above": 0.0},
        {"type": "sensor_msgs/JointState", "field": 'effort["*"]', "warn_above": 0.0},
    ],
)
def test_what_is_a_number_may_have_bounds(keys: dict[str, Any]) -> None:
    load_config({"signals": {"drivers": {**DRIVERS, **keys}}})
