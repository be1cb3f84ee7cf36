"""What a monitor stores, and when."""

from __future__ import annotations

import math
from typing import Any

import pytest
from harness.kept_history import Robot
from harness.parameters import set_parameter

from robot_health_monitor.core.judge.sample_summary import SampleSummary
from robot_health_monitor.core.values.model import Level, Sample

BATTERY = {"warn_below": 20.0}
OK, WARN, ERROR, STALE = Level


def saved_names(robot: Robot) -> list[str]:
    """Returns the signals that were saved since the last call, once per save."""
    names = [name for states in robot.history.saves for name in states]
    robot.history.saves.clear()
    return names


def test_a_transition_is_stored_before_the_outlets_receive_it(monkeypatch: Any) -> None:
    robot = Robot(battery=BATTERY)
    order: list[str] = []
    monkeypatch.setattr(robot.history, "record", lambda *_: order.append("history"))
    robot.system.outlets.add("seen", lambda event: order.append("outlet"))
    robot.run_for(1, battery=15.0)
    assert order == ["history", "outlet"]


def test_a_transition_is_stored_with_the_state_after_it() -> None:
    robot = Robot(battery={**BATTERY, "latch": True})
    robot.run_for(1, battery=15.0)
    state = robot.history.states["battery"]
    assert state["announced"]["level"] == "WARN"
    assert state["latched"] == "WARN"
    assert state["since"] == {"announced": 1e9, "level": 1e9}


def test_evidence_is_the_window_in_wall_time() -> None:
    robot = Robot(battery=BATTERY)
    robot.run_for(2, battery=50.0)
    robot.run_for(1, battery=15.0)
    assert robot.history.evidence == [[(1e9, 50.0), (1e9 + 1.0, 50.0), (1e9 + 2.0, 15.0)]]


def test_the_evidence_of_a_rate_is_the_rate_and_not_the_constant_1_of_arrivals() -> None:
    robot = Robot(scan={"statistic": "frequency_hz", "warn_below": 0.8, "window_s": 4.0, "window_min_s": 2.0})
    robot.run_for(10, scan=7.0)  # one arrival per second: 1 Hz
    robot.run_for(2)
    robot.run_for(1, scan=7.0)  # at 12 s: the arrivals of the window are at 8, 9 and 12 s, 2 intervals in 4 s
    (evidence,) = robot.history.evidence
    assert evidence[-1] == (1e9 + 12.0, 0.5)
    assert {value for _, value in evidence[:-1]} == {1.0}


def test_the_evidence_of_a_forecast_is_the_values_and_that_of_gaps_the_largest_gap() -> None:
    window = {"window_s": 20.0, "window_min_s": 20.0}
    robot = Robot(soon={"statistic": "forecast", "forecast_s": 20.0, "warn_below": 20.0, **window})
    for second in range(40):
        robot.run_for(1, soon=70.0 - second)  # 30 at 40 s: 20 s ahead is 10; below 20 from 31 s on
    (evidence,) = robot.history.evidence
    assert evidence == [(1e9 + second, 70.0 - second) for second in range(11, 32)]

    robot = Robot(scan={"statistic": "largest_gap_s", "warn_above": 2.0, "window_s": 10.0, "window_min_s": 0.0})
    robot.run_for(5, scan=7.0)
    robot.run_for(3)
    robot.run_for(1, scan=7.0)
    (evidence,) = robot.history.evidence
    assert evidence[-1] == (1e9 + 8.0, 4.0)
    assert {value for _, value in evidence[:-1]} == {1.0}


def test_evidence_is_at_most_300_samples() -> None:
    robot = Robot(battery={**BATTERY, "window_s": 1000.0})
    robot.run_for(400, battery=50.0)
    robot.run_for(1, battery=15.0)
    (evidence,) = robot.history.evidence
    assert 2 < len(evidence) <= 300
    assert (evidence[0], evidence[-1]) == ((1e9, 50.0), (1e9 + 400.0, 15.0))


def test_a_signal_that_stays_healthy_or_low_is_saved_once() -> None:
    robot = Robot(battery=BATTERY, load={"statistic": "mean", "warn_above": 80.0}, silent={"warn_above": 1.0})
    robot.run_for(100, battery=50.0, load=3.0)
    assert sorted(saved_names(robot)) == ["/silent", "battery", "load", "silent"]
    robot.run_for(100, battery=15.0, load=3.0)
    assert saved_names(robot) == []  # stored with the transition


def test_a_pending_duration_is_saved_every_second() -> None:
    robot = Robot(battery={**BATTERY, "for_s": 60.0})
    robot.run_for(3, battery=50.0)
    saved_names(robot)
    robot.run_for(5, battery=15.0)
    assert saved_names(robot) == ["battery"] * 5
    robot.run_for(5, battery=50.0)
    assert saved_names(robot) == ["battery"]  # inactive again


