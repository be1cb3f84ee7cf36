from __future__ import annotations

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.core.nodes.identity import base_name, refuse_change


def test_a_base_name_has_no_namespace() -> None:
    assert base_name(LocalBus().node("alert_system", namespace="fleet/robot1")) == "alert_system"


def test_a_parameter_that_is_fixed_at_the_start_cannot_change() -> None:
    refuse_change("robot_name", "robot1", "robot1")
    with pytest.raises(ConfigError, match=r"^robot_name: can only be set at the start$"):
        refuse_change("robot_name", "robot1", "robot2")
