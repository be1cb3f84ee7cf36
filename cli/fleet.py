"""Robots that are watched over bridges: one connection and one alert_system per robot, in one event loop.

fleet.yaml can be read again at any time (`reload`): only what differs is changed. What the robots' alert_systems
publish stays in this process, on `Fleet.bus`, from where a server can serve it; nothing is published on the robots.
"""

from __future__ import annotations

import asyncio
import re
import time
from typing import Any, Callable, Iterable, Mapping, Sequence

from ..core.nodes import AlertSystem
from ..core.nodes.node import DIAGNOSTICS, host_name, publish_statuses
from ..core.nodes.outlets import Outlet
from ..core.nodes.self_monitor import CHECK_PERIOD_S, SelfMonitor
from ..core.port import NOTHING_CHANGED, LimitedLog, LocalBus, LocalMiddleware, LogLine, Severity
from ..core.values import ARRAY_TYPE, Clock, ConfigError, count_text, list_text, printable
from ..foxglove import FoxgloveClient
from ..rosbridge.client import RosbridgeClient
from ..runtime.bridge.address import is_foxglove
from ..runtime.bridge.cause import Cause
from ..runtime.bridge.node import BridgeClient, BridgeNode
from ..runtime.event_loops import run_in_daemon_thread
from .embedded import run_timers
from .fleet_configuration import RobotSettings
from .operations import Operations

NODE = "connect"
"""Name of the node that reports on this process: its status on /diagnostics is `connect: monitor`."""

_START_PERIOD_S = 0.005
"""Between the first attempts of two robots: a fleet that connects at once would answer its own handshakes late."""
_RESTART_S = 5.0
_STARTED_ANEW = "started anew"
_MOST_NAMES = 5
"""Most robots that are named in a line about a reload."""


