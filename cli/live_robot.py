"""Listens to a live robot for `robot-health init`: over ROS 1, ROS 2 or a bridge."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import time
from contextlib import closing, contextmanager, suppress
from functools import partial
from typing import Any, Callable, Container, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ..core.messages.definitions import Definitions, parse_definition
from ..core.messages.standard_messages import definition
from ..core.port.middleware import NodeInfo, ServedMiddleware
from ..core.proposal.candidates import Topic
from ..core.proposal.nodes import Nodes
from ..core.proposal.proposal import Proposal
from ..core.values.errors import ConfigError, LinkError, ServiceError
from ..core.values.names import canonical_type
from ..runtime.interrupts import Interrupts

_LIST_PERIOD_S = 2.0
"""Topics are listed again: discovery takes its time, and nodes may start late."""
_CONNECT_S = 10.0
_NAME = "robot_health_init"

OnProgress = Callable[[float], object]
"""Called now and then with the time that was listened, in s."""


def choose_ros(wanted: str) -> str:
    """Returns `ros1` or `ros2`: `wanted` if it is not empty, else the one that is sourced here.

    Raises ConfigError if it is not there, or if both are and none is wanted.
    """
    modules = {"ros1": "rospy", "ros2": "rclpy"}
    here = [ros for ros in modules if wanted in ("", ros) and importlib.util.find_spec(modules[ros])]
    if not here:
        missing = f"--{wanted}: ROS {wanted[-1]} is not" if wanted else "neither ROS 1 nor ROS 2 is"
        raise ConfigError(f"{missing} sourced here; {_BY_URL}")
    sourced = f"ros{os.environ.get('ROS_VERSION', '')}"
    if len(here) > 1 and sourced not in here:
        raise ConfigError("both ROS 1 and ROS 2 are here: choose one with --ros1 or --ros2")
    return sourced if sourced in here else here[0]


_BY_URL = (
    "without ROS, give the URL of the robot's bridge: robot-health init ws://robot:9090 (or foxglove://robot:8765)"
)


class Robot(NamedTuple):
    """A live robot, on whichever middleware."""

    node: Any
    """The node that listens."""
    look: Callable[[Container[str]], Tuple[List[Topic], Mapping[str, NodeInfo]]]
    """Returns the topics that are not known yet, and the nodes. Raises LinkError or ServiceError if the robot does not
    answer."""
    run: Callable[[Callable[[], object]], object]
    """Calls a function while no callback of the node runs."""


def listen(
    robot: Robot, proposal: Proposal, nodes: Nodes, seconds: float, interrupts: Interrupts, on_progress: OnProgress
) -> Tuple[float, bool]:
    """Listens to a robot; returns for how long, in s, and whether it was not interrupted.

    Raises LinkError if there is no connection, ServiceError if topics are not listed or there is no ROS time.
    """
    start_s: Optional[float] = None
    try:
        while True:
            topics, of_graph = robot.look(proposal.candidates.topics)
            if start_s is None:
                start_s = time.monotonic()
                robot.run(partial(nodes.begin, robot.node))
            robot.run(partial(_take, proposal, nodes, robot.node, topics, of_graph))
            listened_s = time.monotonic() - start_s
            if listened_s >= seconds:
                if robot.node.now_s() == 0.0:
                    raise ServiceError("use_sim_time is set, and there is no message on /clock: no ROS time")
                return seconds, True
            on_progress(listened_s)
            next_s = start_s + min(seconds, listened_s + _LIST_PERIOD_S)
            interrupts.wait_until(partial(_is_past, next_s))
    except KeyboardInterrupt:
        return time.monotonic() - (start_s or time.monotonic()), False


@contextmanager
def ros_robot(ros: str, interrupts: Interrupts) -> Iterator[Robot]:
    """Yields the robot whose ROS is sourced here (`ros1`, `ros2`); raises LinkError if no ROS master answers."""
    process: Any
    name = f"{_NAME}_{os.getpid()}"
    if ros == "ros1":
        from ..ros1.master import Master
        from ..ros1.process import Ros1Process

        master = Master(f"/{_NAME}")
        if not master.is_online():  # a node would wait for it
            raise LinkError(f"no ROS master at {master.uri} (ROS_MASTER_URI)")
        process = Ros1Process(name, interrupts)
    else:
        from ..ros2.process import Ros2Process

        process = Ros2Process(interrupts)
    byte = "int8" if ros == "ros1" else "uint8"
    with closing(process):
        process.start()
        node = process.create_listener(name)

        def look(known: Container[str]) -> Tuple[List[Topic], Mapping[str, NodeInfo]]:
            graph = node.graph()
            new = {
                topic: canonical_type(found)
                for topic, found in graph.topics.items()
                if topic not in known and not topic.startswith(f"/{name}/")  # its own
            }
            topics = [Topic(topic, kind, _parsed(kind, _definition(node, kind), byte)) for topic, kind in new.items()]
            return topics, {each: info for each, info in graph.nodes.items() if each != node.name}

        yield Robot(node, look, node.exclusively)


@contextmanager
def bridged_robot(url: str, interrupts: Interrupts, **options: Any) -> Iterator[Robot]:
    """Yields the robot behind a bridge; `options` are further ones of `bridge_client`, which runs in a thread."""
    from ..runtime.event_loops import LoopThread
    from .fleet import bridge_client

    interrupts.defer()
    links: List[Any] = []
    """Whether the connection is up, and the cause if it is not, after each change."""
    loop = LoopThread(_NAME)

    async def connect() -> Tuple[Any, Any, Any]:
        def note_link(*link: Any) -> None:
            links.append(link)

        client = bridge_client(url, on_link=note_link, on_log=lambda line: None, **options)
        return client, client.node(_NAME), asyncio.ensure_future(client.run())

    async def call(function: Callable[[], object]) -> object:
        return function()

    client, node, running = loop.call(connect())

    def look(known: Container[str]) -> Tuple[List[Topic], Mapping[str, NodeInfo]]:
        if not links:
            late_s = time.monotonic() + _CONNECT_S
            interrupts.wait_until(lambda: bool(links) or _is_past(late_s))
        if not links or not links[-1][0]:
            cause = links[-1][1].text if links else f"no answer within {_CONNECT_S:g} s"
            raise LinkError(f"no connection to {client.connection.address}: {cause}")
        listed = loop.call(client.known_topics())
        topics = [
            Topic(each.topic, each.type_name, _parsed(each.type_name, each.definition, "uint8", each.form))
            for each in listed
            if each.topic not in known
        ]
        nodes: Mapping[str, NodeInfo] = {}
        if topics:  # it is a call for each topic
            with suppress(ServiceError):  # an old rosapi
                nodes = loop.call(client.known_nodes([each.topic for each in listed]))
        return topics, nodes

    try:
        yield Robot(node, look, lambda function: loop.call(call(function)))
    finally:
        loop.call(call(client.close))
        running.cancel()
        loop.close()


def _is_past(time_s: float) -> bool:
    return time.monotonic() >= time_s


def _take(
    proposal: Proposal, nodes: Nodes, node: Any, topics: Sequence[Topic], of_graph: Mapping[str, NodeInfo]
) -> None:
    proposal.candidates.add(topics)
    proposal.listen(node, {each.topic for each in topics})
    nodes.take(of_graph)


def _definition(node: ServedMiddleware, type_name: str) -> str:
    """Returns the definition of an installed type, empty for others."""
    try:
        return node.raw_format(type_name).schema
    except ConfigError:
        return ""


def _parsed(type_name: str, text: str, byte: str, form: str = "msg") -> Optional[Definitions]:
    """Returns the types in a definition, None if it is not known or cannot be used."""
    try:
        return parse_definition(type_name, text or definition(type_name), form, byte)
    except (ConfigError, ValueError):
        return None
