"""`robot-health init`: a first thresholds.yaml from a live robot, over ROS 1, ROS 2 or a bridge."""

from __future__ import annotations

import argparse
import asyncio
import importlib.util
import os
import sys
import time
from contextlib import closing, contextmanager, suppress
from functools import partial
from typing import Any, Callable, Container, ContextManager, Iterator, Mapping, NamedTuple

from ...core.config import MonitorConfig, load_config
from ...core.messages import definition, parse_definition
from ...core.port import NodeInfo, ServedMiddleware
from ...core.proposal.candidates import Candidates, Topic, absolute
from ...core.proposal.nodes import Nodes
from ...core.proposal.proposal import Proposed, propose
from ...core.proposal.suggestion import LEAST_RANGE_S
from ...core.proposal.thresholds_file import thresholds_text
from ...core.values import (
    ConfigError,
    LinkError,
    ServiceError,
    canonical_type,
    count_text,
    duration_text,
    list_text,
    matches_pattern,
)
from ...runtime.interrupts import Interrupts
from ...runtime.libraries import ROSBRIDGE, libraries
from ..arguments import Parser, add, add_robot_server, seconds
from ..output.lines import ProgressLine

_USUAL_S = 60.0
_LIST_PERIOD_S = 2.0
"""Topics are listed again: discovery takes its time, and nodes may start late."""
_CONNECT_S = 10.0
_NAME = "robot_health_init"
_BY_OPTION = (
    "choose one of two with --ros1 or --ros2, or give the URL of the robot's bridge: robot-health init ws://robot:9090 "
    "(or foxglove://robot:8765)"
)
_COMMENTED = (
    "Numbers without a rule get bounds after 10 minutes (`--seconds 660`): until then, what was seen is a comment."
)
Graph = Mapping[str, NodeInfo]
"""Nodes by their names."""


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Listens to a live robot, and writes a commented thresholds.yaml to stdout: for the arrivals of every periodic "
        "topic, the age of stamps, batteries, temperatures, /diagnostics, frames, errors in the log, and the nodes "
        "that publish all that. Started with the result, the same robot raises no alert. Nothing is published on the "
        "robot. An interrupt ends the listening early."
    )
    add(
        parser,
        "[URL]",
        "bridge of the robot: ws://host:port or host:port (rosbridge), wss://host:port, foxglove://host:port "
        "(default: the ROS that is sourced here)",
    )
    meaning = f"how long to listen (default: {_USUAL_S:g})"
    add(parser, "--seconds SECONDS", meaning, type=seconds, default=_USUAL_S)
    add(parser, "--ros1", "listen over ROS 1, if both are there")
    add(parser, "--ros2", "listen over ROS 2, if both are there")
    add(parser, "--against FILE", "write only what the robot has and this thresholds.yaml does not watch")
    add_robot_server(parser, "robot's")
    parser.check = _check


