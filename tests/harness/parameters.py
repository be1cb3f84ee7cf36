"""Changes of single parameters, as `ros2 param set` makes them, for middlewares that take whole trees."""

from __future__ import annotations

from robot_health_monitor.core.config.parameters import flatten, unflatten
from robot_health_monitor.core.port.mapping_node import MappingNode


def set_parameter(node: MappingNode, name: str, value: object) -> str:
    """Proposes one changed value, by its dotted name; see `MappingNode.set_parameters`."""
    return node.set_parameters(unflatten({**dict(flatten(node.given_parameters())), name: value}))
