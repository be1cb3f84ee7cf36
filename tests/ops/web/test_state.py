"""The state of one robot, and of the monitor itself, as JSON; test_interface.py has the common case."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from harness.web import Robots

from robot_health_monitor.core.values.elements import Elements
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.web.state import MOST_SAMPLES, NO_PLOT, OwnState, RobotReader, plot_of


def reader(robots: Robots) -> RobotReader:
    return RobotReader(robots.all[0], OwnState(lambda: robots.all, dict), robots.wall_s)


def test_a_signal_without_a_sample_is_unknown() -> None:
    robots = Robots()
    robots.at(101.0)
    robot = reader(robots).state(window=True)
    assert (robot["level"], robot["signal"], robot["message"]) == (
        "STALE",
        "battery_level",
        "waiting for the first sample",
    )
    signal = robot["signals"]["battery_level"]
    assert (signal["state"], signal["value"], signal["text"], signal["window"]) == ("waiting", None, "", [])
    assert signal["hint"] == ""


def test_a_signal_whose_topic_nobody_publishes_has_a_hint() -> None:
    robots = Robots()
    robots.at(101.0)
    robots.bus.run_until(108.0)
    signal = reader(robots).state(window=False)["signals"]["battery_level"]
    assert signal["hint"].startswith("no publisher on /robot")


def test_a_questionable_forecast_has_a_hint() -> None:
    robots = Robots(signals={"cell_soon": {"statistic": "forecast", "forecast_s": 600.0, "unit": "V"}})
    robots.observe(3.9, "cell_soon")
    signal = reader(robots).state(window=False)["signals"]["cell_soon"]
    assert signal["hint"] == "a forecast of a voltage is questionable; prefer the charge in %"


def test_a_link_that_is_down_is_the_cause_and_the_others_are_unreachable() -> None:
    robots = Robots()
    robots.observe(19.0)
    robots.all[0].observe_link(True)
    assert reader(robots).state(window=False)["link"] == "up"
    robots.at(101.0)
    robots.all[0].observe_link(False, "connection refused")
    robot = reader(robots).state(window=False)
    assert (robot["level"], robot["link"], robot["signal"]) == ("ERROR", "down", "link")
    assert robot["message"] == "down: connection refused"
    signal = robot["signals"]["battery_level"]
    assert (signal["level"], signal["state"], signal["value"]) == ("STALE", "unreachable", 19.0)


def test_a_wall_clock_that_is_set_makes_no_level_older() -> None:
    robots = Robots()
    robots.observe(19.0)
    state = reader(robots)
    assert state.state(window=False)["since"] == "2026-11-22T05:06:40.000Z"
    robots.at(105.0)
    robots.wall_offset_s += 3600.0  # at 05:06:45, set to 06:06:45
    assert state.state(window=False)["since"] == "2026-11-22T06:06:40.000Z"
    assert state.state(window=False)["signals"]["battery_level"]["since"] == "2026-11-22T06:06:40.000Z"


def test_bounds_apply_to_the_statistic() -> None:
    robots = Robots(
        signals={"odom": {"statistic": "frequency_hz", "field": "", "warn_below": 8.0, "window_min_s": 0.0}}
    )
    for number in range(5):
        robots.at(100.0 + number)
        robots.observe(1.0, "odom")
    signal = reader(robots).state(window=False)["signals"]["odom"]
    assert (signal["statistic"], signal["judged"], signal["judged_unit"]) == ("frequency_hz", 1.0, "Hz")
    assert signal["message"] == "rate 1 Hz is below 8 Hz"


def test_a_forecast_has_its_horizon_trend_and_time_to_the_bound() -> None:
    """80 % and half a percent less per second: 70 % at 20 s, 20 % at 120 s, which are 100 s later."""
    soon = {"statistic": "forecast", "window_s": 20.0, "forecast_s": 60.0, "unit": "%", "warn_below": 20.0}
    robots = Robots(signals={"battery_soon": soon})
    state = reader(robots)
    robots.observe(80.0, "battery_soon")
    signal = state.state(window=False)["signals"]["battery_soon"]
    keys = ("value", "judged", "forecast", "forecast_s", "trend_per_min", "time_to_bound_s")
    assert [signal[key] for key in keys] == [80.0, None, None, None, None, None]
    for second in range(1, 21):
        robots.at(100.0 + second)
        robots.observe(80.0 - 0.5 * second, "battery_soon")
    signal = state.state(window=False)["signals"]["battery_soon"]
    assert [signal[key] for key in keys] == [70.0] + [pytest.approx(each) for each in (40.0, 40.0, 60.0, -30.0, 100.0)]
    assert (signal["text"], signal["outlook"]) == ("forecast 40 % in 60 s", "reaches 20 % in 100 s")


def test_elements_have_samples_and_those_that_ended_their_unit_and_bounds() -> None:
    cells = {"field": "cell_voltage[*]", "unit": "V", "warn_below": 3.2, "forget_after_s": 6.0}
    robots = Robots(signals={"cells": cells})
    state = reader(robots)
    robots.observe(Elements([("0", 3.9), ("7", 3.1)]), "cells")
    assert [value for _, value in state.samples().event["signals"]["cells[7]"]] == [3.1]
    assert set(state.state(window=False)["signals"]) == {"cells", "cells[0]", "cells[7]"}
    for second in range(1, 8):
        robots.at(100.0 + second)
        robots.observe(Elements([("0", 3.9)]), "cells")
    assert set(state.samples().event["signals"]) == {"cells", "cells[0]"}
    bounds = [{"level": "WARN", "side": "below", "value": 3.2, "clears": 3.2}]
    assert plot_of(robots.all[0], "cells[7]") == {"unit": "V", "bounds": bounds, "forecast_s": None}
    assert plot_of(robots.all[0], "others[7]") == NO_PLOT


def test_bounds_are_numbers_that_json_has() -> None:
    robots = Robots(signals={"x": {"warn_below": 1e308, "hysteresis": 1.7e308}})
    bounds = reader(robots).state(window=False)["signals"]["x"]["bounds"]
    assert [bound["clears"] for bound in bounds] == [sys.float_info.max]


def test_a_silence_is_shown(tmp_path: Path) -> None:
    robots = Robots(history_file=str(tmp_path / "history.db"))
    assert robots.silences is not None
    robots.silences.add(parse_matchers("signal=battery_level"), for_s=60.0, reason="on the charger")
    robots.at(101.0)
    signal = reader(robots).state(window=False)["signals"]["battery_level"]
    assert signal["silenced"] == "on the charger"


def test_samples_are_bounded_and_then_only_new_ones_follow() -> None:
    robots = Robots()
    state = reader(robots)
    for number in range(400):
        robots.at(100.0 + number / 100.0)
        robots.observe(50.0 + number % 7)
    all_samples = state.samples()
    assert all_samples.event["full"]
    assert len(all_samples.event["signals"]["battery_level"]) <= MOST_SAMPLES
    robots.at(105.0)
    robots.observe(42.0)
    new = state.samples(all_samples)
    assert not new.event["full"]
    assert new.event["signals"] == {"battery_level": [[robots.wall_s(), 42.0]]}
    assert state.samples(new).event["signals"] == {}


def test_a_wall_clock_that_is_set_moves_all_samples() -> None:
    robots = Robots()
    state = reader(robots)
    robots.observe(50.0)
    before = state.samples()
    robots.wall_offset_s += 3600.0
    after = state.samples(before)
    assert after.event["full"]
    assert after.event["signals"] == {"battery_level": [[robots.wall_s(), 50.0]]}


def test_the_plot_of_arrivals_is_in_the_unit_of_their_statistic() -> None:
    robots = Robots(
        signals={"scan_gap": {"statistic": "largest_gap_s", "unit": "m"}, "load": {"statistic": "mean", "unit": "%"}}
    )
    assert [plot_of(robots.all[0], name)["unit"] for name in ("scan_gap", "load")] == ["s", "%"]


def test_the_plot_of_a_signal_that_is_not_watched_has_no_bounds() -> None:
    robots = Robots()
    assert plot_of(robots.all[0], "battery_level")["unit"] == "%"
    assert plot_of(robots.all[0], "motor") == {"unit": "", "bounds": [], "forecast_s": None}


def test_the_faults_of_several_robots_name_the_robot() -> None:
    robots, process = Robots("husky", "carter"), Faults()
    husky, carter = robots.all
    own = OwnState(lambda: robots.all, process.current)
    process.report("history", "disk full")
    robots.bus.nodes[1].faults.report("topic /scan", "dropped")
    assert own.texts() == ["history: disk full", "carter: topic /scan: dropped"]
    assert len(own.texts()) == 2
    assert own.as_json()["message"] == "history: disk full"
    process.clear("history")
    assert own.as_json()["message"] == "carter: topic /scan: dropped"
    assert own.of_robot(husky) == {"level": "OK", "message": "no faults"}
    assert own.of_robot(carter) == {"level": "ERROR", "message": "topic /scan: dropped"}


def test_a_fault_of_the_process_concerns_every_robot() -> None:
    robots, process = Robots(), Faults()
    own = OwnState(lambda: robots.all, process.current)
    process.report("pager", "cannot be reached")
    assert own.of_robot(robots.all[0]) == {"level": "ERROR", "message": "pager: cannot be reached"}