def _check(arguments: argparse.Namespace) -> str:
    chosen = bool(arguments.url) + arguments.ros1 + arguments.ros2
    return "expected one of URL, --ros1 and --ros2" if chosen > 1 else ""


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Writes the thresholds. Raises ServiceError if there is nothing to watch."""
    namespace = arguments.namespace.strip("/")
    watched = load_config(arguments.against) if arguments.against else None
    candidates = Candidates(namespace, watched.signals if watched else (), ages_of_bulk=not arguments.url)
    nodes, progress = Nodes(), ProgressLine()

    def heard() -> str:
        return f"{count_text(len(candidates.topics), 'topic')}, {count_text(candidates.samples, 'message')}"

    def show(listened_s: float) -> None:
        progress.show(f"listening: {listened_s:.0f} of {arguments.seconds:g} s, {heard()}; Ctrl-C to end")

    name, opened = _choose_robot(arguments, interrupts)
    try:
        with opened as robot:
            listened_s = _listen(robot, candidates, nodes, arguments.seconds, interrupts, show)
    finally:
        progress.clear()
    proposed = propose(candidates)
    lasted = duration_text(listened_s)
    if not proposed.signals:
        more = f" ({proposed.reasons})" if proposed.not_watched else ""
        if candidates.samples and listened_s < LEAST_RANGE_S:
            more += "; --seconds 660 listens longer"
        raise ServiceError(f"nothing to watch on {name}: {heard()} in {lasted}{more}")
    nodes.add_to(proposed, candidates)
    if watched is not None:
        _remove_watched(proposed, watched, namespace)
    interrupted = ", interrupted" if listened_s < arguments.seconds else ""
    heading = [f"Written by `robot-health init` after listening to {name} for {lasted}{interrupted}: {heard()}."]
    if watched is not None:
        heading.append(f"Only what {arguments.against} does not watch.")
    if listened_s < LEAST_RANGE_S:
        heading.append(_COMMENTED)
    heading.append("docs/statistics.md explains how each value is computed. Review before use.")
    sys.stdout.write(thresholds_text(heading, {}, proposed))


class _Robot(NamedTuple):
    """A live robot, on whichever middleware."""

    node: Any
    """The node that listens."""
    look: Callable[[Container[str]], tuple[list[Topic], Graph]]
    """Returns the topics that are not known yet, and the nodes. Raises LinkError or ServiceError if the robot does not
    answer."""
    run: Callable[[Callable[[], object]], object]
    """Calls a function while no callback of the node runs."""


def _choose_robot(arguments: argparse.Namespace, interrupts: Interrupts) -> tuple[str, ContextManager[_Robot]]:
    """Returns the name of the robot, and what opens it."""
    if not arguments.url:
        ros = choose_ros("ros1" if arguments.ros1 else "ros2" if arguments.ros2 else "")
        return f"ROS {ros[-1]}", _ros_robot(ros, interrupts)
    with libraries(*ROSBRIDGE):
        from .. import fleet  # noqa: F401 - names what is missing

    from ...runtime.tokens import TokenFiles
    from ..fleet_configuration import Options, read_addresses, read_robots

    options = Options(token_file=arguments.robot_token_file, ca=arguments.ca)
    tokens = TokenFiles(partial(print, file=sys.stderr))
    (robot,) = read_robots(read_addresses([arguments.url]), "", options, tokens)
    return robot.name, _bridged_robot(robot.url, interrupts, token=robot.token, ssl_context=robot.ssl_context)


def choose_ros(wanted: str) -> str:
    """Returns `ros1` or `ros2`: `wanted` if it is not empty, else the one that is sourced here.

    Raises ConfigError if it is not there, or if both are and none is wanted.
    """
    here = [ros for ros, module in (("ros1", "rospy"), ("ros2", "rclpy")) if importlib.util.find_spec(module)]
    sourced = wanted or f"ros{os.environ.get('ROS_VERSION', '')}"
    if sourced in here:
        return sourced
    if wanted or len(here) != 1:
        listed = list_text(here) or "none"
        raise ConfigError(f"expected {wanted or 'one ROS'} that is sourced here, got {listed}; {_BY_OPTION}")
    return here[0]


def _listen(
    robot: _Robot,
    candidates: Candidates,
    nodes: Nodes,
    wanted_s: float,
    interrupts: Interrupts,
    show: Callable[[float], None],
) -> float:
    """Listens to a robot; returns for how long, in s: less than `wanted_s` if it was interrupted.

    Raises LinkError if there is no connection, ServiceError if topics are not listed or there is no ROS time.
    """

    def take(topics: list[Topic], graph: Graph) -> None:
        candidates.add(topics)
        candidates.listen(robot.node, {each.topic for each in topics})
        nodes.take(graph)

    looked = robot.look(())
    start_s = time.monotonic()
    robot.run(partial(nodes.begin, robot.node))
    with suppress(KeyboardInterrupt):
        while True:
            robot.run(partial(take, *looked))
            listened_s = time.monotonic() - start_s
            if listened_s >= wanted_s:
                if robot.node.now_s() == 0.0:
                    raise ServiceError("use_sim_time is set, and there is no message on /clock: no ROS time")
                return wanted_s
            show(listened_s)
            interrupts.wait_until(partial(_is_past, start_s + min(wanted_s, listened_s + _LIST_PERIOD_S)))
            looked = robot.look(candidates.topics)
    return time.monotonic() - start_s


@contextmanager
def _ros_robot(ros: str, interrupts: Interrupts) -> Iterator[_Robot]:
    """Yields the robot whose ROS is sourced here (`ros1`, `ros2`); raises LinkError if no ROS master answers."""
    process: Any
    name = f"{_NAME}_{os.getpid()}"
    if ros == "ros1":
        from ...ros1.master import Master
        from ...ros1.process import Ros1Process

        master = Master(f"/{_NAME}")
        if not master.is_online():  # a node would wait for it
            raise LinkError(f"no ROS master at {master.uri} (ROS_MASTER_URI)")
        process = Ros1Process(name, interrupts)
    else:
        from ...ros2.process import Ros2Process

        process = Ros2Process(interrupts)
    with closing(process):
        process.start()
        node = process.create_listener(name)

        def look(known: Container[str]) -> tuple[list[Topic], Graph]:
            graph = node.graph()
            topics = [
                _topic(topic, type_name, _definition(node, type_name), is_ros1=ros == "ros1")
                for topic, type_name in graph.topics.items()
                if topic not in known and not topic.startswith(f"/{name}/")  # its own
            ]
            return topics, {each: info for each, info in graph.nodes.items() if each != node.name}

        yield _Robot(node, look, node.exclusively)


@contextmanager
def _bridged_robot(url: str, interrupts: Interrupts, **options: Any) -> Iterator[_Robot]:
    """Yields the robot behind a bridge; `options` are further ones of `bridge_client`, which runs in a thread."""
    from ...runtime.event_loops import LoopThread
    from ..fleet import bridge_client

    interrupts.defer()
    causes: list[str] = []
    """Why the connection is down, after each change."""
    loop = LoopThread(_NAME)

    async def connect() -> tuple[Any, Any, Any]:
        client = bridge_client(url, on_link=lambda up, why: causes.append(why.text), on_log=lambda _: None, **options)
        return client, client.node(_NAME), asyncio.ensure_future(client.run())

    async def call(function: Callable[[], object]) -> object:
        return function()

    client, node, _running = loop.call(connect())

    def look(known: Container[str]) -> tuple[list[Topic], Graph]:
        late_s = time.monotonic() + _CONNECT_S
        interrupts.wait_until(lambda: client.connection.up or bool(causes) or _is_past(late_s))
        if not client.connection.up:
            cause = [f"no answer within {_CONNECT_S:g} s", *causes][-1]
            raise LinkError(f"no connection to {client.connection.address}: {cause}")
        listed = loop.call(client.known_topics())
        topics = [
            _topic(each.topic, each.type_name, each.definition, each.form) for each in listed if each.topic not in known
        ]
        nodes: Graph = {}
        if topics:  # it is a call for each topic
            with suppress(ServiceError):  # an old rosapi
                nodes = loop.call(client.known_nodes([each.topic for each in listed]))
        return topics, nodes

    try:
        yield _Robot(node, look, lambda function: loop.call(call(function)))
    finally:
        loop.close()


def _is_past(time_s: float) -> bool:
    return time.monotonic() >= time_s


def _definition(node: ServedMiddleware, type_name: str) -> str:
    """Returns the definition of an installed type, empty for others."""
    try:
        return node.raw_format(canonical_type(type_name)).schema
    except ConfigError:
        return ""


def _topic(topic: str, type_name: str, text: str, form: str = "msg", *, is_ros1: bool = False) -> Topic:
    """Returns a topic with the types in a definition; without one that can be used, its arrivals can be watched."""
    kind = canonical_type(type_name)
    try:
        return Topic(topic, kind, parse_definition(kind, text or definition(kind), form, is_ros1=is_ros1))
    except (ConfigError, ValueError):
        return Topic(topic, kind, None)


def _remove_watched(proposed: Proposed, config: MonitorConfig, namespace: str) -> None:
    """Removes the signals whose topic and field a configuration watches, and the remarks about topics that it does."""
    watched: list[tuple[str, str]] = []
    """Topics or parts of the graph, as signals that are proposed have them, and their fields."""
    for signal in config.signals.values():
        watched += [(absolute(topic, namespace), signal.field) for topic in signal.topics]
        if signal.graph is not None:
            key, name = signal.graph
            watched.append((f"{key} {absolute(name, namespace)}", signal.field))
    proposed.signals = [
        each
        for each in proposed.signals
        if not any(
            topic == each.topic and matches_pattern(each.given.get("field", "data"), field) for topic, field in watched
        )
    ]
    for topic, _ in watched:
        proposed.not_watched.pop(topic, "")
