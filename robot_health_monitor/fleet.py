"""Robots that are watched over rosbridge: one connection and one alert_system per robot, in one event loop."""

from __future__ import annotations

import asyncio
import re
import ssl
from typing import Callable, List, Mapping, NamedTuple, Optional, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.outlets import Outlet
from robot_health_monitor.core.yaml_file import YamlFile
from robot_health_monitor.rosbridge.client import Cause, RosbridgeClient
from robot_health_monitor.rosbridge.client.address import host_and_port, shown_address
from robot_health_monitor.rosbridge.client.log_limit import LogLimit

from .embedded import sections_of_nodes

__all__ = ["Address", "Fleet", "Robot", "read_addresses"]

_NAMED = re.compile(r"(?P<name>[\w.-]+)=(?P<url>.+)", re.ASCII)
_RESTART_S = 5.0
_SHOWN_CHARS = 100


class Address(NamedTuple):
    """A robot's name and where to connect."""

    name: str
    """The robot's name, which is also its `hardware_id`."""
    url: str
    """`ws://host:port` or `wss://host:port`."""


def read_addresses(texts: Sequence[str]) -> List[Address]:
    """Reads addresses as the command line takes them: `ws://husky:9090` or `NAME=ws://10.0.0.7:9090`.

    Without a name, a robot gets the name of its host, with the port if that name is taken.

    Raises:
        ConfigError: one is not the address of a rosbridge server, or two robots have the same name.
    """
    addresses: List[Address] = []
    for text in texts:
        named = _NAMED.fullmatch(text)
        name, url = (named["name"], named["url"]) if named else ("", text)
        try:
            host, port = host_and_port(url)
        except ConfigError:
            raise ConfigError(
                f"expected ws://host:port, wss://host:port or NAME=ws://..., got {shown_address(text)[:_SHOWN_CHARS]!r}"
            ) from None
        taken = {address.name for address in addresses}
        if not name:
            name = f"{host}:{port}" if host in taken and port else host
        if name in taken:
            raise ConfigError(f"two robots are named {name}; give them names: one=ws://... two=ws://...")
        addresses.append(Address(name, url))
    return addresses


class Robot:
    """One robot: its connection, and the alert_system that judges what arrives.

    Nothing is published and no service is offered on the robot.
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
        """Starts the alert_system; `run` connects.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self.name = address.name
        self.cause: Optional[Cause] = None
        """Why the connection is down; None while it is up and before the first attempt."""
        self._closed = False
        self._client = RosbridgeClient(
            address.url,
            token=token,
            ssl_context=ssl_context,
            read_only=True,
            clock=clock,
            on_log=lambda line: on_log(line._replace(node=address.name)),
            on_link=self._note_link,
        )
        self._log = LogLimit(self._client.log, clock)
        self._node = self._client.node(
            "alert_system",
            namespace=namespace,
            parameters={**parameters, "robot_name": address.name},
            use_sim_time=parameters.get("use_sim_time") is True,
        )
        self.alert_system = AlertSystem(self._node, {"output": outlet(address.name)}, log_alerts=False)
        self.alert_system.self_report["dropped"] = lambda: str(self._node.dropped)

    @property
    def now_s(self) -> float:
        """The time of the robot's monitor, in s: simulated time under `use_sim_time`."""
        return self._node.now_s()

    async def run(self) -> None:
        """Keeps the connection up until it is cancelled. A failure is logged, and the connection restarted."""
        while not self._closed:
            try:
                await self._client.run()
            except Exception as error:  # one robot's failure must not end the others
                text = printable(f"{type(error).__name__}: {error}")
                self._client.log(Severity.ERROR, f"internal error, reconnecting in {_RESTART_S:g} s: {text}")
                self._node.call(self._note_link, False, Cause(f"internal error: {type(error).__name__}"))
                await asyncio.sleep(_RESTART_S)

    def close(self) -> None:
        """Ends the alert_system and the connection."""
        self._closed = True
        self._client.close()

    def _note_link(self, up: bool, cause: Cause) -> None:
        if up:
            self.cause = None
            self._log.write("connected", Severity.INFO, f"connected to {self._client.connection.address}")
            # Under use_sim_time the robot's clock is unknown until its first message. Until then the link counts as
            # down: otherwise its first message would look like a jump of that many seconds without samples.
            self._node.call_with_time(self._observe_link)
        else:
            if self.cause is not None:  # the alert of the link shows the first cause
                self._log.write(cause.text, Severity.WARN, f"still not connected: {cause.text}")
            self.cause = cause
            self._node.call(self._observe_link)

    def _observe_link(self) -> None:
        self.alert_system.observe_link(self.cause is None, "" if self.cause is None else self.cause.text)


class Fleet:
    """Several robots, judged by one configuration."""

    faults: Optional[Faults] = None
    """Not shown: each robot has its own."""
    system_health: Optional[float] = None
    """Not defined for several robots."""

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
        """Creates the robots; `run` connects to them.

        Args:
            addresses: the robots.
            file: the configuration, of which the section alert_system is used; None: the defaults.
            namespace: namespace of the robots' topics.
            token: presented to every server; empty: none.
            ssl_context: for `wss://`; None trusts the system's certificate authorities.
            clock: monotonic seconds.
            on_log: called with every log line; its node is the robot's name.
            outlet: returns the outlet for a robot's transitions and notices, by its name.

        Raises:
            ConfigError: the configuration cannot be used; the message names file and line.
        """
        section = None if file is None else sections_of_nodes(file)["alert_system"]
        self.robots: List[Robot] = []
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
            self.robots.append(robot)

    @property
    def monitors(self) -> Sequence[Monitor]:
        """One monitor per robot."""
        return [robot.alert_system.monitor for robot in self.robots]

    @property
    def now_s(self) -> float:
        """The time of the robot whose clock is furthest behind, in s; simulated clocks may differ."""
        return min(robot.now_s for robot in self.robots)

    def check_own_faults(self) -> None:
        """Checks that no robot refuses this client.

        Raises:
            ConfigError: a robot cannot be reached until the configuration on this side is corrected.
        """
        for robot in self.robots:
            if robot.cause is not None and robot.cause.own_fault:
                raise ConfigError(f"{robot.name}: {robot.cause.text}")

    async def run(self) -> None:
        """Keeps the connections up until it is cancelled."""
        await asyncio.gather(*(robot.run() for robot in self.robots))

    def close(self) -> None:
        """Ends every robot's alert_system and connection."""
        for robot in self.robots:
            robot.close()
