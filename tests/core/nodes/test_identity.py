from __future__ import annotations

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.core.nodes.identity import base_name, refuse_changes


def test_a_base_name_has_no_namespace() -> None:
    assert base_name(LocalBus().node("alert_system", namespace="fleet/robot1")) == "alert_system"


def test_parameters_that_are_fixed_at_the_start_cannot_change() -> None:
    refuse_changes({"robot_name": "robot1"}, {"robot_name": "robot1", "ops": "", "signals": {}})
    with pytest.raises(ConfigError, match=r"^robot_name: can only be set at the start$") as refused:
        refuse_changes({"robot_name": "robot1"}, {"robot_name": "robot2", "sensors": "host"})
    assert [error.path for error in refused.value.all] == [("robot_name",), ("sensors",)]


def test_the_log_level_and_what_a_node_can_change_may_change() -> None:
    refuse_changes({}, {"log_level": "DEBUG", "sensors": "host"}, except_for=("sensors",))
