"""Silence: a topic that falls silent is one alert, and so are topics that fall silent together."""

from __future__ import annotations

from typing import Any, Mapping

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config

DRIVER = {
    "wheel_left": {
        "topic": "/joint_states",
        "field": 'effort["left"]',
    },
    "wheel_right": {"topic": "/joint_states", "field": 'effort["right"]'},
    "rate": {"topic": "/joint_states", "field": ""},
}
FOUR = {name: {"topic": f"/{name}"} for name in ("scan", "imu", "odom", "battery_state", "diagnostics")}


class Robot:
    """A monitor whose topics bring messages; times are in seconds."""

    def __init__(self, signals: Mapping[str, Mapping[str, Any]], start_s: float = 0.0) -> None:
        self.monitor = Monitor(load_config({"signals": signals}), "atlas")
        self.monitor.expect_sources()
        self.lines: list[str] = []
        self.now_s = start_s
        self.note(self.monitor.tick(start_s))

    def note(self, changes: Any) -> None:
        self.lines += map(str, changes)

    def message(self, topic: str, values: Mapping[str, object] | None = None) -> None:
        """Brings a message with samples of the given signals, none of the others; by default 1.0 of all."""
        self.note(self.monitor.observe_source(topic, self.now_s))
        on_topic = [name for name, each in self.monitor.config.signals.items() if each.topic == topic]
        for name, value in (dict.fromkeys(on_topic, 1.0) if values is None else values).items():
            self.note(self.monitor.observe(Sample(name, value, self.now_s)))

    def run(self, until_s: float, *topics: str) -> list[str]:
        """Lets time pass with a message and a tick per second; returns the lines since the last call."""
        while self.now_s < until_s:
            self.now_s += 1.0
            for topic in topics:
                self.message(topic)
            self.note(self.monitor.tick(self.now_s))
        lines, self.lines = self.lines, []
        return lines

    def shown(self) -> dict[str, str]:
        """Returns level and cause of what is not OK."""
        statuses = self.monitor.report(self.now_s).statuses.values()
        return {
            each.name: f"{each.level.name} {each.cause}".rstrip() for each in statuses if each.level is not Level.OK
        }


def test_a_driver_that_dies_is_one_alert_with_the_number_of_its_signals() -> None:
    robot = Robot(DRIVER)
    assert robot.run(100.0, "/joint_states") == []
    assert robot.run(110.0) == [
        "106.000 /joint_states STALE: no message for 6 s (limit 5 s): 3 signals (was OK for 1 min 45 s)".replace(
            "1 min 45 s", "105 s"
        )
    ]
    cause = "STALE /joint_states"
    assert robot.shown() == {"/joint_states": "STALE", "wheel_left": cause, "wheel_right": cause, "rate": cause}
    status = robot.monitor.report(110.0).statuses["/joint_states"]
    assert (status.affects, status.values["affects"], status.cause) == (3, "3", "")
    assert robot.run(120.0, "/joint_states") == [
        "111.000 /joint_states OK: messages again: 3 signals (was STALE for 5 s)"
    ]
    assert robot.shown() == {}


def test_the_alert_of_a_driver_counts_what_it_affects() -> None:
    robot = Robot(DRIVER)
    changes: list[Any] = []
    robot.note = changes.extend  # type: ignore[method-assign, assignment]
    robot.run(3.0, "/joint_states")
    robot.run(12.0)
    robot.run(13.0, "/joint_states")
    assert [(each.to_level.name, each.affects, each.cause) for each in changes] == [("STALE", 3, ""), ("OK", 0, "")]


def test_before_the_first_message_the_startup_grace_counts() -> None:
    robot = Robot(DRIVER)
    assert robot.run(30.0) == [
        "11.000 /joint_states STALE: no message since the start 11 s ago (limit 10 s): 3 signals (was unknown for 11 s)"
    ]


def test_a_topic_with_one_signal_is_announced_through_it() -> None:
    robot = Robot({"scan": {"topic": "/scan"}})
    robot.run(10.0, "/scan")
    assert robot.run(20.0) == ["16.000 scan STALE: no sample for 6 s (limit 5 s) (was OK for 15 s)"]
    assert robot.shown() == {"scan": "STALE"}
    assert robot.run(21.0, "/scan") == ["21.000 scan OK: 1 (was STALE for 5 s)"]


