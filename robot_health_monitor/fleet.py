"""Robots that are watched over rosbridge: one link and one alert_system per robot, all in one event loop."""

from __future__ import annotations

import asyncio
import re
import ssl
from typing import Callable, List, Mapping, NamedTuple, Optional, Sequence
from urllib.parse import urlsplit

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.model import Sample
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.outlets import Outlet
from robot_health_monitor.core.signal_monitor import LINK
from robot_health_monitor.core.yaml_file import YamlFile
from robot_health_monitor.rosbridge.client.middleware import RosbridgeClient

from .embedded import sections_of_nodes

_NAMED = re.compile(r"(?P<name>[\w.-]+)=(?P<url>.+)", re.ASCII)


class Address(NamedTuple):
    """Where a robot is found, and what it is called here."""

    name: str
    """The robot's name, which is also its `hardware_id`."""
    url: str
    """`ws://host:port` or `wss://host:port`."""


def read_addresses(texts: Sequence[str]) -> List[Address]:
    """Reads addresses as the command line takes them: `ws://husky:9090` or `NAME=ws://10.0.0.7:9090`.

    Without a name a robot is called as its host; with the port where two would be called the same.

    Raises:
        ConfigError: one is no address of a rosbridge server, or two robots have one name.
    """
    addresses: List[Address] = []
    for text in texts:
        named = _NAMED.fullmatch(text)
        name, url = (named["name"], named["url"]) if named else ("", text)
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError:
            host, port, parts = None, None, urlsplit("")
        if parts.scheme not in ("ws", "wss") or not host:
            raise ConfigError(
                f"found the address {text!r}, allowed is ws://host:port, wss://host:port or NAME=ws://..."
            )
        taken = {address.name for address in addresses}
        if not name:
            name = f"{host}:{port}" if host in taken and port else host
        if name in taken:
            raise ConfigError(f"found two robots called {name}; give them names: one=ws://... two=ws://...")
        addresses.append(Address(name, url))
    return addresses


class Robot:
    """One robot: its link, and the alert_system that judges what comes over it.

    The robot is not disturbed: nothing is published there and no service is offered.
    """

    def __init__(
        self,
        address: Address,
        parameters: Mapping[str, object],
        *,
        namespace: str,
        token: str,
        ssl_context: Optional[ssl.SSLContext],
        clock: Callable[[], float],
        on_log: Callable[[LogLine], None],
        outlet: Callable[[str], Outlet],
    ) -> None:
        """Starts the alert_system; the link comes up in `client.run`.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self.client = RosbridgeClient(
            address.url,
            token=token,
            ssl_context=ssl_context,
            read_only=True,
            clock=clock,
            on_log=lambda line: on_log(line._replace(node=address.name)),
            on_link=self._note_link,
        )
        self._node = self.client.node(
            "alert_system", namespace=namespace, parameters={**parameters, "robot_name": address.name}
        )
        self.alert_system = AlertSystem(self._node, {"output": outlet(address.name)}, log_alerts=False)

    def close(self) -> None:
        """Ends the alert_system."""
        self.client.close()

    def _note_link(self, up: bool) -> None:
        sample = Sample(LINK, 1.0 if up else 0.0, self._node.now_s())
        self._node.call(self.alert_system.observe, sample)


class Fleet:
    """Several robots, judged by one configuration."""

    faults: Optional[Faults] = None
    """Not shown: the monitor's own faults are per robot."""
    system_health: Optional[float] = None
    """There is no one number for several robots."""

    def __init__(
        self,
        addresses: Sequence[Address],
        file: Optional[YamlFile],
        *,
        namespace: str = "",
        token: str = "",
        ssl_context: Optional[ssl.SSLContext] = None,
        clock: Callable[[], float],
        on_log: Callable[[LogLine], None],
        outlet: Callable[[str], Outlet],
    ) -> None:
        """Makes the robots; `run` connects to them.

        Args:
            addresses: the robots.
            file: the configuration, whose section alert_system counts; None: the defaults.
            namespace: that of the robots' topics.
            token: shown to every server.
            ssl_context: for `wss://`; None trusts the system's certificate authorities.
            clock: the time in seconds.
            on_log: called with every log line; its node is the robot's name.
            outlet: returns the outlet for a robot's transitions and notices, by its name.

        Raises:
            ConfigError: the configuration cannot be used; the message names file and line.
        """
        section = None if file is None else sections_of_nodes(file)["alert_system"]
        self._clock = clock
        self._robots: List[Robot] = []
        for address in addresses:
            try:
                robot = Robot(
                    address,
                    {} if section is None else section.tree,
                    namespace=namespace,
                    token=token,
                    ssl_context=ssl_context,
                    clock=clock,
                    on_log=on_log,
                    outlet=outlet,
                )
            except ConfigError as error:
                if file is None or section is None:
                    raise
                raise file.locate(ConfigError(error.problem, (*section.path, *error.path))) from None
            self._robots.append(robot)

    @property
    def monitors(self) -> Sequence[Monitor]:
        """One monitor per robot."""
        return [robot.alert_system.monitor for robot in self._robots]

    @property
    def now_s(self) -> float:
        """The time in seconds."""
        return self._clock()

    async def run(self) -> None:
        """Keeps the links up until it is cancelled."""
        await asyncio.gather(*(robot.client.run() for robot in self._robots))

    def close(self) -> None:
        """Ends every alert_system."""
        for robot in self._robots:
            robot.close()
