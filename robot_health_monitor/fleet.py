"""Robots that are watched over rosbridge: one connection and one alert_system per robot, in one event loop.

fleet.yaml can be read again at any time (`reload`): only what differs is changed. What the robots' alert_systems
publish stays in this process, on `Fleet.bus`, from where a server can serve it; nothing is published on the robots.
"""

from __future__ import annotations

import asyncio
import re
import time
from typing import Callable, Collection, Dict, Iterable, List, Mapping, Optional, Protocol, Sequence

from robot_health_monitor.core.diagnostics import ARRAY_TYPE, array_message
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.formatting import list_text, printable
from robot_health_monitor.core.local import LocalBus, LocalMiddleware, LogLine
from robot_health_monitor.core.middleware import Middleware, Severity
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.identity import host_name
from robot_health_monitor.core.nodes.self_monitor import CHECK_PERIOD_S, SelfMonitor
from robot_health_monitor.core.outlets import Outlet
from robot_health_monitor.rosbridge.client import Cause, RosbridgeClient
from robot_health_monitor.rosbridge.client.log_limit import LogLimit
from robot_health_monitor.rosbridge.daemon_thread import run_in_daemon_thread

from .fleet_configuration import FleetReader, RobotSettings

__all__ = ["Fleet", "Robot", "RobotsChanged"]

NODE = "connect"
"""Name of the node that reports on this process: its status on /diagnostics is `connect: monitor`."""

_DIAGNOSTICS = "/diagnostics"
_RESTART_S = 5.0
_START_PERIOD_S = 0.005
"""Between the first attempts of two robots: a fleet that connects at once would answer its own handshakes late."""
_MOST_NAMES = 5
"""Most robots that are named one by one in the log: at the start, and in a line about a reload."""


class StartAlertSystem(Protocol):
    """Creates an alert_system, as the class itself does."""

    def __call__(
        self, middleware: Middleware, outlets: Mapping[str, Outlet] = ..., *, log_alerts: bool = ...
    ) -> AlertSystem:
        """Starts watching."""