class Fleet:
    """All robots of one process."""

    server_config = None
    """No robot has parameters of the server."""
    alert_system_pattern = "/*/alert_system"
    """The full names of the alert_systems on `bus`; `*` as in file names."""

    def __init__(
        self,
        read: Callable[[], Sequence[RobotSettings]],
        operations: Operations,
        *,
        clock: Clock,
        on_log: Callable[[LogLine], None],
        outlet: Callable[[str], Outlet],
    ) -> None:
        """Creates the robots; `run` connects to them. Raises ConfigError if the configuration cannot be used.

        `read` reads the configuration, again at each reload. `operations` starts the alert_systems. `clock` gives
        monotonic s. `on_log` gets every log line; its node is the robot's name, or `connect`. So is the name for which
        `outlet` returns what receives transitions and notices.
        """
        self._read = read
        self.clock = clock
        self.outlet = outlet
        self._operations = operations
        self.start_alert_system = operations.start
        self.bus = LocalBus(on_log=on_log, wall_time_s=time.time, clock=clock)
        """Where the robots' alerts, statuses and `reset` services are: /alerts, /diagnostics, /ROBOT/alert_system."""
        self.node = self.bus.node(NODE)
        """The node whose faults and log are those of the process."""
        self.process_faults = self.node.faults.current
        """Returns what does not work in this process, besides the robots' own, by part."""
        self.node.advertise(DIAGNOSTICS, ARRAY_TYPE)
        self.robots: list[Robot] = []
        """The robots that are watched now, in the order of the configuration."""
        self._is_running = False
        self_report = {
            **operations.self_report(),
            "signals": self._count_signals,
            "robots": lambda: len(self.robots),
            "unreachable": lambda: sum(not robot.connected for robot in self.robots),
        }
        self._self_monitor = SelfMonitor(self.node, host_name(), outlet(NODE), self_report)
        self.node.create_timer(CHECK_PERIOD_S, self._check)
        try:
            self.apply(read())
        except ConfigError:
            self.close()
            raise
        robots, signals = count_text(len(self.robots), "robot"), count_text(self._count_signals(), "signal")
        self.node.log(Severity.INFO, f"watching {robots}, {signals}")
        operations.show_faults(self.node)

    @property
    def alert_systems(self) -> Sequence[AlertSystem]:
        """Those of the robots that are watched now."""
        return [robot.alert_system for robot in self.robots]

    def check_own_faults(self) -> None:
        """Raises ConfigError if a robot cannot be reached until the configuration on this side is corrected."""
        for robot in self.robots:
            if robot.cause is not None and robot.cause.own_fault:
                raise ConfigError(f"{robot.name}: {robot.cause.text}")

    def parameters(self) -> Mapping[str, Mapping[str, object]]:
        """Returns the parameters that were given to the robots' alert_systems, by the full name of their node."""
        return dict(robot.parameters() for robot in self.robots)

    async def run(self) -> None:
        """Keeps the connections up until it is cancelled."""
        self._is_running = True
        self._start(self.robots)
        timers = asyncio.ensure_future(run_timers(self.bus))
        try:
            await timers
        finally:
            tasks = {timers, *(robot.task for robot in self.robots if robot.task is not None)}
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    async def reload(self) -> str:
        """Reads the configuration again and applies what differs; see `Reload`.

        Raises ConfigError and changes nothing if the configuration cannot be used.
        """
        return self.apply(await run_in_daemon_thread(self._read))

    def apply(self, settings: Sequence[RobotSettings]) -> str:
        """Makes the robots those of `settings`; returns what changed. Called in the loop."""
        known, wanted = {robot.name: robot for robot in self.robots}, {new.name for new in settings}
        changes = {name: "removed" for name in known if name not in wanted}
        for name in changes:
            known[name].end()
            self._operations.end_robot(name)
        self.robots, added = [], []
        for new in settings:
            robot = known.get(new.name)
            change = "added" if robot is None else robot.change(new)
            if robot is not None and change == _STARTED_ANEW:
                robot.end()
                robot = None
            if robot is None:
                robot = self._create(new)
                added.append(robot)
            self.robots.append(robot)
            if change != NOTHING_CHANGED:
                changes[new.name] = change
        if self._is_running:
            self._start(added)
            self._operations.note_robots()
        texts = [f"{name}: {change}" for name, change in changes.items()]
        return list_text(texts, _MOST_NAMES) or NOTHING_CHANGED

    def close(self) -> None:
        """Ends every robot's alert_system and connection; open alerts stay open."""
        for robot in self.robots:
            robot.close()
        self.node.close()

    def _count_signals(self) -> int:
        return sum(len(alert_system.monitor.config.signals) for alert_system in self.alert_systems)

    def _create(self, settings: RobotSettings) -> Robot:
        namespace = re.sub(r"\W", "_", settings.name, flags=re.ASCII)
        namespace = namespace if namespace[:1].isalpha() else f"robot_{namespace}"
        taken = {node.name for node in self.bus.nodes}
        while f"/{namespace}/alert_system" in taken:
            namespace += "_"
        outputs = self.bus.node("alert_system", namespace=namespace, remap={"alerts": "/alerts"})
        try:
            return Robot(self, settings, outputs)
        except ConfigError:
            outputs.close()
            raise

    def _start(self, robots: Iterable[Robot]) -> None:
        for number, robot in enumerate(robots):
            robot.task = asyncio.ensure_future(robot.run(number * _START_PERIOD_S))

    def _check(self, now_s: float) -> None:
        self._self_monitor.find_pause(now_s)
        self._self_monitor.note_tick(now_s)
        self._self_monitor.check(sum(alert_system.samples for alert_system in self.alert_systems))
        publish_statuses(self.node, lambda: [self._self_monitor.status()])