def test_topics_that_fall_silent_together_are_one_alert_under_the_name_of_the_first() -> None:
    robot = Robot(FOUR)
    robot.run(10.0, *(f"/{name}" for name in FOUR))
    assert robot.run(30.0) == [
        "16.000 /scan STALE: no message for 6 s (limit 5 s), nor on 4 other topics: /imu, /odom, /battery_state and "
        "/diagnostics (was OK for 15 s)"
    ]
    assert robot.shown()["imu"] == robot.shown()["/imu"] == "STALE /scan"
    assert robot.monitor.report(30.0).statuses["/scan"].affects == 5


def test_of_many_topics_three_are_named() -> None:
    robot = Robot({f"s{number}": {"topic": f"/t{number}"} for number in range(13)})
    (line,) = robot.run(11.0)
    assert "nor on 12 other topics: /t1, /t2, /t3 and 9 more (was" in line


def test_the_alert_ends_with_the_topic_that_gave_it_its_name_and_the_others_count_anew() -> None:
    robot = Robot(FOUR)
    robot.run(10.0, *(f"/{name}" for name in FOUR))
    robot.run(20.0)
    assert robot.run(30.0, "/scan", "/odom") == [
        "21.000 /scan OK: messages again (was STALE for 5 s)",
        "27.000 /imu STALE: no message for 17 s (limit 5 s), nor on 2 other topics: /battery_state and /diagnostics "
        "(was OK for 26 s)",
    ]
    assert robot.run(40.0, "/scan", "/odom", "/imu") == [
        "31.000 /imu OK: messages again (was STALE for 4 s)",
        "37.000 /battery_state STALE: no message for 27 s (limit 5 s), nor on 1 other topic: /diagnostics "
        "(was OK for 36 s)",
    ]
    assert robot.run(50.0, "/scan", "/odom", "/imu", "/battery_state") == [
        "41.000 /battery_state OK: messages again (was STALE for 4 s)",
        "47.000 diagnostics STALE: no sample for 37 s (limit 5 s) (was OK for 46 s)",
    ]


def test_one_that_is_due_later_joins_the_alert_of_one_that_fell_silent_at_the_same_time() -> None:
    robot = Robot({"scan": {"topic": "/scan"}, "slow": {"topic": "/slow", "stale_after_s": 20.0}})
    robot.run(10.0, "/scan", "/slow")
    assert robot.run(60.0) == ["16.000 scan STALE: no sample for 6 s (limit 5 s) (was OK for 15 s)"]
    assert robot.shown() == {"scan": "STALE", "slow": "STALE scan", "/slow": "STALE scan"}


def test_one_that_fell_silent_at_another_time_is_an_alert_of_its_own() -> None:
    robot = Robot({"scan": {"topic": "/scan"}, "imu": {"topic": "/imu"}})
    robot.run(10.0, "/scan", "/imu")
    robot.run(13.0, "/imu")
    assert [line.partition(" STALE")[0] for line in robot.run(30.0)] == ["16.000 scan", "19.000 imu"]


def test_a_dead_joint_behind_a_dead_driver_is_not_hidden() -> None:
    robot = Robot(DRIVER)
    robot.run(10.0, "/joint_states")
    robot.run(20.0)
    lines: list[str] = []
    for _ in range(10):
        robot.now_s += 1.0
        robot.message("/joint_states", {"wheel_left": 1.0, "rate": 1.0})
        lines += robot.run(robot.now_s)
        robot.note(robot.monitor.tick(robot.now_s))
    assert lines + robot.lines == [
        "21.000 /joint_states OK: messages again: 3 signals (was STALE for 5 s)",
        "27.000 wheel_right STALE: no sample for 17 s (limit 5 s) (was OK for 26 s)",
    ]


def test_an_element_that_was_missing_before_stays_announced() -> None:
    robot = Robot(DRIVER)
    robot.run(10.0, "/joint_states")
    for _ in range(10):
        robot.now_s += 1.0
        robot.message("/joint_states", {"wheel_left": 1.0, "rate": 1.0})
        robot.note(robot.monitor.tick(robot.now_s))
    assert robot.run(30.0) == [
        "16.000 wheel_right STALE: no sample for 6 s (limit 5 s) (was OK for 15 s)",
        "26.000 /joint_states STALE: no message for 6 s (limit 5 s): 3 signals (was OK for 25 s)",
    ]
    assert robot.run(31.0, "/joint_states") == [
        "31.000 /joint_states OK: messages again: 3 signals (was STALE for 5 s)",
        "31.000 wheel_right OK: 1 (was STALE for 15 s)",
    ]


