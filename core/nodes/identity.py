"""Code shared by the nodes: topic names and types, names of hosts and nodes, parameters that are fixed at the start."""

from __future__ import annotations

import os

from ..errors import ConfigError
from ..middleware import Middleware

FLOAT_TYPE = "std_msgs/Float32"
STRING_TYPE = "std_msgs/String"
DIAGNOSTICS = "/diagnostics"
UNAVAILABLE_SENSORS = "unavailable_sensors"
"""Topic on which battery_sensor lists the metrics that its host has no sensor for, separated by commas.

alert_system does not wait for their samples: a desktop without a battery is not a robot whose battery fell silent.
"""


def host_name() -> str:
    """Returns the name of this host: the name of a robot that has none."""
    return os.uname().nodename  # as platform.node(), whose module takes memory in every node


def base_name(middleware: Middleware) -> str:
    """Returns the node's name without its namespace."""
    return middleware.name.rpartition("/")[2]


def refuse_change(name: str, old: object, new: object) -> None:
    """Rejects the change of a parameter that is fixed at the start.

    Raises:
        ConfigError: `old` and `new` differ.
    """
    if new != old:
        raise ConfigError("can only be set at the start", (name,))
