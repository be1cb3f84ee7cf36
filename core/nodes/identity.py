"""Code shared by the nodes: topic names and types, names of hosts and nodes, parameters that are fixed at the start."""

from __future__ import annotations

import os
from typing import Any, Mapping, Tuple

from ..config import NODE_PARAMETERS
from ..errors import ConfigError, Problems
from ..middleware import Middleware

FLOAT_TYPE = "std_msgs/Float32"
STRING_TYPE = "std_msgs/String"
LOG_LEVEL = "log_level"
DIAGNOSTICS = "/diagnostics"
UNAVAILABLE_SENSORS = "unavailable_sensors"
"""Topic on which battery_sensor lists the metrics that its host has no sensor for, separated by commas.

alert_system does not wait for their samples: a desktop without a battery is not a robot whose battery fell silent.
"""

SIMULATED_SENSORS = "simulated_sensors"
"""Topic on which battery_sensor lists the topics of its simulated metrics, separated by commas.

They are judged like all others, but cause no notification unless a target asks for them.
"""


def host_name() -> str:
    """Returns the name of this host: the name of a robot that has none."""
    return os.uname().nodename  # as platform.node(), whose module takes memory in every node


def base_name(middleware: Middleware) -> str:
    """Returns the node's name without its namespace."""
    return middleware.name.rpartition("/")[2]


def refuse_changes(old: Mapping[str, Any], new: Mapping[str, Any], *, except_for: Tuple[str, ...] = ()) -> None:
    """Rejects changes of the common parameters that are fixed at the start: all but `log_level`.

    Args:
        old: the configuration in force.
        new: the proposed one.
        except_for: names of further parameters that the node can change.

    Raises:
        ConfigError: they differ in such parameters.
    """
    problems = Problems()
    for parameter in NODE_PARAMETERS:
        name, default = parameter.name, parameter.default
        if name not in (LOG_LEVEL, *except_for) and new.get(name, default) != old.get(name, default):
            problems.add(ConfigError("can only be set at the start", (name,)))
    problems.raise_if_any()
