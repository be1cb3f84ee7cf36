"""A policy for SROS2 (https://design.ros2.org/articles/ros2_access_control_policies.html) from what the nodes use.

The nodes are started on a bus without others, with the configuration of the robot; what they advertise and subscribe
to there is what they do on ROS 2. rclpy adds its own topics and services.
"""

from __future__ import annotations

from typing import Dict, Iterator, Mapping, NamedTuple, Set, Tuple
from xml.sax.saxutils import escape, quoteattr

from ...core.config import find_section, sections
from ...core.nodes import Aggregator, AlertSystem, BatterySensor
from ...core.nodes.aggregator import has_inputs
from ...core.port import LocalBus, NodeInfo
from ...core.values import ConfigError, JsonObject, package_version
from ..configuration import OpsConfig, ServerOptions
from .prometheus import filled

Permissions = Dict[Tuple[str, str], Set[str]]
"""Absolute names, or patterns, by the element of the policy and its attribute: `("topic", "publish")`."""

RCLPY_PUBLISHES = ("/parameter_events", "/rosout")
RCLPY_SUBSCRIBES = ("/clock",)
RCLPY_SERVES = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
"""Below the node's name; get_type_description only with `start_type_description_service`, or for `BRIDGE`."""
PROBE = "_executor_probe"
"""Topic below the node's name with which ros2/process.py tests the executor, at the start only."""
BRIDGE = "rosbridge"
"""The node that a rosbridge server serves."""
_EVERYTHING = "/*"


class Robot(NamedTuple):
    """How the nodes are started: the launch arguments that change names."""

    namespace: str = ""
    sensors: str = "simulated"
    remap: Mapping[str, str] = {}
    ops: OpsConfig = OpsConfig()


def export_policy(tree: JsonObject, robot: Robot, enclave: str = "") -> str:
    """Returns the policy in XML for the thresholds.yaml `tree`; raises ConfigError as the nodes do.

    All nodes share one enclave, because one launch file starts them: `health_monitor` in the namespace if `enclave` is
    empty.
    """
    path = enclave or "/".join(["", *filter(None, [robot.namespace.strip("/")]), "health_monitor"])
    profiles = [line for each in permissions_of(tree, robot).items() for line in _profile(*each)]
    fields = {"VERSION": package_version(), "ENCLAVE": quoteattr(path), "PROFILES": "\n".join(profiles)}
    return filled("sros2.xml", fields)


def permissions_of(tree: JsonObject, robot: Robot) -> dict[str, Permissions]:
    """Returns what each node needs, by its full name."""
    permissions: dict[str, Permissions] = {
        name: {
            ("topic", "publish"): {*info.publishes, *RCLPY_PUBLISHES, f"{name}/{PROBE}"},
            ("topic", "subscribe"): {*info.subscribes, *RCLPY_SUBSCRIBES, f"{name}/{PROBE}"},
            ("service", "reply"): {*info.services, *(f"{name}/{service}" for service in RCLPY_SERVES)},
        }
        for name, info in _used(tree, robot).items()
    }
    alert_system = next(name for name in permissions if name.endswith("/alert_system"))
    if robot.ops.black_box is not None:
        permissions[alert_system]["topic", "subscribe"].update(robot.ops.black_box.topics)
    if robot.ops.server is not None:
        namespace = alert_system.rpartition("/")[0]
        permissions[f"{namespace}/{BRIDGE}"] = _bridge(robot.ops.server, f"{namespace}/{BRIDGE}", alert_system)
    return permissions


def _used(tree: JsonObject, robot: Robot) -> Mapping[str, NodeInfo]:
    """Returns what each node uses besides what rclpy adds, from nodes that are started and closed again."""
    bus = LocalBus()
    by_name = {section.node: section for section in sections(tree)}
    by_name["alert_system"] = find_section(tree, "alert_system")
    for name, start in (("alert_system", AlertSystem), ("aggregator", Aggregator), ("battery_sensor", BatterySensor)):
        section = by_name.get(name)
        given = {"sensors": robot.sensors, **(section.tree if section else {})}
        if (name == "battery_sensor" and given["sensors"] == "none") or (
            name == "aggregator" and not has_inputs(given)
        ):
            continue
        middleware = bus.node(name, namespace=robot.namespace, parameters=given, remap=robot.remap)
        try:
            start(middleware)
        except ConfigError as error:
            raise (error.below(section.path) if section else error) from None
    return bus.graph().nodes


def _bridge(server: ServerOptions, name: str, alert_system: str) -> Permissions:
    """Returns what the clients of the server may do: read everything, and what ops.yaml allows."""
    return {
        ("topic", "publish"): {*RCLPY_PUBLISHES, *map(_absolute, server.allow_publish)},
        ("topic", "subscribe"): {_EVERYTHING},
        ("service", "reply"): {*(f"{name}/{service}" for service in RCLPY_SERVES), *map(_absolute, server.allow_offer)},
        ("service", "request"): {f"{alert_system}/reset", *map(_absolute, server.allow_call)},
    }


def _absolute(pattern: str) -> str:
    return pattern if pattern.startswith("/") else f"/{pattern}"


def _profile(name: str, permissions: Permissions) -> Iterator[str]:
    """Yields the lines of one node; all names are absolute."""
    namespace, _, base = name.rpartition("/")
    yield f"        <profile ns={quoteattr(namespace or '/')} node={quoteattr(base)}>"
    for (kind, verb), names in permissions.items():
        yield f'          <{kind}s {verb}="ALLOW">'
        yield from (f"            <{kind}>{escape(each)}</{kind}>" for each in sorted(names))
        yield f"          </{kind}s>"
    yield "        </profile>"
