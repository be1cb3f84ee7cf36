"""What the nodes share: names, and what a change of configuration may change and did change."""

from __future__ import annotations

import pytest

from robot_health_monitor.core import load_config
from robot_health_monitor.core.nodes.node import Sections, base_name, describe_changes, refuse_changes, sections_of
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError


def test_a_base_name_has_no_namespace() -> None:
    assert base_name(LocalBus().node("alert_system", namespace="fleet/robot1")) == "alert_system"


def test_parameters_that_are_fixed_at_the_start_cannot_change() -> None:
    refuse_changes({"robot_name": "robot1"}, {"robot_name": "robot1", "ops": "", "signals": {}})
    with pytest.raises(ConfigError, match=r"^robot_name: can only be set at the start$") as refused:
        refuse_changes({"robot_name": "robot1"}, {"robot_name": "robot2", "sensors": "host"})
    assert [error.path for error in refused.value.all] == [("robot_name",), ("sensors",)]


def test_the_log_level_and_what_a_node_can_change_may_change() -> None:
    refuse_changes({}, {"log_level": "DEBUG", "sensors": "host"}, except_for=("sensors",))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ({}, {}, "nothing changed"),
        ({"": {"rate": 1.0}}, {"": {"rate": 1.0}}, "nothing changed"),
        ({"": {"rate": 1.0}}, {"": {"rate": 2.5}}, "rate: 1 -> 2.5"),
        ({"wheel": {"warn_above": None}}, {"wheel": {"warn_above": 3.0}}, "wheel.warn_above: none -> 3"),
        ({"wheel": {"latch": False}}, {"wheel": {"latch": True}}, "wheel.latch: false -> true"),
        ({"wheel": {"unit": ""}}, {"wheel": {"unit": "m/s"}}, 'wheel.unit: "" -> m/s'),
        ({"wheel": {"placeholders": ()}}, {"wheel": {"placeholders": (0.0,)}}, "wheel.placeholders: [] -> [0]"),
        ({"wheel": {"rate": 1}}, {"wheel": {}}, "wheel.rate: 1 -> none"),
        ({"imu": {}}, {"wheel": {}}, "added wheel; removed imu"),
    ],
)
def test_a_change_is_described_by_its_old_and_new_value(old: Sections, new: Sections, text: str) -> None:
    assert describe_changes(old, new) == text


def test_the_sections_of_alert_system_are_its_signals_and_its_own_values() -> None:
    config = load_config({"publish_rate": 2.0, "signals": {"a": {"warn_below": 5.0}, "b": {}}})
    sections = sections_of(config, log_level="INFO")
    assert list(sections) == ["", "a", "b"]
    assert sections[""] == {"publish_rate": 2.0, "show": (), "log_level": "INFO"}
    assert (sections["a"]["warn_below"], sections["b"]["warn_below"]) == (5.0, None)
