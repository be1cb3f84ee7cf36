"""Listens to a live robot for `robot-health init`: over ROS 1, ROS 2 or a rosbridge server."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import ssl
import time
from contextlib import closing
from functools import partial
from typing import Any, Callable, Iterable, List, Optional, Tuple

from robot_health_monitor.core.definitions import Definitions, parse_definition
from robot_health_monitor.core.errors import ConfigError, LinkError, ServiceError
from robot_health_monitor.core.middleware import ServedMiddleware, canonical_type
from robot_health_monitor.core.proposal.candidates import Topic
from robot_health_monitor.core.proposal.proposal import Proposal
from robot_health_monitor.core.standard_messages import definition
from robot_health_monitor.runtime.interrupts import Interrupts

_LIST_PERIOD_S = 2.0
"""Topics are listed again: discovery takes its time, and nodes may start late."""
_CONNECT_S = 10.0
_NAME = "robot_health_init"

OnProgress = Callable[[float], object]
"""Called now and then with the time that was listened, in s."""


def choose_ros(wanted: str) -> str:
    """Returns `ros1` or `ros2`: the one that was requested (empty: none), or the one that is sourced here.

    Raises ConfigError: there is none, or both are there and none was requested.
    """
    here = [name for name, module in (("ros1", "rospy"), ("ros2", "rclpy")) if importlib.util.find_spec(module)]
    if wanted:
        if wanted not in here:
            raise ConfigError(f"--{wanted}: ROS {wanted[-1]} is not sourced here; {_BY_URL}")
        return wanted
    sourced = f"ros{os.environ.get('ROS_VERSION', '')}"
    if sourced in here:
        return sourced
    if not here:
        raise ConfigError(f"neither ROS 1 nor ROS 2 is sourced here; {_BY_URL}")
    if len(here) > 1:
        raise ConfigError("both ROS 1 and ROS 2 are here: choose one with --ros1 or --ros2")
    return here[0]


_BY_URL = "without ROS, give the URL of the robot's rosbridge server: robot-health init ws://robot:9090"


def listen_to_ros(
    ros: str, proposal: Proposal, seconds: float, interrupts: Interrupts, on_progress: OnProgress
) -> Tuple[float, bool]:
    """Listens over ROS 1 or ROS 2 (`ros1`, `ros2`); returns for how long, in s, and whether it was not interrupted.

    LinkError: no ROS master answers. ServiceError: there is no ROS time, so nothing could be measured.
    """
    process: Any
    if ros == "ros1":
        from robot_health_monitor.ros1.master import Master
        from robot_health_monitor.ros1.process import Ros1Process

        master = Master(f"/{_NAME}")
        if not master.is_online():  # a node would wait for it
            raise LinkError(f"no ROS master at {master.uri} (ROS_MASTER_URI)")
        process = Ros1Process(f"{_NAME}_{os.getpid()}", interrupts)
    else:
        from robot_health_monitor.ros2.process import Ros2Process

        process = Ros2Process(interrupts)
    byte = "int8" if ros == "ros1" else "uint8"
    with closing(process):
        process.start()
        name = f"{_NAME}_{os.getpid()}"
        node = process.create_listener(name)
        start_s = time.monotonic()
        try:
            while True:
                types = {
                    topic: canonical_type(found)
                    for topic, found in node.graph().topics.items()
                    if not topic.startswith(f"/{name}/")  # its own
                }
                new = {topic: found for topic, found in types.items() if topic not in proposal.topics}
                texts = {found: _definition(node, found) for found in set(new.values())}
                topics = [Topic(topic, found, _parsed(found, texts[found], byte)) for topic, found in new.items()]
                node.exclusively(partial(_take, proposal, node, topics))
                listened_s = time.monotonic() - start_s
                if listened_s >= seconds:
                    if node.now_s() == 0.0:
                        raise ServiceError("use_sim_time is set, and there is no message on /clock: no ROS time")
                    return seconds, True
                on_progress(listened_s)
                next_s = start_s + min(seconds, listened_s + _LIST_PERIOD_S)
                interrupts.wait_until(partial(_is_past, next_s))
        except KeyboardInterrupt:
            return time.monotonic() - start_s, False


def listen_over_rosbridge(
    url: str,
    token: str,
    ssl_context: Optional[ssl.SSLContext],
    proposal: Proposal,
    seconds: float,
    interrupts: Interrupts,
    on_progress: OnProgress,
) -> Tuple[float, bool]:
    """As `listen_to_ros`, over a rosbridge server. LinkError: no connection. ServiceError: it does not list topics."""
    return asyncio.run(_over_rosbridge(url, token, ssl_context, proposal, seconds, interrupts, on_progress))


async def _over_rosbridge(
    url: str,
    token: str,
    ssl_context: Optional[ssl.SSLContext],
    proposal: Proposal,
    seconds: float,
    interrupts: Interrupts,
    on_progress: OnProgress,
) -> Tuple[float, bool]:
    from robot_health_monitor.rosbridge.client.cause import Cause
    from robot_health_monitor.rosbridge.client.middleware import RosbridgeClient
    from robot_health_monitor.rosbridge.client.topics import list_topics

    loop = asyncio.get_running_loop()
    stop, changed = asyncio.Event(), asyncio.Event()
    link: List[Tuple[bool, Cause]] = []
    interrupts.on_interrupt(lambda: loop.call_soon_threadsafe(stop.set))

    def note_link(up: bool, cause: Cause) -> None:
        link.append((up, cause))
        changed.set()

    client = RosbridgeClient(
        url,
        token=token,
        ssl_context=ssl_context,
        read_only=True,
        on_link=note_link,
        on_log=lambda line: None,
    )
    node = client.node(_NAME)
    running = asyncio.ensure_future(client.run())
    try:
        await _first(stop, changed, _CONNECT_S)
        start_s = time.monotonic()
        while not stop.is_set():
            if not link or not link[-1][0]:
                cause = link[-1][1].text if link else f"no answer within {_CONNECT_S:g} s"
                raise LinkError(f"no connection to {client.connection.address}: {cause}")
            try:
                known = await list_topics(client.connection.calls.call)
            except ServiceError as error:
                raise ServiceError(
                    f"{client.connection.address} does not list its topics (no rosapi?): {error}"
                ) from None
            new = [each for each in known if each.topic not in proposal.topics]
            _take(
                proposal,
                node,
                [Topic(each.topic, each.type_name, _parsed(each.type_name, each.definition, "uint8")) for each in new],
            )
            listened_s = time.monotonic() - start_s
            if listened_s >= seconds:
                return seconds, True
            on_progress(listened_s)
            changed.clear()
            await _first(stop, changed, min(_LIST_PERIOD_S, seconds - listened_s))
        return time.monotonic() - start_s, False
    finally:
        client.close()
        running.cancel()
        await asyncio.wait({running}, timeout=1.0)


async def _first(stop: asyncio.Event, changed: asyncio.Event, timeout_s: float) -> None:
    """Waits until one of two events is set, or for a time."""
    waiting = [asyncio.ensure_future(event.wait()) for event in (stop, changed)]
    await asyncio.wait(waiting, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    for each in waiting:
        each.cancel()


def _is_past(time_s: float) -> bool:
    return time.monotonic() >= time_s


def _take(proposal: Proposal, node: Any, topics: Iterable[Topic]) -> None:
    found = list(topics)
    if found:
        proposal.take(found)
        proposal.listen(node, {each.topic for each in found})


def _definition(node: ServedMiddleware, type_name: str) -> str:
    """Returns the definition of an installed type, empty for others."""
    try:
        return node.raw_format(type_name).schema
    except ConfigError:
        return ""


def _parsed(type_name: str, text: str, byte: str) -> Optional[Definitions]:
    """Returns the types in a definition; None: it is not known, or cannot be used."""
    try:
        return parse_definition(type_name, text or definition(type_name), "msg", byte)
    except (ConfigError, ValueError):
        return None
