"""Changes of single parameters, as `ros2 param set` makes them, for middlewares that take whole trees."""

from __future__ import annotations

from robot_health_monitor.core.mapping_node import MappingNode
from robot_health_monitor.core.parameters import flatten, unflatten


def set_parameter(node: MappingNode, name: str, value: object) -> str:
    """Proposes one changed value, by its dotted name; see `MappingNode.set_parameters`."""
    return node.set_parameters(unflatten({**dict(flatten(node.given_parameters())), name: value}))