class Robot:
    """The connection to one robot, which publishes and offers nothing there, and the alert_system that judges it."""

    def __init__(self, fleet: Fleet, settings: RobotSettings, outputs: LocalMiddleware) -> None:
        """Starts the alert_system; `run` connects. Raises ConfigError if the configuration cannot be used.

        The node `outputs`, which is closed at the end, publishes what the alert_system announces, and offers its
        services. Of what alert_system logs at its start, only warnings are logged.
        """

        def log(line: LogLine) -> None:
            if started or line.severity > Severity.INFO:
                fleet.bus.log(line._replace(node=settings.name))

        started = False
        self.name = settings.name
        self.settings = settings
        self.cause: Cause | None = None
        """Why the connection is down; None while it is up and before the first attempt."""
        self.connected = False
        """Whether the connection is up."""
        self.task: asyncio.Future[None] | None = None
        """Keeps the connection up."""
        self._closed = False
        self._outputs = outputs
        self._client = bridge_client(
            settings.url,
            token=settings.token,
            ssl_context=settings.ssl_context,
            clock=fleet.clock,
            on_log=log,
            on_link=self._note_link,
        )
        self._log = LimitedLog(self._client.log, fleet.clock)
        self._node: BridgeNode = self._client.node(
            "alert_system",
            namespace=settings.namespace,
            parameters=_parameters(settings),
            use_sim_time=settings.use_sim_time,
            outputs=outputs,
        )
        self.alert_system = fleet.start_alert_system(
            self._node,
            {"output": fleet.outlet(settings.name)},
            log_alerts=False,
            announce_pauses=False,
            self_report={"dropped": lambda: self._node.dropped},
        )
        started = True

    @property
    def _address(self) -> str:
        """The address of its server, without credentials."""
        return self._client.connection.address

    def parameters(self) -> tuple[str, Mapping[str, object]]:
        """Returns the name of the node on `Fleet.bus`, and the parameters that were given, nested."""
        return self._outputs.name, self._node.given_parameters()

    async def run(self, delay_s: float) -> None:
        """Keeps the connection up until it is cancelled. A failure is logged, and the connection restarted."""
        await asyncio.sleep(delay_s)
        while not self._closed:
            try:
                await self._client.run()
            except Exception as error:  # one robot's failure must not end the others
                text = printable(f"{type(error).__name__}: {error}")
                self._client.log(Severity.ERROR, f"internal error, reconnecting in {_RESTART_S:g} s: {text}")
                self._node.call(self._note_link, False, Cause(f"internal error: {type(error).__name__}"))
                await asyncio.sleep(_RESTART_S)

    def change(self, settings: RobotSettings) -> str:
        """Applies new settings; returns what changed. Signals that are configured as before keep their state.

        Connects again only if the address, the token or the certificate authorities differ. Returns `_STARTED_ANEW` and
        changes nothing if this needs a new `Robot`: other topics, another clock or kind of bridge.
        """
        old, texts = self.settings, []
        fixed = [(each.namespace, each.use_sim_time, is_foxglove(each.url)) for each in (old, settings)]
        if fixed[0] != fixed[1]:
            return _STARTED_ANEW
        if old.parameters != settings.parameters:
            try:
                texts.append(self._node.set_parameters(_parameters(settings)))
            except ConfigError:
                return _STARTED_ANEW
        self.settings = settings
        if (old.url, old.token, old.ca) != (settings.url, settings.token, settings.ca):
            self._client.connection.move(settings.url, token=settings.token, ssl_context=settings.ssl_context)
            texts.append(f"connecting again, to {self._address}")
        return "; ".join(texts) or NOTHING_CHANGED

    def end(self) -> None:
        """Ends every open alert with a transition to OK, `no longer watched`, and closes."""
        self._node.call(self.alert_system.stop_watching)
        self.close()

    def close(self) -> None:
        """Ends the alert_system and the connection; open alerts stay open."""
        self._closed = True
        if self.task is not None:
            self.task.cancel()
        self.alert_system.close()
        self._client.close()
        self._outputs.close()

    def _note_link(self, up: bool, cause: Cause) -> None:
        if self._closed:
            return
        was_connected, self.connected = self.connected, up
        if up:
            self.cause = None
            self._log.write("connected", Severity.INFO, f"connected to {self._address}")
            # Under use_sim_time the robot's clock is unknown until its first message. Until then the link counts as
            # down: otherwise its first message would look like a jump of that many seconds without samples.
            self._node.call_with_time(self._observe_link)
        elif not (was_connected and self._node.exclusively(self.alert_system.excuse_link)):
            if self.cause is not None:  # the alert of the link shows the first cause
                self._log.write(cause.text, Severity.WARN, f"still not connected: {cause.text}")
            self.cause = cause
            self._node.call(self._observe_link)

    def _observe_link(self) -> None:
        self.alert_system.observe_link(self.cause is None, "" if self.cause is None else self.cause.text)


def _parameters(settings: RobotSettings) -> Mapping[str, object]:
    return {**settings.parameters, "robot_name": settings.name}


def bridge_client(url: str, **options: Any) -> BridgeClient[Any]:
    """Returns a client that is not connected and only reads, with the options that both clients have.

    Raises ConfigError if `url` is not the address of a server.
    """
    return FoxgloveClient(url, **options) if is_foxglove(url) else RosbridgeClient(url, **options)