class Robot:
    """One robot: its connection, and the alert_system that judges what arrives.

    Nothing is published and no service is offered on the robot.
    """

    def __init__(
        self,
        settings: RobotSettings,
        *,
        outputs: LocalMiddleware,
        clock: Callable[[], float],
        on_log: Callable[[LogLine], None],
        outlet: Outlet,
        log_details: bool = False,
        start: StartAlertSystem = AlertSystem,
    ) -> None:
        """Starts the alert_system; `run` connects.

        Args:
            settings: what to watch, and where.
            outputs: node that publishes what the alert_system announces, and offers its services; closed at the end.
            clock: monotonic seconds.
            on_log: called with every log line; its node is the robot's name.
            outlet: receives the robot's transitions and notices.
            log_details: log what alert_system does at its start, a line per signal; else only warnings.
            start: creates the alert_system.

        Raises:
            ConfigError: the configuration cannot be used.
        """

        def log(line: LogLine) -> None:
            if log_details or started or line.severity > Severity.INFO:
                on_log(line._replace(node=settings.name))

        started = False
        self.name = settings.name
        self.settings = settings
        self.cause: Optional[Cause] = None
        """Why the connection is down; None while it is up and before the first attempt."""
        self.connected = False
        """Whether the connection is up."""
        self._closed = False
        self._outputs = outputs
        self._client = RosbridgeClient(
            settings.url,
            token=settings.token,
            ssl_context=settings.ssl_context,
            read_only=True,
            clock=clock,
            on_log=log,
            on_link=self._note_link,
        )
        self._log = LogLimit(self._client.log, clock)
        self._node = self._client.node(
            "alert_system",
            namespace=settings.namespace,
            parameters=self._parameters(settings),
            use_sim_time=settings.use_sim_time,
            outputs=outputs,
        )
        self.alert_system = start(self._node, {"output": outlet}, log_alerts=False)
        self.alert_system.self_report["dropped"] = lambda: str(self._node.dropped)
        started = True

    @property
    def monitor(self) -> Monitor:
        """Judges the robot's signals."""
        return self.alert_system.monitor

    @property
    def faults(self) -> Faults:
        """What does not work of the monitor of this robot."""
        return self._node.faults

    @property
    def now_s(self) -> float:
        """The time of the robot's monitor, in s: simulated time under `use_sim_time`."""
        return self._node.now_s()

    @property
    def address(self) -> str:
        """The address of its server, without credentials."""
        return self._client.connection.address

    def log_summary(self) -> None:
        """Logs in one line what is watched, and where."""
        self._client.log(Severity.INFO, f"watching {list_text(tuple(self.monitor.config.signals))} at {self.address}")

    def parameters(self) -> Mapping[str, Mapping[str, object]]:
        """Returns the parameters that were given, nested, by the name of the node on `Fleet.bus`."""
        return {self._outputs.name: self._node.given_parameters()}

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

    def change(self, settings: RobotSettings) -> str:
        """Applies new settings. Signals that are configured as before keep their state.

        Connects again only if the address, the token or the certificate authorities differ.

        Returns:
            What changed.

        Raises:
            ConfigError: this needs a new `Robot`; nothing was changed.
        """
        old = self.settings
        if (old.namespace, old.use_sim_time) != (settings.namespace, settings.use_sim_time):
            raise ConfigError("the topics and the clock of a robot cannot be changed while it is watched")
        texts = []
        if old.parameters != settings.parameters:
            texts.append(self._node.set_parameters(self._parameters(settings)))
        self.settings = settings
        if (old.url, old.token, old.ca) != (settings.url, settings.token, settings.ca):
            connection = self._client.connection
            connection.move(settings.url, token=settings.token, ssl_context=settings.ssl_context)
            texts.append(f"connecting again, to {self.address}")
        return "; ".join(texts) or "nothing changed"

    def end(self) -> None:
        """Ends every open alert with a transition to OK, `no longer watched`, and closes."""
        self._node.call(self.alert_system.stop_watching)
        self.close()

    def close(self) -> None:
        """Ends the alert_system and the connection; open alerts stay open."""
        self._closed = True
        self.alert_system.close()
        self._client.close()
        self._outputs.close()

    @staticmethod
    def _parameters(settings: RobotSettings) -> Mapping[str, object]:
        return {**settings.parameters, "robot_name": settings.name}

    def _note_link(self, up: bool, cause: Cause) -> None:
        if self._closed:
            return
        self.connected = up
        if up:
            self.cause = None
            self._log.write("connected", Severity.INFO, f"connected to {self.address}")
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


RobotsChanged = Callable[[Sequence[Robot], Sequence[Robot]], None]
"""Called with the robots that were added and those that were removed."""


