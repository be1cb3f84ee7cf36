"""Valid configurations, and the error line of each invalid one."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any, Dict, Mapping

import pytest
import yaml

from robot_health_monitor.core import ConfigError, load_config
from robot_health_monitor.core.config import (
    CONDITIONS,
    DEFAULT_SIGNALS,
    SIGNAL_PARAMETERS,
    MonitorConfig,
    SignalConfig,
    described_parameters,
    read_signal,
)

CONFIG = Path(__file__).resolve().parents[2] / "config"


def signal(**settings: Any) -> SignalConfig:
    return read_signal("battery_level", settings)


def refusal(**settings: Any) -> str:
    with pytest.raises(ConfigError) as raised:
        load_config({"signals": {"battery_level": settings}})
    text = str(raised.value)
    prefix = "signals.battery_level."
    assert text.startswith(prefix) and len(text.splitlines()) == 1
    return text[len(prefix) :]


# --- what loads -----------------------------------------------------------------------------------------------------


def test_the_files_thresholds_are_the_defaults() -> None:
    assert load_config(CONFIG / "thresholds.yaml") == load_config({"signals": DEFAULT_SIGNALS})


def test_the_defaults_are_those_of_the_exercise() -> None:
    """Battery below 20 %: WARN. Temperature above 80 degrees C: WARN."""
    signals = load_config({"signals": DEFAULT_SIGNALS}).signals
    assert list(signals) == ["battery_level", "temperature", "cpu_usage"]
    assert (signals["battery_level"].warn_below, signals["temperature"].warn_above) == (20.0, 80.0)


def test_a_signal_needs_nothing() -> None:
    assert signal() == SignalConfig(
        name="battery_level",
        topic="battery_level",
        type="",
        field="data",
        scale=1.0,
        unit="",
        placeholders=(),
        valid_min=None,
        valid_max=None,
        invalid_for_s=0.0,
        window_s=60.0,
        window_min_s=30.0,
        window_samples=6000,
        statistic="last",
        warn_below=None,
        warn_above=None,
        error_below=None,
        error_above=None,
        hysteresis=0.0,
        for_s=0.0,
        keep_firing_for_s=0.0,
        error_for_s=0.0,
        error_keep_firing_for_s=0.0,
        latch=False,
        flap_detection=False,
        flap_high=50.0,
        flap_low=25.0,
        stale_after_s=5.0,
        startup_grace_s=10.0,
        repeat_s=0.0,
        only_if=None,
        latch_release_if=None,
    )


def test_every_parameter_of_a_signal_has_a_field_and_every_field_a_parameter() -> None:
    fields = {field.name for field in dataclasses.fields(SignalConfig)}
    assert fields == {"name", *(parameter.name for parameter in SIGNAL_PARAMETERS), *CONDITIONS}


def test_durations_of_error_are_those_of_warn_unless_they_are_given() -> None:
    both = signal(for_s=3.0, keep_firing_for_s=4.0)
    assert (both.error_for_s, both.error_keep_firing_for_s) == (3.0, 4.0)
    own = signal(for_s=3.0, keep_firing_for_s=4.0, error_for_s=0.0, error_keep_firing_for_s=1.0)
    assert (own.error_for_s, own.error_keep_firing_for_s) == (0.0, 1.0)


def test_a_configuration_cannot_be_changed() -> None:
    config = load_config({"signals": {"a": {}}})
    with pytest.raises(AttributeError):
        config.signals["a"].warn_below = 5.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        config.signals["b"] = config.signals["a"]  # type: ignore[index]


def test_bounds_are_those_that_are_set() -> None:
    assert signal(warn_below=20, error_below=0.0).bounds == {"warn_below": 20.0, "error_below": 0.0}


TREE = {"signals": {"a": {"warn_below": 5.0}}, "robot_name": "atlas", "publish_rate": 2}


@pytest.mark.parametrize(
    "source",
    [
        TREE,
        {"alert_system": {"ros__parameters": TREE}},
        {"/robot1/alert_system": {"ros__parameters": TREE}},
        {"robot1": {"alert_system": {"ros__parameters": TREE}}},
        {"/**": {"ros__parameters": TREE}},
        {"my_monitor": {"ros__parameters": TREE}, "aggregator": {"ros__parameters": {"window_s": 5.0}}},
    ],
    ids=["parameters", "file", "namespace", "nested namespace", "any node", "another name"],
)
def test_the_parameters_or_a_whole_files_mapping_or_a_file_are_the_same(
    source: Mapping[str, Any], tmp_path: Path
) -> None:
    expected = MonitorConfig({"a": read_signal("a", {"warn_below": 5.0})}, "atlas", 2.0)
    assert load_config(source) == expected
    if source is not TREE:
        path = tmp_path / "robot.yaml"
        path.write_text(yaml.safe_dump(source))
        assert load_config(path) == load_config(str(path)) == expected


def test_the_nodes_own_section_wins_over_others_with_signals() -> None:
    sections = {name: {"ros__parameters": {"signals": {name: {}}}} for name in ("a", "alert_system", "b")}
    assert list(load_config(sections).signals) == ["alert_system"]
    assert list(load_config(sections, node="b").signals) == ["b"]


@pytest.mark.parametrize(
    "settings",
    [
        {"warn_below": 20, "error_below": 20},
        {"warn_above": 80, "error_above": 80},
        {"warn_below": 20.0, "warn_above": 20.0},
        {"warn_below": 20.0, "warn_above": 22.0, "hysteresis": 2.0},
        {"valid_min": 5.0, "valid_max": 5.0},
        {"valid_min": 0.0, "warn_below": 0.0, "valid_max": 100.0, "warn_above": 100.0, "unit": "%"},
        {"valid_max": 100.0, "warn_below": 98.0, "hysteresis": 2.0},
        {"flap_high": 30.0, "flap_low": 30.0},
        {"unit": "degC", "valid_min": -273.15},
        {"unit": "%", "statistic": "rate", "warn_below": -200.0, "warn_above": 200.0},
        {"unit": "furlong", "warn_below": -1e300},
        {"valid_max": 10.0, "statistic": "stddev", "warn_above": 50.0},
    ],
)
def test_what_is_just_possible_loads(settings: Dict[str, Any]) -> None:
    signal(**settings)


def test_every_parameter_is_declared_under_its_dotted_name_with_its_description() -> None:
    described = {each.name: each for each in described_parameters(load_config({"signals": {"a": {}, "b": {}}}))}
    assert {"publish_rate", "signals.a.warn_below", "signals.b.only_if.signal", "log_level"} <= described.keys()
    assert all(each.description for each in described.values())


def test_the_defaults_of_the_default_signals_are_those_that_are_watched() -> None:
    config = load_config({"signals": DEFAULT_SIGNALS})
    described = {each.name: each.default for each in described_parameters(config, are_default=True)}
    assert described["signals.battery_level.warn_below"] == 20.0
    assert described["signals.temperature.unit"] == "degC"
    assert described["signals.cpu_usage.warn_below"] is None
    undescribed = {each.name: each.default for each in described_parameters(config)}
    assert undescribed["signals.battery_level.warn_below"] is None


# --- what does not --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (
            {"warn_below": 20, "error_below": 30},
            "error_below: expected at most warn_below (20), got 30: a falling value crosses the WARN bound first",
        ),
        (
            {"warn_above": 80, "error_above": 70},
            "warn_above: expected at most error_above (70), got 80: a rising value crosses the WARN bound first",
        ),
        (
            {"warn_below": 80, "warn_above": 20},
            "warn_below: expected at most warn_above (20), got 80: no value would be OK",
        ),
        (
            {"error_below": 80, "warn_above": 20},
            "error_below: expected at most warn_above (20), got 80: no value would be OK",
        ),
        (
            {"valid_min": 5, "valid_max": 4},
            "valid_min: expected at most valid_max (4), got 5: no value would be valid",
        ),
        (
            {"warn_below": 20, "warn_above": 21, "hysteresis": 2},
            "hysteresis: expected at most 1, got 2: warn_below would clear above warn_above",
        ),
        ({"flap_low": 60}, "flap_low: expected at most flap_high (50), got 60"),
        ({"flap_high": 10}, "flap_high: expected at least flap_low (25), got 10"),
        ({"valid_max": 100, "warn_above": 120}, "warn_above: expected at most 100 (valid_max), got 120"),
        (
            {"valid_max": 100, "warn_above": 100.0000001},
            "warn_above: expected at most 100 (valid_max), got 100.0000001",
        ),
        ({"valid_min": 0, "error_below": -5}, "error_below: expected at least 0 (valid_min), got -5"),
        (
            {"valid_max": 100, "warn_below": 99, "hysteresis": 2},
            "hysteresis: expected less, got 2: warn_below would clear at 101, which is not a valid value",
        ),
        (
            {"valid_min": 0, "warn_above": 1, "hysteresis": 2},
            "hysteresis: expected less, got 2: warn_above would clear at -1, which is not a valid value",
        ),
        ({"scale": 0}, "scale: expected a number other than 0, got 0"),
    ],
)
def test_bounds_that_contradict_each_other_are_refused(settings: Dict[str, Any], problem: str) -> None:
    assert refusal(**settings) == problem


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"unit": "%", "warn_below": 120}, "warn_below: expected at most 100 (the maximum of %), got 120"),
        ({"unit": "%", "valid_min": -1}, "valid_min: expected at least 0 (the minimum of %), got -1"),
        (
            {"unit": "%", "valid_max": 1.0},
            "unit: expected valid_max 100 for the unit '%', got 1; a fraction from 0 to 1 has the unit ''",
        ),
        (
            {"unit": "degC", "warn_below": -300},
            "warn_below: expected at least -273.15 (the minimum of degC), got -300",
        ),
        ({"unit": "K", "valid_min": -40}, "valid_min: expected at least 0 (the minimum of K), got -40"),
        ({"unit": "Hz", "warn_below": -1}, "warn_below: expected at least 0 (the minimum of Hz), got -1"),
    ],
)
def test_units_that_cannot_be_right_are_refused(settings: Dict[str, Any], problem: str) -> None:
    assert refusal(**settings) == problem


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"warn_below": "low"}, "warn_below: expected a number, got 'low'"),
        ({"warn_below": math.nan}, "warn_below: expected a number, got nan"),
        ({"warn_above": math.inf}, "warn_above: expected a number, got inf"),
        ({"warn_below": True}, "warn_below: expected a number, got true"),
        ({"warn_below": None}, "warn_below: expected a number, got nothing"),
        ({"for_s": -1}, "for_s: expected a number from 0 to 31536000, got -1"),
        ({"window_s": 0}, "window_s: expected a number from 0.001 to 31536000, got 0"),
        ({"window_samples": 1.5}, "window_samples: expected a whole number from 1 to 1000000, got 1.5"),
        ({"flap_high": 101}, "flap_high: expected a number from 0 to 100, got 101"),
        ({"latch": "yes"}, "latch: expected true or false, got 'yes'"),
        ({"unit": 5}, "unit: expected printable text, got 5; quote it"),
        (
            {"statistic": "median"},
            "statistic: expected one of last, mean, min, max, stddev, rate, frequency_hz, got 'median'",
        ),
    ],
)
def test_wrong_kinds_and_ranges_are_refused(settings: Dict[str, Any], problem: str) -> None:
    assert refusal(**settings) == problem


def test_an_unknown_key_is_refused_with_a_hint() -> None:
    assert refusal(warn_bellow=20).startswith(
        "warn_bellow: unknown key; did you mean warn_below? expected one of topic, "
    )


@pytest.mark.parametrize(
    ("condition", "problem"),
    [
        ({"is": 0}, "only_if.signal: is missing; expected the name of another signal"),
        ({"signal": "link"}, "only_if: expected one of is, is_not, below, above, got none"),
        (
            {"signal": "link", "is": 1, "above": 2},
            "only_if: expected one of is, is_not, below, above, got is and above",
        ),
        (
            {"signal": "battery_level", "is": 1},
            "only_if.signal: expected the name of another signal (link), got 'battery_level'",
        ),
        ({"signal": "charging", "is": 1}, "only_if.signal: expected the name of another signal (link), got 'charging'"),
        ("charging", "only_if: expected a mapping of keys to values, got 'charging'"),
    ],
)
def test_conditions_that_cannot_be_looked_at_are_refused(condition: object, problem: str) -> None:
    assert refusal(only_if=condition) == problem


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ({}, "signals: is missing; expected a mapping of signal names to their settings"),
        ({"signals": {}}, "signals: expected at least one signal, got none"),
        ({"signals": None}, "signals: expected a mapping of keys to values, got nothing"),
        ({"signals": {"a": None}}, "signals.a: expected a mapping of keys to values, got nothing"),
        ({"signals": {1: {}}}, "signals.1: expected text as a key, got 1; quote it"),
        (
            {"signals": {"2nd": {}}},
            "signals.2nd: expected a signal name of letters, digits and _, not beginning with a digit",
        ),
        (
            {"signals": {"a\n": {}}},
            "signals.a\\n: expected a signal name of letters, digits and _, not beginning with a digit",
        ),
        (
            {"a": {"ros__parameters": {"signals": {}}}, "b": {"ros__parameters": {"signals": {}}}},
            "expected one node with ros__parameters.signals, usually alert_system, got 'a, b'",
        ),
        (
            {"alert_system": {"ros__parameters": None}},
            "alert_system.ros__parameters: expected a mapping of keys to values, got nothing",
        ),
        (None, "expected a mapping of keys to values, got nothing"),
        (5, "expected a mapping of keys to values, got 5"),
    ],
)
def test_anything_but_a_configuration_is_refused(source: Any, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load_config(source)
    assert str(raised.value).startswith(problem)


HEAD = "# a comment\nalert_system:\n  ros__parameters:\n    signals:\n      battery_level:\n        unit: '%'\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            HEAD + "        warn_below: twenty\n",
            "7: alert_system.ros__parameters.signals.battery_level.warn_below: expected a number, got 'twenty'",
        ),
        (
            HEAD + "        warn_bellow: 20\n",
            "7: alert_system.ros__parameters.signals.battery_level.warn_bellow: unknown key; did you mean warn_below?",
        ),
        (
            HEAD + "        warn_below: 20\n        error_below: 30\n",
            "8: alert_system.ros__parameters.signals.battery_level.error_below: expected at most warn_below (20)",
        ),
        (
            HEAD + "        unit: '%'\n",
            "7: alert_system.ros__parameters.signals.battery_level.unit: is given twice, first in line 6",
        ),
        (
            HEAD.replace("signals:", "signal:"),
            "4: alert_system.ros__parameters.signal: unknown key; did you mean signals?",
        ),
        (
            HEAD.replace("ros__parameters", "ros_parameters"),
            "3: alert_system.ros_parameters: unknown key; did you mean ros__parameters, with two underscores?",
        ),
        (
            "alert_system:\n  signals: {a: {}}\n",
            "1: alert_system: expected the key ros__parameters above the parameters",
        ),
        (
            HEAD + "      temperature:\n",
            "7: alert_system.ros__parameters.signals.temperature: expected a mapping of keys to values, got nothing",
        ),
        (HEAD + "        only_if: {signal: link}\n", "7: alert_system.ros__parameters.signals.battery_level.only_if:"),
        (
            HEAD + "        warn_below: 1e1\n",
            "7: alert_system.ros__parameters.signals.battery_level.warn_below: expected a number, got '1e1';"
            " YAML reads this as text, write 10.0",
        ),
    ],
)
def test_a_mistake_in_a_file_is_named_with_file_line_and_key(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as raised:
        load_config(path)
    assert str(raised.value).startswith(f"{path}:{said}")
    assert len(str(raised.value).splitlines()) == 1


def test_a_file_with_two_alert_systems_is_refused_and_both_are_named() -> None:
    section = {"ros__parameters": {"signals": {"battery_level": {"warn_below": 20.0}}}}
    with pytest.raises(ConfigError) as refused:
        load_config({"robot1": {"alert_system": section}, "/robot2/alert_system": section})
    assert str(refused.value) == (
        "/robot2/alert_system: expected one section for alert_system in a file (one file per robot), "
        "got robot1.alert_system and /robot2/alert_system"
    )


def test_all_mistakes_of_a_file_are_found_in_one_pass(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "alert_system:\n"
        "  ros__parameters:\n"
        "    publish_rate: fast\n"
        "    signals:\n"
        "      battery_level: {warn_below: 20, error_below: 30, hysteresis: -1,\n"
        "                      unit: 5}\n"
        "      arm: {warn_above: 80, error_above: 70, valid_max: 60, scale: 0, field: 'data[', type: Float32,\n"
        "            only_if: {signal: hand, is: 1}}\n"
        "      leg: {only_if: {signal: foot, is: 1}}\n"
        "      link: {}\n"
    )
    with pytest.raises(ConfigError) as raised:
        load_config(path)
    signals = "alert_system.ros__parameters.signals"
    assert [str(error)[len(f"{path}:") :] for error in raised.value.all] == [
        "3: alert_system.ros__parameters.publish_rate: expected a number from 0.01 to 100, got 'fast'",
        f"5: {signals}.battery_level.hysteresis: expected a number of at least 0, got -1",
        f"6: {signals}.battery_level.unit: expected printable text, got 5; quote it",
        f"7: {signals}.arm.type: expected a type such as std_msgs/Float32, got 'Float32'",
        f"7: {signals}.arm.field: expected the path of a field, got 'data[': '[' is not a name, an index such as"
        ' [0] or a key such as ["motor"]',
        f"7: {signals}.arm.scale: expected a number other than 0, got 0",
        f"7: {signals}.arm.warn_above: expected at most error_above (70), got 80: a rising value crosses the WARN"
        " bound first",
        f"7: {signals}.arm.warn_above: expected at most 60 (valid_max), got 80",
        f"7: {signals}.arm.error_above: expected at most 60 (valid_max), got 70",
        f"9: {signals}.leg.only_if.signal: expected the name of another signal (battery_level, arm, link), got 'foot'",
        f"10: {signals}.link: this name is reserved for the link to the robot; expected another",
    ]


def test_conditions_may_refer_to_the_link() -> None:
    config = load_config({"signals": {"a": {"only_if": {"signal": "link", "is": 1}}}})
    assert str(config.signals["a"].only_if) == "link is 1"


def test_a_token_in_a_configuration_is_refused_and_not_repeated() -> None:
    with pytest.raises(ConfigError) as raised:
        load_config({"rosbridge_token": "s3cret", "rosbridge_tokn": "s3cret", "signals": {"a": {}}})
    assert [error.path for error in raised.value.all] == [("rosbridge_token",), ("rosbridge_tokn",)]
    assert "rosbridge_token_file" in str(raised.value)
    assert not any("s3cret" in str(error) for error in raised.value.all)


def test_the_paths_of_other_files_are_read() -> None:
    config = load_config({"rosbridge_token_file": "/etc/token", "ops": "ops.yaml", "signals": {"a": {}}})
    assert (config.rosbridge_token_file, config.ops) == ("/etc/token", "ops.yaml")


@pytest.mark.parametrize(
    ("tree", "expected"),
    [({}, 30.0), ({"window_s": 4.0}, 2.0), ({"window_min_s": 0.0}, 0.0), ({"window_min_s": 60.0}, 60.0)],
)
def test_window_min_s_is_half_of_window_s_unless_it_is_given(tree: Dict[str, float], expected: float) -> None:
    assert load_config({"signals": {"a": tree}}).signals["a"].window_min_s == expected


def test_window_min_s_above_window_s_is_an_error() -> None:
    with pytest.raises(ConfigError, match=r"^signals\.a\.window_min_s: expected at most window_s \(10\), got 11$"):
        load_config({"signals": {"a": {"window_s": 10.0, "window_min_s": 11.0}}})


def test_the_name_of_the_monitors_own_status_is_reserved() -> None:
    with pytest.raises(ConfigError, match="this name is reserved for the status of the monitor itself"):
        load_config({"signals": {"monitor": {"warn_below": 1.0}}})


def load_signals(signals: Mapping[str, Any]) -> Any:
    return load_config({"signals": signals})


def test_two_types_for_one_topic_are_a_mistake_at_both_signals() -> None:
    with pytest.raises(ConfigError) as caught:
        load_signals(
            {"a": {"topic": "t", "type": "std_msgs/Float32"}, "b": {"topic": "t", "type": "std_msgs/msg/Float64"}}
        )
    assert [str(error) for error in caught.value.all] == [
        "signals.a.type: signal b of the same topic t has std_msgs/msg/Float64, this one std_msgs/Float32",
        "signals.b.type: signal a of the same topic t has std_msgs/Float32, this one std_msgs/msg/Float64",
    ]
    load_signals({"a": {"topic": "t", "type": "std_msgs/Float32"}, "b": {"topic": "t", "type": "std_msgs/msg/Float32"}})


def test_a_signal_without_a_type_has_that_of_another_one_of_its_topic() -> None:
    signals = {"rate": {"topic": "t", "field": ""}, "a": {"topic": "t", "type": "std_msgs/Float32"}}
    assert load_signals(signals).signals["rate"].type == "std_msgs/Float32"
    with pytest.raises(ConfigError) as caught:
        load_signals({**signals, "b": {"topic": "t", "field": "percentage"}})
    assert [error.path[1:] for error in caught.value.all] == [("b", "field"), ("a", "type")]
    assert "t: std_msgs/Float32 has no field percentage" in str(caught.value)
    assert str(caught.value).endswith("; the type is that of signal a of the same topic")


def test_a_duration_is_at_most_a_year() -> None:
    for parameter in SIGNAL_PARAMETERS:
        if parameter.name.endswith("_s"):
            with pytest.raises(ConfigError, match=r"to 31536000, got 10000000000|window_s"):
                load_signals({"a": {parameter.name: 1e10}})


def test_signals_at_the_top_of_a_file_show_the_nesting(tmp_path: Path) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text("signals:\n  battery_level: {warn_below: 20.0}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    nesting = "alert_system: {ros__parameters: {signals: ...}}"
    assert str(caught.value) == f"{file}:1: signals: expected below the name of a node: {nesting}"
