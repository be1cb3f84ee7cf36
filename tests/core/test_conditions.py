"""Rules and latches that depend on another signal, voltage sag under load, scale and placeholders."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Iterator, Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.config.monitor_config import ConfigError
from robot_health_monitor.core.values.model import Transition

SAG = Path(__file__).parent.parent / "data" / "battery_sag.csv"
LOW = {"unit": "%", "warn_below": 20.0, "stale_after_s": 0.0}
NOT_CHARGING = {"signal": "charging", "is": 0.0}
ON_CHARGER = {"signal": "charging", "is": 1.0}


class Robot:
    """A monitor, and the transitions so far as (time, signal, level)."""

    def __init__(self, battery: Mapping[str, Any], **others: Mapping[str, Any]) -> None:
        signals = {"battery": {**LOW, **battery}, "charging": {"stale_after_s": 5.0}, **others}
        self.monitor = Monitor(load_config({"signals": signals}))
        self.transitions: list[Transition] = []

    def see(self, now_s: float, **values: object) -> None:
        for signal, value in values.items():
            self.transitions += self.monitor.observe(Sample(signal, value, now_s))

    def tick(self, now_s: float) -> None:
        self.transitions += self.monitor.tick(now_s)

    @property
    def battery(self) -> list[tuple[float, str]]:
        return [(change.now_s, change.to_level.name) for change in self.transitions if change.signal == "battery"]

    def message(self, now_s: float) -> str:
        return self.monitor.report(now_s).statuses["battery"].message


def test_a_low_battery_on_the_charger_is_silent() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, charging=1.0, battery=15.0)
    robot.tick(1.0)
    assert robot.transitions == []
    assert robot.monitor.report(1.0).statuses["battery"].level is Level.OK
    assert robot.message(1.0) == "15 % is below 20 % (ignored: charging is not 0)"


def test_a_low_battery_alerts_when_it_leaves_the_charger_without_another_sample() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, charging=1.0, battery=15.0)
    robot.see(3.0, charging=0.0)
    assert [change.text for change in robot.transitions] == ["battery WARN: 15 % is below 20 % (was OK for 3 s)"]


def test_an_alert_ends_on_the_charger_and_says_why() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, charging=0.0, battery=15.0)
    robot.see(4.0, charging=1.0)
    assert [change.text for change in robot.transitions] == [
        "battery WARN: 15 % is below 20 % (was unknown for 0 s)",
        "battery OK: 15 % is below 20 % (ignored: charging is not 0) (was WARN for 4 s)",
    ]


def test_the_sample_that_brings_both_news_is_judged_in_the_order_of_arrival() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, battery=15.0, charging=1.0)
    assert robot.battery == [(0.0, "WARN"), (0.0, "OK")]


def test_a_bound_counts_while_the_other_signal_has_never_been_seen() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, battery=15.0)
    assert robot.battery == [(0.0, "WARN")]


def test_a_bound_counts_again_when_the_other_signal_falls_silent() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, charging=1.0, battery=15.0)
    for now_s in (1.0, 5.0):
        robot.tick(now_s)
    assert robot.battery == []
    robot.tick(5.5)
    assert [(change.signal, change.to_level) for change in robot.transitions] == [
        ("charging", Level.STALE),
        ("battery", Level.WARN),
    ]


@pytest.mark.parametrize("bad", [float("nan"), None, "1", [1.0]])
def test_a_bound_counts_while_the_other_signal_brings_bad_data(bad: object) -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, charging=1.0, battery=15.0)
    robot.see(1.0, charging=bad)
    assert robot.battery == [(1.0, "WARN")]
    robot.see(2.0, charging=1.0)
    assert robot.battery == [(1.0, "WARN"), (2.0, "OK")]


def test_a_bool_is_compared_as_0_and_1() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, charging=True, battery=15.0)
    assert robot.battery == []
    robot.see(1.0, charging=False)
    assert robot.battery == [(1.0, "WARN")]


@pytest.mark.parametrize(
    ("comparison", "counts"),
    [
        ({"is": 2.0}, [2.0]),
        ({"is_not": 2.0}, [-1.0, 1.9, 3.0]),
        ({"below": 2.0}, [-1.0, 1.9]),
        ({"above": 2.0}, [3.0]),
    ],
)
def test_each_comparison_is_strict(comparison: dict[str, float], counts: list[float]) -> None:
    for value in (-1.0, 1.9, 2.0, 3.0):
        robot = Robot({"only_if": {"signal": "charging", **comparison}})
        robot.see(0.0, charging=value, battery=15.0)
        assert (robot.battery != []) == (value in counts), value


def test_between_includes_both_ends_also_as_float32() -> None:
    inside = {0.3999: False, 0.4: True, 0.4000000059604645: True, 0.5: True, 0.6000000238418579: True, 0.6001: False}
    for value, counts in inside.items():
        robot = Robot({"only_if": {"signal": "charging", "between": [0.4, 0.6]}})
        robot.see(0.0, charging=value, battery=15.0)
        assert (robot.battery != []) is counts, value


def test_between_is_said_in_both_directions() -> None:
    robot = Robot({"only_if": {"signal": "charging", "between": [40, 60.5]}})
    robot.see(0.0, charging=70.0, battery=15.0)
    assert robot.message(0.0) == "15 % is below 20 % (ignored: charging is not between 40 and 60.5)"
    assert robot.monitor.report(0.0).statuses["battery"].values["only_if"] == "charging is between 40 and 60.5"


def test_a_latch_is_released_while_the_other_signal_is_between_two_values() -> None:
    robot = Robot({"latch": True, "latch_release_if": {"signal": "charging", "between": [1.0, 2.0]}})
    robot.see(0.0, charging=0.0, battery=15.0)
    robot.see(1.0, battery=50.0)
    assert robot.message(1.0) == ("50 % is no longer below 20 %, latched until reset or charging is between 1 and 2")
    robot.see(2.0, charging=1.5)
    assert robot.battery == [(0.0, "WARN"), (2.0, "OK")]


def test_a_float32_compares_as_equal_to_the_number_that_it_was_made_of() -> None:
    robot = Robot({"only_if": {"signal": "charging", "is": 0.1}})
    robot.see(0.0, charging=0.10000000149011612, battery=15.0)
    assert robot.battery == [(0.0, "WARN")]


def test_the_other_signal_is_compared_in_its_unit() -> None:
    robot = Robot({"only_if": {"signal": "load", "below": 5.0}}, load={"unit": "A", "scale": 0.001})
    robot.see(0.0, load=4900.0, battery=15.0)
    assert robot.battery == [(0.0, "WARN")]
    robot.see(1.0, load=5100.0)
    assert robot.battery == [(0.0, "WARN"), (1.0, "OK")]


def test_the_duration_counts_only_while_the_condition_holds() -> None:
    robot = Robot({"only_if": NOT_CHARGING, "for_s": 3.0})
    robot.see(0.0, charging=0.0, battery=15.0)
    robot.see(2.0, charging=1.0)
    robot.tick(4.0)
    robot.see(5.0, charging=0.0)
    robot.tick(7.9)
    assert robot.battery == []
    robot.tick(8.0)
    assert robot.battery == [(8.0, "WARN")]


def test_an_alert_that_is_held_back_keeps_firing_for_a_while() -> None:
    robot = Robot({"only_if": NOT_CHARGING, "keep_firing_for_s": 3.0})
    robot.see(0.0, charging=0.0, battery=15.0)
    robot.see(1.0, charging=1.0)
    assert robot.message(1.0) == (
        "15 % is below 20 % (ignored: charging is not 0), still firing until keep_firing_for_s has passed"
    )
    robot.tick(3.9)
    assert robot.battery == [(0.0, "WARN")]
    robot.tick(4.0)
    assert robot.battery == [(0.0, "WARN"), (4.0, "OK")]


def test_hysteresis_is_followed_while_the_bound_does_not_count() -> None:
    robot = Robot({"only_if": NOT_CHARGING, "hysteresis": 2.0})
    robot.see(0.0, charging=1.0, battery=15.0)
    robot.see(1.0, battery=21.0)
    assert robot.message(1.0) == "21 % was below 20 %, clears at 22 % (ignored: charging is not 0)"
    robot.see(2.0, charging=0.0)
    assert [change.text for change in robot.transitions] == [
        "battery WARN: 21 % was below 20 %, clears at 22 % (was OK for 2 s)"
    ]
    robot.see(3.0, battery=22.0)
    assert robot.battery == [(2.0, "WARN"), (3.0, "OK")]


def test_both_levels_are_held_back() -> None:
    robot = Robot({"only_if": NOT_CHARGING, "error_below": 10.0})
    robot.see(0.0, charging=1.0, battery=5.0)
    robot.see(1.0, charging=0.0)
    robot.see(2.0, charging=1.0)
    assert robot.battery == [(1.0, "ERROR"), (2.0, "OK")]
    assert robot.transitions[-1].bound == 10.0


def test_invalid_data_and_silence_are_announced_whatever_the_condition() -> None:
    robot = Robot({"only_if": NOT_CHARGING, "stale_after_s": 5.0})
    robot.see(0.0, charging=1.0, battery=float("nan"))
    assert robot.battery == [(0.0, "ERROR")]
    robot.see(1.0, battery=15.0)
    robot.see(6.5, charging=1.0)
    robot.tick(6.5)
    assert robot.battery == [(0.0, "ERROR"), (1.0, "OK"), (6.5, "STALE")]


def test_a_condition_that_is_taken_out_of_the_configuration_holds_nothing_back_any_more() -> None:
    robot = Robot({"only_if": NOT_CHARGING})
    robot.see(0.0, charging=1.0, battery=15.0)
    robot.transitions += robot.monitor.configure(load_config({"signals": {"battery": LOW, "charging": {}}}))
    assert robot.battery == [(0.0, "WARN")]
    robot.see(1.0, charging=1.0)
    assert robot.battery == [(0.0, "WARN")]


def test_a_condition_that_is_put_into_the_configuration_counts_at_once() -> None:
    robot = Robot({})
    robot.see(0.0, charging=1.0, battery=15.0)
    config = load_config({"signals": {"battery": {**LOW, "only_if": NOT_CHARGING}, "charging": {}}})
    robot.transitions += robot.monitor.configure(config)
    assert robot.battery == [(0.0, "WARN"), (0.0, "OK")]


def test_a_condition_may_look_at_the_link() -> None:
    robot = Robot({"only_if": {"signal": "link", "is": 1.0}})
    robot.see(0.0, link=1.0, battery=15.0)
    assert robot.battery == [(0.0, "WARN")]


def test_a_latch_is_released_on_the_charger_so_that_a_discharge_is_one_alert() -> None:
    robot = Robot({"latch": True, "latch_release_if": ON_CHARGER, "only_if": NOT_CHARGING})
    now_s = 0.0
    for battery, charging in [
        (25, 0), (19, 0), (21, 0), (18, 0), (30, 0), (12, 0),   # one discharge: the voltage comes and goes
        (13, 1), (19, 1), (21, 1), (90, 1),                     # on the charger
        (90, 0), (19, 0), (21, 0),                              # the next discharge
    ]:  # fmt: skip
        robot.see(now_s, charging=float(charging), battery=float(battery))
        now_s += 1.0
    assert robot.battery == [(1.0, "WARN"), (6.0, "OK"), (11.0, "WARN")]
    assert robot.message(now_s) == "21 % is no longer below 20 %, latched until reset or charging is 1"


def test_a_rule_that_still_fires_is_not_silenced_by_the_release_of_its_latch() -> None:
    robot = Robot({"latch": True, "latch_release_if": ON_CHARGER})
    robot.see(0.0, battery=15.0)
    robot.see(1.0, charging=1.0)
    robot.tick(2.0)
    assert robot.battery == [(0.0, "WARN")]
    robot.see(3.0, battery=25.0)
    robot.see(4.0, charging=1.0)
    assert robot.battery == [(0.0, "WARN"), (4.0, "OK")]


def test_a_latch_is_not_released_by_a_signal_that_is_not_known() -> None:
    robot = Robot({"latch": True, "latch_release_if": {"signal": "charging", "is_not": 0.0}})
    robot.see(0.0, battery=15.0)
    robot.see(1.0, battery=25.0)
    robot.see(2.0, charging=float("nan"))
    robot.tick(60.0)
    assert robot.battery == [(0.0, "WARN")]


def test_the_status_names_the_conditions() -> None:
    robot = Robot({"only_if": NOT_CHARGING, "latch_release_if": {"signal": "charging", "above": 0.5}})
    values = robot.monitor.report(0.0).statuses["battery"].values
    assert values["only_if"] == "charging is 0"
    assert values["latch_release_if"] == "charging is above 0.5"


@pytest.mark.parametrize("key", ["only_if", "latch_release_if"])
@pytest.mark.parametrize(
    ("condition", "error"),
    [
        ({}, "signal: is missing; expected the name of the other signal"),
        ({"is": 1.0}, "signal: is missing; expected the name of the other signal"),
        ({"signal": "charging"}, "expected one of is, is_not, below, above, between, got none"),
        (
            {"signal": "charging", "is": 1.0, "below": 2.0},
            "expected one of is, is_not, below, above, between, got is and below",
        ),
        ({"signal": "charging", "between": 1.0}, "between: expected a list of numbers, got 1.0"),
        (
            {"signal": "charging", "between": [60.0, 40.0]},
            "between: expected two numbers, the smaller one first, got [60, 40]",
        ),
        ({"signal": "charging", "between": [40.0]}, "between: expected two numbers, the smaller one first, got [40]"),
        ({"signal": "charging", "between": []}, "between: expected two numbers, the smaller one first, got []"),
        ({"signal": "charging", "between": [0.0, float("nan")]}, "between: expected a list of numbers, got [0.0, nan]"),
        ({"signal": "charging", "between": [0.0, True]}, "between: expected a list of numbers, got [0.0, True]"),
        (
            {"signal": "charging", "between": [1, 2], "is": 1.0},
            "expected one of is, is_not, below, above, between, got is and between",
        ),
        ({"signal": "charging", "is": "yes"}, "is: expected a number, got 'yes'"),
        ({"signal": "charging", "is": True}, "is: expected a number, got true"),
        (
            {"signal": "charging", "equals": 1.0},
            "equals: unknown key; expected one of signal, is, is_not, below, above, between",
        ),
        (
            {"signal": "battery", "is": 1.0},
            "signal: expected the name of another signal (charging, link), got 'battery'",
        ),
        (
            {"signal": "charger", "is": 1.0},
            "signal: expected the name of another signal (charging, link), got 'charger'",
        ),
        ("charging", "expected a mapping of keys to values, got 'charging'"),
        (None, "expected a mapping of keys to values, got nothing"),
    ],
)
def test_a_condition_that_cannot_be_used_is_refused(key: str, condition: object, error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config({"signals": {"battery": {"warn_below": 20.0, key: condition}, "charging": {}}})
    separator = "." if error.split(":")[0].isidentifier() else ": "
    assert str(caught.value) == f"signals.battery.{key}{separator}{error}"


def drive() -> Iterator[dict[str, float]]:
    with SAG.open(encoding="utf-8") as rows:
        for row in csv.DictReader(line for line in rows if not line.startswith("#")):
            yield {name: float(text) for name, text in row.items()}


def voltage_levels(**battery: Any) -> list[tuple[float, str]]:
    robot = Robot({"unit": "V", "warn_below": 13.8, "hysteresis": 0.1, **battery})
    for row in drive():
        robot.see(row["t_s"], charging=row["power_supply_status"], battery=row["voltage_v"])
        robot.tick(row["t_s"] + 0.5)
    return robot.battery


def test_without_a_duration_every_sag_of_the_voltage_is_an_alert() -> None:
    assert voltage_levels() == [
        (140.0, "WARN"), (143.0, "OK"), (300.0, "WARN"), (304.0, "OK"), (360.0, "WARN"), (420.0, "OK"),
    ]  # fmt: skip


def test_with_for_s_only_the_ramp_that_lasts_is_an_alert() -> None:
    assert voltage_levels(for_s=5.0) == [(365.0, "WARN"), (420.0, "OK")]


def test_with_a_latch_and_the_charger_a_discharge_is_one_alert() -> None:
    on_charger = {"signal": "charging", "is": 1.0}
    assert voltage_levels(for_s=5.0, latch=True, latch_release_if=on_charger) == [(365.0, "WARN"), (450.0, "OK")]


def test_scale_puts_the_number_into_the_unit_of_bounds_and_texts() -> None:
    robot = Robot({"scale": 100.0, "valid_min": 0.0, "valid_max": 100.0})
    robot.see(0.0, battery=0.25)
    robot.see(1.0, battery=0.19)
    robot.see(2.0, battery=1.5)
    assert [change.text for change in robot.transitions] == [
        "battery WARN: 19 % is below 20 % (was OK for 1 s)",
        "battery ERROR: invalid data: 150 % is above valid_max 100, suspicious data: 1.5 looks like a percentage"
        " already, not like a fraction; if so, set scale: 1 (was WARN for 1 s)",
    ]
    assert robot.monitor.report(2.0).statuses["battery"].values["scale"] == "100"


def test_a_negative_scale_turns_the_sign() -> None:
    robot = Robot({"unit": "A", "warn_below": 0.0, "scale": -1.0})
    robot.see(0.0, battery=1.0)
    assert robot.battery == [(0.0, "WARN")]


@pytest.mark.parametrize("scale", [0.0, float("nan"), float("inf"), "100", True])
def test_a_scale_of_0_or_not_a_number_is_refused(scale: object) -> None:
    with pytest.raises(ConfigError, match=r"^signals\.battery\.scale: expected "):
        load_config({"signals": {"battery": {"scale": scale}}})


@pytest.mark.parametrize("scale", [1e308, -1e308, 1e-308])
def test_a_number_that_scale_drives_out_of_a_double_is_bad_data(scale: float) -> None:
    robot = Robot({"unit": "", "scale": scale})
    robot.see(0.0, battery=1e300 if abs(scale) > 1.0 else 1e-300)
    values = robot.monitor.report(0.0).statuses["battery"].values
    assert values["bad_samples"] == ("1" if abs(scale) > 1.0 else "0")


def test_a_placeholder_is_compared_with_the_number_as_it_came() -> None:
    robot = Robot({"scale": 100.0, "placeholders": [-1.0, 0.0]})
    robot.see(0.0, battery=-1.0)
    robot.see(1.0, battery=0.0)
    robot.see(2.0, battery=-0.01)
    values = robot.monitor.report(2.0).statuses["battery"].values
    assert (values["bad_samples"], values["good_samples"]) == ("2", "1")


def test_a_placeholder_enters_no_window() -> None:
    robot = Robot({"placeholders": [0.0], "statistic": "mean", "window_min_s": 0.0})
    for now_s, battery in enumerate([40.0, 0.0, 0.0, 40.0]):
        robot.see(float(now_s), battery=battery)
    assert robot.monitor.report(3.0).statuses["battery"].values["mean"] == "40"


@pytest.mark.parametrize("placeholders", [0.0, "0", [None], ["0"], [True], [float("nan")], {"a": 0.0}, None])
def test_placeholders_are_a_list_of_numbers(placeholders: object) -> None:
    with pytest.raises(ConfigError, match=r"^signals\.battery\.placeholders: expected a list of numbers, got .*$"):
        load_config({"signals": {"battery": {"placeholders": placeholders}}})


CALLS = st.lists(
    st.tuples(
        st.sampled_from(["battery", "charging", "tick"]),
        st.sampled_from([0.0, 0.5, 1.0, 5.0, 19.0, 21.0, 50.0, float("nan"), None]),
        st.sampled_from([0.0, 0.1, 1.0, 7.0, -3.0]),
    ),
    max_size=60,
)
SETTINGS = st.fixed_dictionaries(
    {},
    optional={
        "only_if": st.just(NOT_CHARGING),
        "latch_release_if": st.just({"signal": "charging", "above": 0.7}),
        "latch": st.booleans(),
        "for_s": st.sampled_from([0.0, 1.0]),
        "keep_firing_for_s": st.sampled_from([0.0, 1.0]),
        "hysteresis": st.just(2.0),
        "error_below": st.just(10.0),
        "flap_detection": st.booleans(),
        "scale": st.sampled_from([1.0, 2.0]),
        "placeholders": st.just([5.0]),
        "stale_after_s": st.just(5.0),
    },
)


@given(SETTINGS, CALLS)
def test_transitions_chain_and_end_where_the_report_is(settings: dict[str, Any], calls: list[Any]) -> None:
    robot = Robot(settings)
    now_s = 100.0
    for what, value, step_s in calls:
        now_s += step_s
        if what == "tick":
            robot.tick(now_s)
        else:
            robot.see(now_s, **{what: value})
    report = robot.monitor.report(now_s)
    for signal in ("battery", "charging"):
        level = Level.OK
        for change in robot.transitions:
            if change.signal == signal:
                assert change.from_level is level and change.to_level is not level
                level = change.to_level
        values = report.statuses[signal].values
        if calls and values["flapping"] == "false" and values["state"] != "waiting":
            assert report.statuses[signal].level is level


@given(SETTINGS, CALLS)
def test_a_bound_that_does_not_count_never_fires(settings: dict[str, Any], calls: list[Any]) -> None:
    robot = Robot({**settings, "only_if": NOT_CHARGING, "keep_firing_for_s": 0.0, "latch": False})
    now_s = 100.0
    robot.see(now_s, charging=1.0)
    for what, value, step_s in calls:
        now_s += step_s
        robot.see(now_s, charging=1.0)
        if what == "battery":
            robot.see(now_s, battery=value)
        robot.tick(now_s)
    assert [
        change for change in robot.transitions if change.bound is not None and change.to_level is not Level.OK
    ] == []


@pytest.mark.parametrize(
    ("comparison", "charging", "reason"),
    [("is_not", 1.0, "charging is 1"), ("is", 2.0, "charging is not 1"), ("above", 0.5, "charging is not above 1")],
)
def test_the_reason_names_the_condition_that_is_not_met(comparison: str, charging: float, reason: str) -> None:
    robot = Robot({"only_if": {"signal": "charging", comparison: 1.0}})
    robot.see(0.0, charging=charging, battery=15.0)
    assert robot.message(1.0) == f"15 % is below 20 % (ignored: {reason})"