class Fleet:
    """All robots of one process."""

    system_health: Optional[float] = None
    """Not defined for several robots."""
    alert_system_pattern = "/*/alert_system"
    """The full names of the alert_systems on `bus`; `*` as in file names."""

    def __init__(
        self,
        reader: FleetReader,
        *,
        clock: Callable[[], float],
        on_log: Callable[[LogLine], None],
        outlet: Callable[[str], Outlet],
        start: StartAlertSystem = AlertSystem,
    ) -> None:
        """Creates the robots; `run` connects to them.

        Args:
            reader: reads their settings, now and at every reload.
            clock: monotonic seconds.
            on_log: called with every log line; its node is the robot's name, or `connect`.
            outlet: returns the outlet for a robot's transitions and notices, by its name, or for the notices of the
                process itself, as `connect`.
            start: creates an alert_system, and attaches to it what the process adds, such as a history.

        Raises:
            ConfigError: the configuration cannot be used; the message names file and line.
        """
        self._reader = reader
        self._clock = clock
        self._outlet = outlet
        self._start_alert_system = start
        self.bus = LocalBus(on_log=on_log, wall_time_s=time.time, clock=clock)
        """Where the robots' alerts, statuses and `reset` services are: /alerts, /diagnostics, /ROBOT/alert_system."""
        self._node = self.bus.node(NODE)
        self.faults = self._node.faults
        """What does not work in this process, besides the robots' own."""
        self._node.advertise(_DIAGNOSTICS, ARRAY_TYPE)
        self.robots: List[Robot] = []
        """The robots that are watched now, in the order of the configuration."""
        self._on_change: List[RobotsChanged] = []
        self._tasks: Dict[Robot, asyncio.Future[None]] = {}
        self._reload_requested: Optional[asyncio.Event] = None
        emit = outlet(NODE)
        self._self_monitor = SelfMonitor(self._node, host_name(), CHECK_PERIOD_S, lambda event: emit(event))
        self.self_report = self._self_monitor.reports
        """Key-values of the status of the process: a function per key. A server adds `clients`, for instance."""
        self.self_report["robots"] = lambda: str(len(self.robots))
        self.self_report["unreachable"] = lambda: str(sum(not robot.connected for robot in self.robots))
        self.self_report["signals"] = lambda: str(sum(len(robot.monitor.config.signals) for robot in self.robots))
        self._node.create_timer(CHECK_PERIOD_S, self._check)
        found = reader.read()
        try:
            for settings in found:
                self.robots.append(self._create(settings, log_details=len(found) == 1))
        except ConfigError:
            self.close()
            raise
        if len(found) > _MOST_NAMES:
            self.log(Severity.INFO, f"watching {len(self.robots)} robots, {self.self_report['signals']()} signals")
        elif len(found) > 1:
            for robot in self.robots:
                robot.log_summary()

    def on_change(self, callback: RobotsChanged) -> None:
        """Calls back in the loop after robots were added or removed."""
        self._on_change.append(callback)

    def on_new_alert_system(self, callback: Callable[[AlertSystem], None]) -> None:
        """Calls back in the loop with the alert_system of each robot that is added."""

        def call(added: Sequence[Robot], removed: Sequence[Robot]) -> None:
            for robot in added:
                callback(robot.alert_system)

        self.on_change(call)

    @property
    def alert_systems(self) -> Sequence[AlertSystem]:
        """Those of the robots that are watched now."""
        return [robot.alert_system for robot in self.robots]

    def check_own_faults(self) -> None:
        """Checks that no robot refuses this client.

        Raises:
            ConfigError: a robot cannot be reached until the configuration on this side is corrected.
        """
        for robot in self.robots:
            if robot.cause is not None and robot.cause.own_fault:
                raise ConfigError(f"{robot.name}: {robot.cause.text}")

    def parameters(self) -> Mapping[str, Mapping[str, object]]:
        """Returns the parameters that were given to the robots' alert_systems, by the full name of their node."""
        return {name: tree for robot in self.robots for name, tree in robot.parameters().items()}

    async def run(self) -> None:
        """Keeps the connections up, and reloads when asked to, until it is cancelled."""
        self._reload_requested = asyncio.Event()
        self._start(self.robots)
        timers = asyncio.ensure_future(self._run_timers())
        try:
            while True:
                await self._reload_requested.wait()
                self._reload_requested.clear()
                await self._reload()
        finally:
            tasks = {timers, *self._tasks.values()}
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    def reload(self) -> None:
        """Reads the configuration again soon, in the loop, and applies what differs. An invalid one changes nothing."""
        if self._reload_requested is not None:
            self._reload_requested.set()

    def apply(self, settings: Sequence[RobotSettings]) -> str:
        """Adds, removes and changes robots, so that they are those of `settings`. Called in the loop.

        Returns:
            What changed.
        """
        known = {robot.name: robot for robot in self.robots}
        wanted = {new.name: new for new in settings}
        changes: Dict[str, List[str]] = {}
        ended = [robot for name, robot in known.items() if name not in wanted]
        removed = [robot.name for robot in ended]
        replaced = []
        for name, new in wanted.items():
            if name not in known or known[name].settings == new:
                continue
            try:
                changes.setdefault(known[name].change(new), []).append(name)
            except ConfigError:
                ended.append(known[name])
                replaced.append(name)
        for robot in ended:
            robot.end()
            task = self._tasks.pop(robot, None)
            if task is not None:
                task.cancel()
            del known[robot.name]
        added = {name: self._create(new) for name, new in wanted.items() if name not in known}
        if len(added) <= _MOST_NAMES:
            for robot in added.values():
                robot.log_summary()
        self.robots = [known[name] if name in known else added[name] for name in wanted]
        if self._reload_requested is not None:
            self._start(added.values())
        if added or ended:
            for callback in self._on_change:
                self.faults.guard("change of the fleet", callback, list(added.values()), ended)
        texts = [
            *_text("added", added.keys() - set(replaced), wanted),
            *_text("removed", removed, removed),
            *_text("started anew", replaced, wanted),
            *(text for change, names in changes.items() for text in _text(change, names, wanted)),
        ]
        return "; ".join(texts) or "nothing changed"

    def close(self) -> None:
        """Ends every robot's alert_system and connection; open alerts stay open."""
        for robot in self.robots:
            robot.close()
        self._node.close()

    def log(self, severity: Severity, text: str) -> None:
        """Logs a line about the process."""
        self._node.log(severity, text)

    def _create(self, settings: RobotSettings, *, log_details: bool = False) -> Robot:
        namespace = re.sub(r"\W", "_", settings.name, flags=re.ASCII)
        namespace = namespace if namespace[:1].isalpha() else f"robot_{namespace}"
        taken = {node.name for node in self.bus.nodes}
        while f"/{namespace}/alert_system" in taken:
            namespace += "_"
        outputs = self.bus.node("alert_system", namespace=namespace, remap={"alerts": "/alerts"})
        try:
            return Robot(
                settings,
                outputs=outputs,
                clock=self._clock,
                on_log=lambda line: self.bus.on_log(line),
                outlet=self._outlet(settings.name),
                log_details=log_details,
                start=self._start_alert_system,
            )
        except ConfigError:
            outputs.close()
            raise

    def _start(self, robots: Iterable[Robot]) -> None:
        for number, robot in enumerate(robots):
            self._tasks[robot] = asyncio.ensure_future(_run_later(number * _START_PERIOD_S, robot))

    async def _reload(self) -> None:
        try:
            settings = await run_in_daemon_thread(self._reader.read)
            text = self.apply(settings)
        except ConfigError as error:
            more = f" ({len(error.all) - 1} more: robot-health check)" if len(error.all) > 1 else ""
            self.log(Severity.ERROR, f"not reloaded, the old configuration stays in force: {error}{more}")
        except Exception as error:
            self.log(Severity.ERROR, printable(f"not reloaded: internal error: {type(error).__name__}: {error}"))
        else:
            self.log(Severity.INFO, f"reloaded: {text}")

    async def _run_timers(self) -> None:
        while True:
            self.bus.run_due(self._clock())
            due_s = self.bus.next_due_s()
            await asyncio.sleep(1.0 if due_s is None else max(0.0, due_s - self._clock()))

    def _check(self, now_s: float) -> None:
        self._self_monitor.note_tick(now_s)
        self._self_monitor.check(sum(robot.alert_system.samples for robot in self.robots))
        if self._node.has_listeners(_DIAGNOSTICS):
            self._node.publish(_DIAGNOSTICS, array_message([self._self_monitor.status()], NODE))


async def _run_later(delay_s: float, robot: Robot) -> None:
    await asyncio.sleep(delay_s)
    await robot.run()


def _text(change: str, names: Collection[str], order: Iterable[str]) -> List[str]:
    """Returns `added husky1, husky2` or `added 200 robots`; nothing without names."""
    shown = [name for name in order if name in names]
    if not shown:
        return []
    robots = ", ".join(shown) if len(shown) <= _MOST_NAMES else f"{len(shown)} robots"
    return [f"{change} {robots}" if change in ("added", "removed", "started anew") else f"{robots}: {change}"]