def test_a_bad_sample_and_a_message_without_the_element_are_signs_of_life() -> None:
    robot = Robot({**DRIVER, "rate": {"topic": "/joint_states", "field": "", "stale_after_s": 0.0}})
    robot.run(10.0, "/joint_states")
    for _ in range(4):
        robot.now_s += 1.0
        robot.message("/joint_states", {"wheel_left": "nan?"})
        robot.note(robot.monitor.tick(robot.now_s))
    for _ in range(6):
        robot.now_s += 1.0
        robot.message("/joint_states", {})
        robot.note(robot.monitor.tick(robot.now_s))
    assert not any(line.partition(" ")[2].startswith("/joint_states") for line in robot.run(20.0))


def test_an_error_that_fires_stays_and_what_gets_better_is_announced() -> None:
    robot = Robot({"left": {"topic": "/a", "error_above": 5.0}, "right": {"topic": "/a"}})
    robot.message("/a", {"left": 9.0, "right": 1.0})
    assert robot.run(20.0) == [
        "0.000 left ERROR: 9 is above 5 (was unknown for 0 s)",
        "6.000 /a STALE: no message for 6 s (limit 5 s): 2 signals (was OK for 6 s)",
    ]
    robot.message("/a")
    assert robot.run(20.0) == [
        "20.000 /a OK: messages again: 2 signals (was STALE for 14 s)",
        "20.000 left OK: 1 is no longer above 5 (was ERROR for 20 s)",
    ]


def test_a_rule_that_fires_after_a_silence_is_announced_with_its_own_sample() -> None:
    robot = Robot({"left": {"topic": "/a", "warn_above": 5.0, "stale_after_s": 30.0}, "right": {"topic": "/a"}})
    robot.run(10.0, "/a")
    robot.run(20.0)
    robot.message("/a", {"right": 1.0})
    robot.now_s = 21.0
    robot.message("/a", {"left": 7.0})
    assert robot.run(21.0)[-1] == "21.000 left WARN: 7 is above 5 (was OK for 20 s)"


def test_two_limits_on_one_topic() -> None:
    robot = Robot({"fast": {"topic": "/a"}, "slow": {"topic": "/a", "stale_after_s": 30.0}})
    robot.run(10.0, "/a")
    assert [line.partition(" STALE")[0] for line in robot.run(20.0)] == ["16.000 /a"]
    assert robot.shown() == {"/a": "STALE", "fast": "STALE /a"}
    robot.run(41.0)
    assert robot.shown()["slow"] == "STALE /a"


def test_a_topic_whose_signals_are_never_stale_is_never_silent() -> None:
    robot = Robot({name: {"topic": "/a", "stale_after_s": 0.0} for name in ("one", "two")})
    assert robot.run(1000.0) == []


def test_without_sources_signals_behave_as_before() -> None:
    monitor = Monitor(load_config({"signals": DRIVER}))
    monitor.tick(0.0)
    assert [each.signal for each in monitor.tick(11.0)] == list(DRIVER)


def test_a_message_on_a_topic_that_is_no_source_changes_nothing() -> None:
    monitor = Monitor(load_config({"signals": DRIVER}))
    monitor.tick(0.0)
    assert monitor.observe_source("/joint_states", 10.0) == []
    assert [each.signal for each in monitor.tick(11.0)] == list(DRIVER)


class TestLink:
    def test_after_a_long_downtime_the_startup_grace_counts_again(self) -> None:
        robot = Robot({name: {**signal, "startup_grace_s": 60.0} for name, signal in DRIVER.items()})
        robot.run(10.0, "/joint_states")
        robot.now_s = 12.0
        robot.note(robot.monitor.set_link(False, "connection refused", 12.0))
        robot.now_s = 32.0
        robot.note(robot.monitor.set_link(True, "", 32.0))
        lines = [line for line in robot.run(100.0) if line.split()[1] != "link"]
        assert lines == [
            "93.000 /joint_states STALE: no message for 83 s, 20 s of them without link (limit 60 s): 3 signals "
            "(was OK for 72 s)"
        ]

    def test_a_short_downtime_is_left_out_and_said(self) -> None:
        robot = Robot({"scan": {"topic": "/scan"}})
        robot.run(10.0, "/scan")
        robot.note(robot.monitor.set_link(False, "connection refused", 10.0))
        robot.now_s = 18.0
        robot.note(robot.monitor.set_link(True, "", 18.0))
        lines = [line for line in robot.run(40.0) if line.split()[1] != "link"]
        assert lines == [
            "24.000 scan STALE: no sample for 14 s, 8 s of them without link (limit 5 s) (was OK for 15 s)"
        ]


