"""The text of `--help` of the ROS executables; it needs neither ROS nor a master."""

from __future__ import annotations

import textwrap
from typing import Mapping

_USAGE: Mapping[str, str] = {
    "ROS 1": "rosrun robot_health_monitor {0} [_PARAMETER:=VALUE ...] [NAME:=NEW_NAME ...] [__name:=NODE]",
    "ROS 2": "ros2 run robot_health_monitor {0} [--ros-args [-p PARAMETER:=VALUE ...] [--params-file FILE] "
    "[-r NAME:=NEW_NAME ...]]",
}
_PURPOSE: Mapping[str, str] = {
    "battery_sensor": "Publishes battery_level, temperature and cpu_usage, simulated or of this host.",
    "aggregator": "Publishes system_health, the average of its inputs while all of them are fresh.",
    "alert_system": "Judges every configured signal; publishes alerts and /diagnostics. Services: ~reset clears "
    "latched alerts, ~reload (ROS 1) reads the parameters again.",
    "health_monitor": "Runs alert_system, aggregator and battery_sensor in one process. Each reads the parameters of "
    "its own name.",
}
_END = (
    "docs/reference/parameters.md describes the parameters. Exit codes: 0 ended by a signal or by ROS, 2 unusable "
    "configuration, 3 failed."
)


def help_text(executable: str, ros: str) -> str:
    """Returns the text for an executable of `ROS 1` or `ROS 2`."""
    texts = (f"usage: {_USAGE[ros].format(executable)}", _PURPOSE[executable], _END)
    return "\n\n".join(textwrap.fill(text, 100, break_on_hyphens=False) for text in texts) + "\n"