def test_times_are_saved_again_when_the_wall_clock_was_set() -> None:
    robot = Robot(battery=BATTERY)
    robot.run_for(10, battery=50.0)
    saved_names(robot)
    robot.history.wall_offset_s += 3600.0
    robot.run_for(10, battery=50.0)
    assert saved_names(robot) == ["battery"]
    assert robot.history.states["battery"]["since"]["announced"] == 1e9 + 3600.0


def test_what_a_reset_clears_is_stored_at_once() -> None:
    robot = Robot(battery={**BATTERY, "latch": True})
    robot.run_for(2, battery=15.0)
    robot.run_for(2, battery=50.0)
    robot.stage.bus.call_service("/alert_system/reset")
    assert robot.history.events[-1] == "reset"
    assert "latched" not in robot.history.states["battery"]


def test_closing_saves_the_state() -> None:
    robot = Robot(battery={**BATTERY, "for_s": 60.0})
    robot.run_for(3, battery=15.0)
    robot.stage.bus.run_until(3.25)
    robot.system.close()
    assert robot.history.states["battery"]["warn"]["waited_s"] == 3.25


def test_the_state_of_a_signal_that_left_the_configuration_is_deleted() -> None:
    robot = Robot(battery=BATTERY, load={"warn_above": 80.0})
    robot.run_for(2, battery=50.0, load=3.0)
    del robot.signals["load"]
    robot.restart()
    robot.run_for(2, battery=50.0)
    assert list(robot.history.states) == ["battery"]


def test_the_configuration_in_force_is_stored_at_the_start_and_when_it_changes() -> None:
    robot = Robot(battery=BATTERY)
    set_parameter(robot.middleware, "signals.battery.warn_below", 25.0)
    assert [stored["battery"]["warn_below"] for stored in robot.history.configurations] == [20.0, 25.0]


def test_a_robot_that_is_no_longer_watched_leaves_no_state() -> None:
    robot = Robot(battery={**BATTERY, "latch": True}, load={"warn_above": 80.0})
    robot.run_for(2, battery=15.0, load=3.0)
    robot.system.stop_watching()
    robot.system.close()
    assert robot.history.events[-1] == "battery OK: no longer watched (was WARN for 2 s)"
    assert robot.history.states == {}