def test_a_report_reads_only() -> None:
    one, other = Robot(DRIVER), Robot(DRIVER)
    for robot in (one, other):
        robot.run(10.0, "/joint_states")
    for now_s in range(11, 30):
        one.shown()
        assert one.run(float(now_s)) == other.run(float(now_s))


@pytest.mark.parametrize("removed", ["rate", "wheel_left"])
def test_a_source_that_is_no_longer_watched_ends(removed: str) -> None:
    robot = Robot({"scan": {"topic": "/scan"}, **DRIVER})
    robot.run(10.0, "/scan", "/joint_states")
    robot.run(20.0, "/scan")
    signals: dict[str, Any] = {"scan": {"topic": "/scan"}}
    changes = robot.monitor.configure(load_config({"signals": signals}))
    assert [each.text for each in changes] == ["/joint_states OK: no longer watched (was STALE for 4 s)"]
    assert robot.shown() == {}


def restarted(robot: Robot, after_s: float = 0.0) -> Robot:
    """Returns the robot watched by a new monitor that continues from the states, as after kill -9."""
    monitor, wall_s = robot.monitor, 1e9
    states = {name: monitor.snapshot(name, robot.now_s, wall_s) for name in monitor.saved_signals()}
    other = Robot.__new__(Robot)
    other.monitor, other.lines, other.now_s = Monitor(monitor.config, "atlas"), [], 5000.0
    other.monitor.expect_sources()
    changes = other.monitor.restore(states, 5000.0, wall_s + after_s, wall_s)
    assert changes.notices == ()
    other.note(changes)
    return other


class TestRestart:
    def test_within_a_silence_announces_nothing_again_and_ends_it_once(self) -> None:
        robot = Robot(FOUR)
        robot.run(10.0, *(f"/{name}" for name in FOUR))
        robot.run(20.0)
        again = restarted(robot, after_s=30.0)
        assert again.run(5060.0) == []
        assert again.shown()["imu"] == again.shown()["/imu"] == "STALE /scan"
        assert again.run(5061.0, *(f"/{name}" for name in FOUR)) == [
            "5061.000 /scan OK: messages again (was STALE for 95 s)"
        ]
        assert again.shown() == {}

    def test_one_that_is_not_heard_again_is_announced_when_the_others_are(self) -> None:
        robot = Robot({name: FOUR[name] for name in ("scan", "imu")})
        robot.run(10.0, "/scan", "/imu")
        robot.run(20.0)
        lines = restarted(robot).run(5020.0, "/scan")
        assert [line.partition(":")[0] for line in lines] == ["5001.000 /scan OK", "5012.000 imu STALE"]

    def test_while_signals_wait_for_their_own_samples_hides_none_that_is_dead(self) -> None:
        robot = Robot(DRIVER)
        robot.run(10.0, "/joint_states")
        robot.run(20.0)
        robot.message("/joint_states", {"wheel_left": 1.0, "rate": 1.0})
        robot.run(21.0)
        again = restarted(robot)
        for _ in range(12):
            again.now_s += 1.0
            again.message("/joint_states", {"wheel_left": 1.0, "rate": 1.0})
            again.note(again.monitor.tick(again.now_s))
        (line,) = again.run(again.now_s)
        assert line.startswith("5011.000 wheel_right STALE: no sample since the start 11 s ago (limit 10 s) (was OK")

    def test_of_a_topic_that_is_no_longer_watched_ends_its_alert(self) -> None:
        robot = Robot(DRIVER)
        robot.run(30.0)
        states = {name: robot.monitor.snapshot(name, 30.0, 1e9) for name in robot.monitor.saved_signals()}
        monitor = Monitor(load_config({"signals": {"scan": {"topic": "/scan"}}}))
        monitor.expect_sources()
        changes = monitor.restore(states, 0.0, 1e9)
        assert [each.text for each in changes] == ["/joint_states OK: no longer watched (was STALE for 19 s)"]

    @pytest.mark.parametrize("silence", [1, {"head": 1}, {"speaks": "yes"}])
    def test_a_state_that_cannot_be_used_is_ignored(self, silence: object) -> None:
        monitor = Monitor(load_config({"signals": DRIVER}))
        monitor.expect_sources()
        changes = monitor.restore({"/joint_states": {"silence": silence}}, 0.0, 1e9)
        assert len(changes.notices) == 1 and changes.notices[0].startswith("/joint_states: starts without its saved")
        assert [each.signal for each in monitor.tick(11.0)] == ["/joint_states"]
