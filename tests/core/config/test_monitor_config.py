"""Valid configurations, and the error line of each invalid one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import pytest
import yaml

from robot_health_monitor.core import ConfigError, load_config
from robot_health_monitor.core.config.monitor_config import (
    DEFAULT_SIGNALS,
    MonitorConfig,
    described_parameters,
)
from robot_health_monitor.core.config.signal_config import read_signal

CONFIG = Path(__file__).resolve().parents[3] / "config"


# --- what loads -----------------------------------------------------------------------------------------------------


def test_the_files_thresholds_are_the_defaults() -> None:
    assert load_config(CONFIG / "thresholds.yaml") == load_config({"signals": DEFAULT_SIGNALS})


def test_the_defaults_are_those_of_the_exercise() -> None:
    """Battery below 20 %: WARN. Temperature above 80 degrees C: WARN."""
    signals = load_config({"signals": DEFAULT_SIGNALS}).signals
    assert list(signals) == ["battery_level", "temperature", "cpu_usage"]
    assert (signals["battery_level"].warn_below, signals["temperature"].warn_above) == (20.0, 80.0)


def test_a_configuration_cannot_be_changed() -> None:
    config = load_config({"signals": {"a": {}}})
    with pytest.raises(AttributeError):
        config.signals["a"].warn_below = 5.0  # type: ignore[misc]
    with pytest.raises(TypeError):
        config.signals["b"] = config.signals["a"]  # type: ignore[index]


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
    expected = MonitorConfig({"a": read_signal("a", {"warn_below": 5.0})}, "atlas", publish_rate=2.0)
    assert load_config(source) == expected
    if source is not TREE:
        path = tmp_path / "robot.yaml"
        path.write_text(yaml.safe_dump(source))
        assert load_config(path) == load_config(str(path)) == expected


def test_the_nodes_own_section_wins_over_others_with_signals() -> None:
    sections = {name: {"ros__parameters": {"signals": {name: {}}}} for name in ("a", "alert_system", "b")}
    assert list(load_config(sections).signals) == ["alert_system"]
    assert list(load_config(sections, node="b").signals) == ["b"]


def test_every_parameter_is_declared_under_its_dotted_name_with_its_description() -> None:
    described = {each.name: each for each in described_parameters(("a", "b"))}
    assert {"publish_rate", "signals.a.warn_below", "signals.b.only_if.signal", "log_level"} <= described.keys()
    assert all(each.description for each in described.values())


def test_the_defaults_of_the_default_signals_are_those_that_are_watched() -> None:
    config = load_config({"signals": DEFAULT_SIGNALS})
    described = {each.name: each.default for each in described_parameters(tuple(config.signals), are_default=True)}
    assert described["signals.battery_level.warn_below"] == 20.0
    assert described["signals.temperature.unit"] == "degC"
    assert described["signals.cpu_usage.warn_below"] is None
    undescribed = {each.name: each.default for each in described_parameters(tuple(config.signals))}
    assert undescribed["signals.battery_level.warn_below"] is None


# --- what does not --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ({}, "signals: is missing; expected a mapping of signal names to their settings"),
        ({"signals": {}}, "signals: expected at least one signal, got none; `robot-health init` writes them"),
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
            "2: alert_system: expected the key ros__parameters, with two underscores, above the parameters",
        ),
        (
            "alert_system:\n  signals: {a: {}}\n",
            "1: alert_system: expected the key ros__parameters, with two underscores, above the parameters",
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
        f"7: {signals}.arm.warn_above: expected at most valid_max (60), got 80",
        f"7: {signals}.arm.error_above: expected at most valid_max (60), got 70",
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


def test_the_name_of_the_monitors_own_status_is_reserved() -> None:
    with pytest.raises(ConfigError, match="this name is reserved for the status of the monitor itself"):
        load_config({"signals": {"monitor": {"warn_below": 1.0}}})


def load_signals(signals: Mapping[str, Any]) -> Any:
    return load_config({"signals": signals})


def test_two_types_for_one_topic_are_a_mistake() -> None:
    with pytest.raises(ConfigError) as caught:
        load_signals(
            {"a": {"topic": "t", "type": "std_msgs/Float32"}, "b": {"topic": "t", "type": "std_msgs/msg/Float64"}}
        )
    assert [str(error) for error in caught.value.all] == [
        "signals.b.type: signal a of the same topic t has std_msgs/Float32, this one std_msgs/msg/Float64",
    ]
    load_signals({"a": {"topic": "t", "type": "std_msgs/Float32"}, "b": {"topic": "t", "type": "std_msgs/msg/Float32"}})


def test_a_signal_without_a_type_has_that_of_another_one_of_its_topic() -> None:
    signals = {"rate": {"topic": "t", "field": ""}, "a": {"topic": "t", "type": "std_msgs/Float32"}}
    assert load_signals(signals).signals["rate"].type == "std_msgs/Float32"
    with pytest.raises(ConfigError) as caught:
        load_signals({**signals, "b": {"topic": "t", "field": "percentage"}})
    assert [error.path[1:] for error in caught.value.all] == [("b", "field")]
    assert "t: std_msgs/Float32 has no field percentage" in str(caught.value)
    assert str(caught.value).endswith("; the type is that of signal a of the same topic")


def test_signals_at_the_top_of_a_file_show_the_nesting(tmp_path: Path) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text("signals:\n  battery_level: {warn_below: 20.0}\n")
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    nesting = "alert_system: {ros__parameters: {signals: ...}}"
    assert str(caught.value) == f"{file}:1: signals: expected below the name of a node: {nesting}"


SHOWN: Mapping[str, Any] = {
    "a": {"unit": "%"}, "b": {}, "c": {"unit": "V"}, "d": {"unit": "A"}, "e": {"unit": "W"},
    "cells": {"type": "sensor_msgs/BatteryState", "field": "cell_voltage[*]", "unit": "V"},
}  # fmt: skip


def test_the_main_signals_are_the_first_three_with_a_unit_or_those_of_show() -> None:
    assert load_signals(SHOWN).main_signals == ("a", "c", "d")
    assert load_config({"signals": SHOWN, "show": ["cells[1]", "b"]}).main_signals == ("cells[1]", "b")


@pytest.mark.parametrize("name", ["x", "b[1]x", "motors[1]", ""])
def test_show_names_signals_of_the_configuration(name: str) -> None:
    with pytest.raises(ConfigError, match=r"^show: expected names of signals \(a, b, c, d, e, cells\), got "):
        load_config({"signals": SHOWN, "show": [name]})


def test_robots_with_the_same_signal_share_its_configuration() -> None:
    first, second = (load_config({"signals": {"charge": {"warn_below": 21.5}}}) for _ in range(2))
    other = load_config({"signals": {"charge": {"warn_below": 21.0}}})
    assert first.signals["charge"] is second.signals["charge"]
    assert other.signals["charge"].warn_below == 21.0
