"""The text of `--help` of the ROS executables; it needs neither ROS nor a master."""

from __future__ import annotations

import textwrap
from typing import Iterable, Iterator, List, Mapping, Tuple

from ..core.config.monitor_config import MONITOR_PARAMETERS, NODE_PARAMETERS
from ..core.config.parameters import Parameter
from ..core.nodes.aggregator import AGGREGATOR_PARAMETERS
from ..core.nodes.battery_sensor import SENSOR_PARAMETERS
from ..core.sensors.configuration import METRICS

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

_Row = Tuple[str, str]
_WIDTH, _COLUMN = 100, 22


def help_text(executable: str, ros: str) -> str:
    """Returns the text for an executable of `ROS 1` or `ROS 2`."""
    below = "/" if ros == "ROS 1" else "."  # between the keys of a parameter's name
    own: Mapping[str, List[_Row]] = {
        "battery_sensor": [
            *_rows(SENSOR_PARAMETERS),
            *((f"{metric}{below}KEY", "source of the metric and its values") for metric in METRICS),
        ],
        "aggregator": list(_rows(AGGREGATOR_PARAMETERS)),
        "alert_system": [
            (f"signals{below}NAME{below}KEY", "a signal and its bounds, usually from a thresholds.yaml"),
            *_rows(MONITOR_PARAMETERS),
        ],
        "health_monitor": [],
    }
    lines = [*_wrapped(f"usage: {_USAGE[ros].format(executable)}", 7), "", *_wrapped(_PURPOSE[executable], 0)]
    lines += ["", "parameters (docs/reference/parameters.md has all of them):"]
    for name, meaning in [*own[executable], *_rows(NODE_PARAMETERS, common=True)]:
        lines += _wrapped(f"  {name:<{_COLUMN}} {meaning}", _COLUMN + 3)
    lines += ["", "exit codes: 0 ended by a signal or by ROS, 2 unusable configuration, 3 failed"]
    return "\n".join(lines) + "\n"


def _wrapped(text: str, indent: int) -> List[str]:
    return textwrap.wrap(text, _WIDTH, subsequent_indent=" " * indent, break_on_hyphens=False)


def _rows(parameters: Iterable[Parameter], *, common: bool = False) -> Iterator[_Row]:
    """Yields the rows of a table's own parameters, or of those common to all nodes."""
    for parameter in parameters:
        if (parameter in NODE_PARAMETERS) is common:
            # Without a default, or with 0 or an empty one, the description says what that means.
            default = f" (default {_shown(parameter.default)})" if parameter.default else ""
            yield parameter.name, parameter.description + default


def _shown(default: object) -> str:
    if isinstance(default, tuple):
        return ", ".join(default)
    return f"{default:g}" if isinstance(default, float) else str(default)