class TestSamples:
    """Summaries per 10 s of wall time: start, least, most, mean, last, good, bad, worst level."""

    def test_they_are_stored_every_ten_seconds_of_the_wall_clock(self) -> None:
        robot = Robot(battery={"warn_below": 20.0, "stale_after_s": 60.0})
        robot.history.wall_offset_s = 1004.0
        robot.restart()
        for value in (50.0, 60.0, 40.0):
            robot.run_for(2, battery=value)
        robot.run_for(1)
        assert robot.history.samples == [{"battery": [SampleSummary(1000.0, 40.0, 60.0, 50.0, 40.0, 6, 0, OK)]}]
        robot.run_for(8)
        assert robot.history.samples[1:] == []
        robot.run_for(1)
        assert robot.history.samples[1:] == [{"battery": [SampleSummary(1010.0, None, None, None, None, 0, 0, OK)]}]

    def test_a_clean_stop_stores_the_rest(self) -> None:
        robot = Robot(battery={"warn_below": 20.0})
        robot.run_for(3, battery=15.0)
        robot.system.close()
        (stored,) = robot.history.samples
        assert stored["battery"] == [SampleSummary(1e9, 15.0, 15.0, 15.0, 15.0, 3, 0, WARN)]

    def test_bad_samples_are_counted_and_the_level_is_the_worst_also_between_ticks(self) -> None:
        robot = Robot(battery={"warn_below": 20.0, "error_below": 10.0, "valid_max": 100.0, "stale_after_s": 60.0})
        stage = robot.stage
        for at_s, value in ((0.2, 5.0), (0.4, 50.0), (0.6, 500.0), (0.8, 50.0)):
            stage.bus.run_until(at_s)
            stage.publish("battery", value)
        robot.run_for(10)
        assert robot.history.samples[0]["battery"] == [SampleSummary(1e9, 5.0, 50.0, 35.0, 50.0, 3, 1, ERROR)]

    def test_the_values_are_those_of_the_statistic_that_is_judged(self) -> None:
        robot = Robot(battery={"statistic": "max", "window_s": 60.0, "window_min_s": 0.0, "stale_after_s": 60.0})
        robot.run_for(2, battery=3.0)
        robot.run_for(2, battery=1.0)
        robot.run_for(7)
        assert robot.history.samples[0]["battery"] == [SampleSummary(1e9, 3.0, 3.0, 3.0, 3.0, 4, 0, OK)]

    def test_while_the_level_is_unknown_there_are_none(self) -> None:
        robot = Robot(battery={"startup_grace_s": 15.0, "stale_after_s": 15.0})
        robot.run_for(12)
        assert robot.history.samples == []
        robot.run_for(10)
        assert robot.history.samples == [{"battery": [SampleSummary(1e9 + 10.0, None, None, None, None, 0, 0, STALE)]}]
        robot.system.observe_link(False, "gone")
        robot.run_for(9)
        robot.history.samples.clear()
        robot.run_for(30)
        assert {name for samples in robot.history.samples for name in samples} == {"link"}

    def test_an_element_has_its_first_sample_and_one_that_leaves_the_configuration_its_last(self) -> None:
        robot = Robot(cells={"type": "sensor_msgs/BatteryState", "topic": "bms", "field": "cell_voltage[*]"})
        robot.run_for(1)
        robot.stage.outside.advertise("bms", "sensor_msgs/BatteryState")
        robot.stage.outside.publish("bms", {"cell_voltage": [3.5, 3.75]})
        robot.run_for(1)
        robot.middleware.set_parameters({"robot_name": "r1", "signals": {"other": {}}})
        (stored,) = robot.history.samples
        assert stored["cells[1]"] == [SampleSummary(1e9, 3.75, 3.75, 3.75, 3.75, 1, 0, OK)]
        assert stored["cells[0]"][0].last == 3.5

    def test_after_time_went_back_they_go_on_in_wall_time(self) -> None:
        robot = Robot(battery={"stale_after_s": 0.0})
        robot.run_for(1, battery=1.0)
        monitor = robot.system.monitor
        monitor.observe(Sample("battery", 2.0, 19.0))
        monitor.observe(Sample("battery", 3.0, 5.0))
        parts = monitor.take_samples(math.inf, 1e9)["battery"]
        assert [(each.start_s - 1e9, each.last) for each in parts] == [(0.0, 1.0), (10.0, 2.0), (10.0, 3.0)]

    @pytest.mark.parametrize("wall_per_s", [0.2, 3.0])
    def test_in_simulated_time_that_runs_faster_or_slower_they_belong_to_periods_of_the_wall_clock(
        self, wall_per_s: float
    ) -> None:
        robot = Robot(battery={"stale_after_s": 60.0})
        samples = round(40.0 / wall_per_s)  # in 40 s of the wall clock: 4 periods
        for _ in range(samples):
            robot.run_for(1, battery=1.0)
            robot.history.wall_offset_s += wall_per_s - 1.0
        robot.system.close()
        good = dict.fromkeys((0.0, 10.0, 20.0, 30.0), 0)
        for each in (each for stored in robot.history.samples for each in stored["battery"]):
            good[min(each.start_s - 1e9, 30.0)] += each.good
            assert each.start_s - 1e9 <= 40.0
        assert sum(good.values()) == samples
        assert all(abs(number - samples / 4) <= 1.0 + 1.0 / wall_per_s for number in good.values())

    def test_a_wall_clock_that_is_set_back_or_ahead_begins_other_periods(self) -> None:
        robot = Robot(battery={"stale_after_s": 60.0})
        for step_s in (3600.0, -7200.0, 0.0):
            robot.run_for(3, battery=1.0)
            robot.history.wall_offset_s += step_s
        robot.system.close()
        starts = [each.start_s - 1e9 for stored in robot.history.samples for each in stored["battery"]]
        assert starts == [0.0, 3600.0, -3600.0]

    def test_a_history_without_samples_collects_none(self) -> None:
        robot = Robot(battery={})
        robot.history.keeps_samples = False
        robot.restart()
        robot.run_for(25, battery=1.0)
        robot.system.close()
        assert robot.history.samples == []


def test_effects_are_stored_when_they_change() -> None:
    of_motor = {"topic": "/motor", "stale_after_s": 0.0}
    robot = Robot(
        motor={**of_motor, "error_above": 90.0}, wheel={"topic": "/wheel", "warn_below": 1.0, "depends_on": ["motor"]}
    )
    stored: list[Any] = []
    robot.history.record_effects = stored.append  # type: ignore[method-assign]
    robot.run_for(2, **{"/motor": 50.0, "/wheel": 5.0})
    robot.run_for(1, **{"/motor": 95.0, "/wheel": 5.0})
    assert stored == []
    robot.run_for(3, **{"/motor": 95.0, "/wheel": 0.0})
    assert stored == [{"motor": ["wheel"]}]
    robot.run_for(1, **{"/motor": 50.0, "/wheel": 0.0})
    assert stored[1:] == [{}]
