"""The section "After a restart" of docs/rules.md."""

from __future__ import annotations

import json
import math
from typing import Any, Mapping, Tuple

import pytest
from harness.kept_history import Robot
from harness.parameters import set_parameter
from harness.seeds import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.core import Level, Monitor, MonitorConfig, Sample, Transition, load_config
from robot_health_monitor.core.judge.saved_state import SavedSignal

BATTERY = {"warn_below": 20.0, "unit": "%"}


class TestAnOpenAlert:
    def test_that_still_holds_is_not_announced_again(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(3, battery=15.0)
        assert robot.announced() == ["battery WARN: 15 % is below 20 % (was unknown for 0 s)"]
        robot.restart(3600.0)
        robot.run_for(60, battery=15.0)
        assert robot.announced() == []
        assert robot.shown() == ("WARN", "15 % is below 20 %")

    def test_ends_with_the_first_sample_that_shows_it_and_its_time_goes_on(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(100, battery=15.0)
        robot.restart(212.0)
        assert robot.announced() == ["battery WARN: 15 % is below 20 % (was unknown for 0 s)"]
        robot.run_for(5)
        robot.run_for(1, battery=50.0)
        assert robot.announced() == ["battery OK: 50 % is no longer below 20 % (was WARN for 317 s)"]

    def test_keeps_its_hysteresis(self) -> None:
        robot = Robot(battery={**BATTERY, "hysteresis": 2.0})
        robot.run_for(1, battery=15.0)
        robot.restart()
        robot.run_for(3, battery=21.0)
        assert robot.shown() == ("WARN", "21 % was below 20 %, clears at 22 %")

    def test_that_gets_worse_continues_the_chain(self) -> None:
        robot = Robot(battery={**BATTERY, "error_below": 10.0})
        robot.run_for(1, battery=15.0)
        robot.announced()
        robot.restart(59.0)
        robot.run_for(1, battery=5.0)
        assert robot.announced() == ["battery ERROR: 5 % is below 10 % (was WARN for 60 s)"]

    def test_is_repeated_when_it_would_have_been_without_the_downtime(self) -> None:
        robot = Robot(battery={**BATTERY, "repeat_s": 60.0})
        robot.run_for(40, battery=15.0)
        robot.restart(1000.0)
        robot.announced()
        robot.run_for(19, battery=15.0)
        assert robot.announced() == []
        robot.run_for(3, battery=15.0)
        assert robot.announced() == ["battery WARN: 15 % is below 20 % (for 17 min 40 s)"]

    def test_for_invalid_data_is_resumed(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(1, battery=math.nan)
        assert len(robot.announced()) == 1
        robot.restart(10.0)
        assert robot.shown() == ("ERROR", "waiting for the first sample, last announced ERROR")
        robot.run_for(2, battery=math.nan)
        assert robot.announced() == []
        robot.run_for(1, battery=50.0)
        assert robot.announced() == ["battery OK: 50 % (was ERROR for 13 s)"]

    def test_of_a_mean_stays_until_the_mean_is_defined_again(self) -> None:
        robot = Robot(battery={**BATTERY, "statistic": "mean", "window_s": 20.0, "window_min_s": 10.0})
        robot.run_for(15, battery=10.0)
        assert len(robot.announced()) == 1
        robot.restart(5.0)
        robot.run_for(10, battery=90.0)
        assert robot.announced() == []
        robot.run_for(1, battery=90.0)
        assert robot.announced() == ["battery OK: mean 90 % is no longer below 20 % (was WARN for 20 s)"]


class TestAStatisticOfTheWindow:
    def test_a_forecast_is_undefined_until_its_window_is_full_again(self) -> None:
        robot = Robot(
            battery={**BATTERY, "statistic": "forecast", "window_s": 20.0, "forecast_s": 20.0, "stale_after_s": 60.0}
        )
        for second in range(40):
            robot.run_for(1, battery=70.0 - second)
        (line,) = robot.announced()
        assert line == "battery WARN: forecast 19 % in 20 s is below 20 % (was OK for 31 s)"
        robot.restart(300.0)
        robot.run_for(20, battery=90.0)  # charged meanwhile
        assert robot.announced() == []
        assert robot.shown() == ("WARN", "forecast is undefined until window_min_s (20 s) has passed")
        robot.run_for(1, battery=90.0)
        assert robot.announced() == ["battery OK: forecast 90 % in 20 s is no longer below 20 % (was WARN for 329 s)"]

    def test_a_restart_forecasts_nothing_from_the_values_before_it(self) -> None:
        robot = Robot(battery={**BATTERY, "statistic": "forecast", "window_s": 20.0, "forecast_s": 60.0})
        robot.run_for(100, battery=95.0)
        robot.restart(10.0)
        robot.run_for(100, battery=60.0)  # it fell by 35 % in 10 s
        assert robot.announced() == []

    def test_the_downtime_of_the_monitor_is_no_gap(self) -> None:
        robot = Robot(battery={"statistic": "largest_gap_s", "warn_above": 2.0, "window_min_s": 0.0})
        robot.run_for(10, battery=50.0)
        robot.restart(300.0)
        robot.run_for(1, battery=50.0)
        assert robot.shown() == ("OK", "largest_gap_s is undefined: too few samples")
        robot.run_for(10, battery=50.0)
        assert (robot.shown(), robot.announced()) == (("OK", "1 s"), [])


class TestDurations:
    def test_downtime_does_not_count_towards_for_s(self) -> None:
        robot = Robot(battery={**BATTERY, "for_s": 60.0})
        robot.run_for(50, battery=15.0)
        robot.restart(3600.0)
        robot.run_for(9, battery=15.0)
        assert robot.announced() == []
        robot.run_for(2, battery=15.0)
        assert [text[:13] for text in robot.announced()] == ["battery WARN:"]

    def test_the_wait_for_the_first_sample_does_not_count_either(self) -> None:
        robot = Robot(battery={**BATTERY, "for_s": 5.0, "startup_grace_s": 60.0, "latch": True})
        robot.run_for(3, battery=15.0)
        robot.restart()
        robot.run_for(30)
        robot.run_for(10, battery=50.0)  # it is no longer low: no alert, and no latch
        assert robot.announced() == []
        assert robot.shown() == ("OK", "50 %")

    def test_downtime_does_not_count_towards_keep_firing_for_s(self) -> None:
        robot = Robot(battery={**BATTERY, "keep_firing_for_s": 60.0})
        robot.run_for(1, battery=15.0)
        robot.run_for(30, battery=50.0)
        robot.restart(3600.0)
        robot.announced()
        robot.run_for(29, battery=50.0)
        assert robot.announced() == []
        robot.run_for(3, battery=50.0)
        assert [text[:11] for text in robot.announced()] == ["battery OK:"]

    def test_are_not_negative_when_the_wall_clock_went_back(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(10, battery=15.0)
        robot.kill()
        robot.history.wall_offset_s -= 1e8
        robot.start()
        robot.announced()
        robot.run_for(1, battery=50.0)
        assert robot.announced() == ["battery OK: 50 % is no longer below 20 % (was WARN for 0 s)"]


class TestLatches:
    LATCHING: Mapping[str, Any] = {**BATTERY, "error_below": 10.0, "latch": True}

    def test_are_restored(self) -> None:
        robot = Robot(battery=self.LATCHING)
        robot.run_for(1, battery=5.0)
        robot.run_for(5, battery=50.0)
        robot.announced()
        robot.restart(100.0)
        robot.run_for(5, battery=50.0)
        assert robot.announced() == []
        assert robot.shown() == ("ERROR", "50 % is no longer below 10 %, latched until reset")
        robot.stage.bus.call_service("/alert_system/reset")
        assert robot.announced() == ["battery OK: 50 % is no longer below 20 % (was ERROR for 111 s)"]

    def test_that_were_reset_stay_reset(self) -> None:
        robot = Robot(battery=self.LATCHING)
        robot.run_for(1, battery=5.0)
        robot.run_for(1, battery=50.0)
        robot.stage.bus.call_service("/alert_system/reset")
        robot.restart()
        robot.announced()
        robot.run_for(5, battery=50.0)
        assert robot.announced() == []
        assert robot.shown()[0] == "OK"

    def test_can_be_reset_before_the_first_sample(self) -> None:
        robot = Robot(battery=self.LATCHING)
        robot.run_for(1, battery=5.0)
        robot.run_for(1, battery=50.0)
        robot.restart()
        robot.announced()
        robot.stage.bus.call_service("/alert_system/reset")
        assert robot.announced() == []  # its level is not known yet
        robot.run_for(1, battery=50.0)
        assert robot.announced() == ["battery OK: 50 % is no longer below 20 % (was ERROR for 2 s)"]

    def test_can_be_reset_before_the_first_message_on_clock(self) -> None:
        robot = Robot(battery=self.LATCHING, use_sim_time=True)
        robot.stage.set_clock(100.0)
        robot.stage.publish("battery", 5.0)
        robot.stage.set_clock(101.0)
        robot.stage.publish("battery", 50.0)
        robot.stage.set_clock(103.0)
        robot.announced()
        robot.restart()
        assert robot.shown()[0] == "STALE"
        robot.stage.bus.call_service("/alert_system/reset")
        assert "battery" in robot.history.states
        robot.stage.set_clock(104.0)
        robot.stage.publish("battery", 50.0)
        assert [text[:11] for text in robot.announced()] == ["battery OK:"]

    def test_that_the_configuration_no_longer_has_end(self) -> None:
        robot = Robot(battery=self.LATCHING)
        robot.run_for(1, battery=5.0)
        robot.run_for(1, battery=50.0)
        robot.announced()
        robot.signals["battery"] = {**self.LATCHING, "latch": False}
        robot.restart()
        robot.run_for(1, battery=50.0)
        assert [text[:11] for text in robot.announced()] == ["battery OK:"]


class TestUnknownLevels:
    def test_before_the_first_sample_the_level_is_unknown(self) -> None:
        robot = Robot(battery=BATTERY, load={"warn_above": 80.0})
        robot.run_for(10, battery=15.0, load=1.0)
        robot.restart(10.0)
        assert robot.shown("load") == ("STALE", "waiting for the first sample")
        assert robot.shown() == ("STALE", "waiting for the first sample, last announced WARN")
        status = robot.system.monitor.report(23.0).statuses["load"]
        assert (status.values["state"], status.values["since"], status.values["lasts_s"]) == ("waiting", "20.000", "3")
        robot.run_for(1, load=1.0)
        assert robot.system.monitor.report(21.0).statuses["load"].values["since"] == "0.000"

    def test_a_signal_that_never_reports_again_becomes_stale(self) -> None:
        robot = Robot(battery={**BATTERY, "startup_grace_s": 30.0})
        robot.run_for(10, battery=50.0)
        robot.restart(100.0)
        robot.run_for(30)
        assert robot.announced() == []
        robot.run_for(1)
        assert robot.announced() == ["battery STALE: no sample since the start 31 s ago (limit 30 s) (was OK for 10 s)"]

    def test_a_signal_that_was_never_known_is_still_unknown(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(5)
        robot.restart(100.0)
        robot.run_for(11)
        assert robot.announced() == [
            "battery STALE: no sample since the start 11 s ago (limit 10 s) (was unknown for 116 s)"
        ]

    def test_neither_the_downtime_nor_the_wait_for_the_first_sample_counts_as_ok(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(3)
        robot.run_for(4, battery=50.0)  # until 7 s
        robot.restart(100.0)
        robot.run_for(2)
        robot.restart(100.0)
        robot.run_for(5)
        robot.run_for(1, battery=50.0)
        robot.run_for(1, battery=15.0)
        assert robot.announced() == ["battery WARN: 15 % is below 20 % (was OK for 5 s)"]

    def test_time_on_ok_before_a_broken_link_survives(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(4, battery=50.0)
        robot.system.observe_link(True)
        robot.system.observe_link(False, "refused")
        robot.run_for(50)
        robot.restart(100.0)
        robot.system.observe_link(True)
        robot.announced()
        robot.run_for(1, battery=15.0)
        assert "battery WARN: 15 % is below 20 % (was OK for 4 s)" in robot.announced()

    def test_a_stale_signal_stays_stale(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(1, battery=50.0)
        robot.run_for(10)
        assert [text[:14] for text in robot.announced()] == ["battery STALE:"]
        robot.restart(100.0)
        assert robot.shown() == ("STALE", "no sample since the start 0 s ago, last announced STALE")
        robot.run_for(60)
        assert robot.announced() == []
        robot.run_for(1, battery=50.0)
        assert robot.announced() == ["battery OK: 50 % (was STALE for 165 s)"]

    def test_a_stale_signal_stays_stale_while_its_settings_change(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(10)
        robot.run_for(10)
        robot.restart()
        robot.announced()
        set_parameter(robot.middleware, "signals.battery.startup_grace_s", 30.0)
        assert robot.shown() == ("STALE", "waiting for the first sample, last announced STALE")
        robot.run_for(60)
        assert robot.announced() == []

    def test_an_error_that_never_reports_again_stays_an_error(self) -> None:
        robot = Robot(battery={"error_below": 20.0})
        robot.run_for(1, battery=15.0)
        robot.announced()
        robot.restart(10.0)
        robot.run_for(30)
        assert robot.announced() == []
        assert robot.shown() == ("ERROR", "no sample since the start 30 s ago, last announced ERROR")


class TestTheLink:
    def test_that_is_still_down_is_not_announced_again(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(1, battery=50.0)
        robot.system.observe_link(False, "refused")
        assert robot.announced() == ["link ERROR: down: refused (was never up)"]
        robot.restart(100.0)
        assert robot.shown("link") == ("ERROR", "waiting for the first sample, last announced ERROR")
        robot.run_for(4)
        robot.system.observe_link(False, "no route")
        robot.run_for(60)
        assert robot.announced() == []
        assert robot.shown("link") == ("ERROR", "down: no route")
        robot.system.observe_link(True)
        robot.run_for(11, battery=50.0)
        assert robot.announced() == ["link OK: up (was ERROR for 174 s)"]

    def test_that_nothing_reports_any_more_is_no_longer_watched(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.system.observe_link(False, "refused")
        robot.restart()
        robot.announced()
        robot.run_for(60, battery=50.0)
        assert robot.announced() == []
        robot.run_for(2, battery=50.0)
        assert robot.announced() == ["link OK: no longer watched (was ERROR for 61 s)"]
        assert list(robot.history.states) == ["battery"]
        robot.restart()
        robot.run_for(100, battery=50.0)
        assert robot.announced() == []


class TestFlapping:
    FLAPPING: Mapping[str, Any] = {**BATTERY, "flap_detection": True}

    def test_a_signal_that_flapped_is_still_flapping(self) -> None:
        robot = Robot(battery=self.FLAPPING)
        for _ in range(20):
            robot.run_for(1, battery=15.0)
            robot.run_for(1, battery=50.0)
        assert "flapping" in robot.announced()[-1]
        robot.restart(10.0)
        for _ in range(20):
            robot.run_for(1, battery=15.0)
            robot.run_for(1, battery=50.0)
        assert robot.announced() == []


class TestConditionsOnOtherSignals:
    CONDITIONAL: Mapping[str, Any] = {**BATTERY, "only_if": {"signal": "current", "below": 0.0}}
    CURRENT: Mapping[str, Any] = {"warn_above": 100.0}

    def test_an_alert_that_was_held_back_stays_held_back(self) -> None:
        robot = Robot(battery=self.CONDITIONAL, current=self.CURRENT)
        robot.run_for(3, current=1.0, battery=15.0)
        robot.restart(10.0)
        robot.run_for(3, battery=15.0, current=1.0)
        assert robot.announced() == []
        assert robot.shown() == ("OK", "15 % is below 20 % (ignored: current is not below 0)")

    def test_an_open_alert_ends_when_its_condition_no_longer_holds(self) -> None:
        robot = Robot(battery=self.CONDITIONAL, current=self.CURRENT)
        robot.run_for(3, current=-1.0, battery=15.0)
        robot.restart(10.0)
        robot.announced()
        robot.run_for(3, battery=15.0, current=1.0)
        assert [text[:11] for text in robot.announced()] == ["battery OK:"]


class TestAChangedConfiguration:
    def test_new_bounds_apply_from_the_first_sample_on(self) -> None:
        robot = Robot(battery=BATTERY)
        robot.run_for(1, battery=15.0)
        robot.announced()
        robot.signals["battery"] = {"warn_below": 10.0}
        robot.restart()
        robot.run_for(1)
        assert robot.announced() == []
        robot.run_for(1, battery=15.0)
        assert robot.announced() == ["battery OK: 15 (was WARN for 2 s)"]

    def test_a_level_without_bounds_ends_with_the_first_sample(self) -> None:
        robot = Robot(battery={"error_below": 20.0})
        robot.run_for(1, battery=15.0)
        robot.announced()
        robot.signals["battery"] = {"warn_below": 20.0}
        robot.restart()
        assert robot.shown() == ("STALE", "waiting for the first sample, last announced ERROR")
        robot.run_for(1, battery=15.0)
        assert robot.announced() == ["battery WARN: 15 is below 20 (was ERROR for 1 s)"]

    def test_an_open_alert_of_a_signal_that_is_gone_ends_at_the_start(self) -> None:
        robot = Robot(battery=BATTERY, load={"warn_above": 80.0})
        robot.run_for(1, battery=15.0, load=1.0)
        robot.announced()
        del robot.signals["battery"]
        robot.restart(59.0)
        assert robot.announced() == ["battery OK: no longer watched (was WARN for 60 s)"]
        robot.restart()
        assert robot.announced() == []

    def test_a_closed_alert_of_a_signal_that_is_gone_is_nothing(self) -> None:
        robot = Robot(battery=BATTERY, load={"warn_above": 80.0})
        robot.run_for(1, battery=50.0, load=1.0)
        del robot.signals["battery"]
        robot.restart()
        assert robot.announced() == []


def test_under_simulated_time_the_state_is_restored_with_the_first_message_on_clock() -> None:
    robot = Robot(battery=BATTERY, load={"warn_above": 80.0}, use_sim_time=True)
    robot.stage.set_clock(5000.0)
    robot.stage.publish("battery", 15.0)
    robot.stage.publish("load", 90.0)
    assert len(robot.announced()) == 2
    del robot.signals["load"]
    robot.restart()
    robot.middleware.close()
    assert robot.announced() == []
    robot.start()
    robot.stage.set_clock(5001.0)
    robot.stage.publish("battery", 15.0)
    assert robot.announced() == ["load OK: no longer watched (was WARN for 0 s)"]
    assert robot.shown() == ("WARN", "15 % is below 20 %")


# --- a monitor that continues gives what one that was not interrupted gives -----------------------------------------

plain_values = st.one_of(st.integers(0, 100), st.sampled_from((5, 15, 19, 20, 21, 22, 50, 80, 81)))
plain_calls = st.one_of(
    st.tuples(st.just("observe"), st.sampled_from((0.0, 0.5, 1.0)), st.sampled_from(("a", "b")), plain_values),
    st.tuples(st.just("observe"), st.sampled_from((0.0, 0.5, 1.0)), st.just("a"), st.sampled_from((15, 50))),
    st.tuples(st.just("observe"), st.just(0.5), st.just("a"), st.just("broken")),
    st.tuples(st.just("observe"), st.just(0.5), st.just("link"), st.sampled_from((0, 1))),
    st.tuples(st.just("tick"), st.sampled_from((0.5, 1.0, 6.0, -3.0))),
    st.tuples(st.just("reset"), st.just(0.0)),
)
plain_trees = st.fixed_dictionaries(
    {"warn_below": st.just(20.0), "flap_low": st.sampled_from((0.0, 5.0))},
    optional={
        "error_below": st.just(10.0),
        "warn_above": st.just(80.0),
        "hysteresis": st.just(2.0),
        "for_s": st.sampled_from((0.0, 1.0, 3.0)),
        "keep_firing_for_s": st.sampled_from((0.0, 2.0)),
        "invalid_for_s": st.sampled_from((0.0, 1.0)),
        "latch": st.booleans(),
        "flap_detection": st.booleans(),
        "flap_high": st.sampled_from((10.0, 50.0)),
        "repeat_s": st.sampled_from((0.0, 3.0)),
        "stale_after_s": st.sampled_from((0.0, 2.0, 5.0)),
    },
)
Call = Tuple[Any, ...]


class Player:
    """Performs calls on a monitor and notes what it announces."""

    def __init__(self, monitor: Monitor, now_s: float) -> None:
        self.monitor = monitor
        self.now_s = now_s
        self.seen: list[tuple[Any, ...]] = []

    def play(self, call: Call) -> None:
        what, step_s, *arguments = call
        self.now_s += step_s
        transitions: list[Transition] = []
        if what == "observe":
            transitions = self.monitor.observe(Sample(arguments[0], arguments[1], self.now_s))
        elif what == "tick":
            transitions = self.monitor.tick(self.now_s)
        else:
            transitions = self.monitor.reset()
        self.seen.extend(
            (each.signal, each.from_level, each.to_level, each.value, each.bound, each.now_s, each.since_s, each.text)
            for each in transitions
        )


@pytest.mark.newest_python
@settings(max_examples=examples(75))
@given(
    st.lists(plain_trees, min_size=2, max_size=2),
    st.lists(plain_calls, max_size=30),
    st.tuples(plain_values, plain_values),
    st.lists(plain_calls, max_size=30),
)
def test_a_restart_without_downtime_changes_no_later_transition(
    trees: list[Mapping[str, Any]], before: list[Call], first: tuple[float, float], after: list[Call]
) -> None:
    config = load_config({"signals": {"a": trees[0], "b": trees[1]}})
    whole = Player(Monitor(config), 0.0)
    whole.play(("tick", 0.0))
    for call in before:
        whole.play(call)
    resumed = Player(restarted(whole.monitor, config, whole.now_s), whole.now_s)
    # Both know every signal: a restarted monitor has to wait for its first samples.
    bridge: list[Call] = [("observe", 0.0, "b", first[1]), ("observe", 0.0, "a", first[0])]
    if "link" in whole.monitor.signals():
        up = whole.monitor.status("link", whole.now_s).values["value"]  # type: ignore[union-attr]
        bridge.insert(0, ("observe", 0.0, "link", float(up)))
    del whole.seen[:]
    for call in [*bridge, *after]:
        whole.play(call)
        resumed.play(call)
    assert resumed.seen == whole.seen


def restarted(monitor: Monitor, config: MonitorConfig, now_s: float) -> Monitor:
    """Returns a new monitor that continues from the snapshots of `monitor`, which went through JSON."""
    wall_s = now_s + 2.0**20
    snapshots = {name: monitor.snapshot(name, now_s, wall_s) for name in monitor.signals()}
    found = Monitor(config)
    assert found.restore(json.loads(json.dumps(snapshots, allow_nan=False)), now_s, wall_s) == []
    return found


# --- hostile states -------------------------------------------------------------------------------------------------

json_values = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(),
        st.floats(),
        st.sampled_from((10**400, "OK", "FIRING", "x" * 20, "KEEPING", 1e308, -1e308)),
        st.text(max_size=5),
    ),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=5,
)


def full_state() -> dict[str, Any]:
    """A state with every key."""
    config = load_config({"signals": {"a": {"warn_below": 20.0, "error_below": 10.0, "for_s": 9.0, "latch": True}}})
    monitor = Monitor(config)
    for now_s, value in enumerate((15.0, 15.0, 5.0)):
        monitor.observe(Sample("a", value, now_s * 5.0))
    state: dict[str, Any] = json.loads(json.dumps(monitor.snapshot("a", 10.0, 10.0)))
    state["announced"].update(
        never_known=True,
        repeat_waited_s=1.0,
        flaps={"changes": 0b10101010101010101010, "last": "WARN", "flapping": True, "worst": "WARN"},
    )
    state["since"]["unknown"] = 9.0
    state["storm"] = [1e9 - 40.0, 1e9 - 1.0]  # the test restores at 1e9
    state.update(invalid={"crossed": True, "waited_s": 1.0}, stale=True, latched="WARN")
    return state


def places(state: Mapping[str, Any], path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Returns the paths of every value of a state."""
    found: list[tuple[str, ...]] = [()] if not path else []
    for key, value in state.items():
        found.append((*path, key))
        if isinstance(value, dict):
            found.extend(places(value, (*path, key)))
    return found


def replaced(state: Any, path: tuple[str, ...], value: Any) -> Any:
    if not path:
        return value
    return {**state, path[0]: replaced(state[path[0]], path[1:], value)}


@pytest.mark.parametrize("number", [0, 1, 61, 10_000])
@pytest.mark.parametrize("time_s", [-1e300, 0, 1e9 - 1.0, 1e300])
def test_a_storm_of_any_form_ends_within_a_minute(number: int, time_s: Any) -> None:
    state = {**full_state(), "storm": [time_s] * number, "latched": "OK"}
    state["announced"] = {"level": "OK"}
    monitor = Monitor(load_config({"signals": {"a": {"warn_below": 20.0, "stale_after_s": 0.0}}}))
    assert monitor.restore({"a": state}, 100.0, 1e9).notices == ()
    for now_s in range(100, 162):
        monitor.observe(Sample("a", 50.0, float(now_s)))
    (transition,) = monitor.observe(Sample("a", 15.0, 162.0))
    assert transition.text.startswith("a WARN: 15 is below 20 (was OK for ")


@pytest.mark.newest_python
@settings(max_examples=examples(75))
@given(
    st.sampled_from(places(full_state())), json_values, st.sampled_from(("a", "b", "link", "gone", "not a name\n", ""))
)
def test_no_state_raises_or_breaks_the_chain(path: tuple[str, ...], value: Any, name: str) -> None:
    trees = {"warn_below": 20.0, "error_below": 10.0, "for_s": 9.0, "latch": True, "flap_detection": True}
    monitor = Monitor(load_config({"signals": {"a": trees, "b": {"warn_above": 1.0, "repeat_s": 2.0}}}))
    changes = monitor.restore({name: replaced(full_state(), path, value)}, 100.0, 1e9)
    assert all(text.isprintable() for text in changes.notices)
    levels: dict[str, Level] = {}
    transitions = list(changes)
    for now_s in range(100, 130):
        monitor.report(float(now_s))
        json.dumps([monitor.snapshot(each, float(now_s), 1e9) for each in monitor.signals()], allow_nan=False)
        for signal in ("a", "b") if now_s > 110 else ("b",):
            transitions += monitor.observe(Sample(signal, now_s % 7 * 4.0, float(now_s)))
        transitions += monitor.tick(now_s + 0.5)
    transitions += monitor.reset()
    for each in transitions:
        assert each.from_level is levels.get(each.signal, each.from_level)
        assert (each.from_level is each.to_level) is each.repeat
        assert each.since_s <= each.now_s
        assert each.text.isprintable()
        levels[each.signal] = each.to_level


@pytest.mark.parametrize("value", [None, [], "x", 3])
def test_a_state_that_cannot_be_used_is_ignored_with_a_notice(value: Any) -> None:
    monitor = Monitor(load_config({"signals": {"a": {"warn_below": 20.0}, "b": {"warn_below": 20.0}}}))
    other = Monitor(monitor.config)
    other.observe(Sample("b", 15.0, 0.0))
    states: dict[str, SavedSignal] = {"a": value, "b": other.snapshot("b", 0.0, 0.0)}
    changes = monitor.restore(states, 0.0, 0.0)
    assert changes == []
    (notice,) = changes.notices
    assert notice.startswith("a: starts without its saved state: state: expected a mapping, got ")
    assert monitor.observe(Sample("b", 15.0, 0.0)) == []  # restored
    assert len(monitor.observe(Sample("a", 15.0, 0.0))) == 1


@pytest.mark.newest_python
def test_a_thousand_states_that_cannot_be_used_are_one_notice() -> None:
    monitor = Monitor(load_config({"signals": {"a": {"warn_below": 20.0}}}))
    changes = monitor.restore({f"s{number}": [] for number in range(1000)}, 0.0, 0.0)  # type: ignore[dict-item,misc]
    (notice,) = changes.notices
    assert notice.startswith("s0: starts without its saved state: ") and notice.endswith(" (and 999 other signals)")
