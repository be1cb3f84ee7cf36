"""Robots that are watched over rosbridge: one connection and one alert_system per robot, in one event loop.

fleet.yaml can be read again at any time (`reload`): only what differs is changed. What the robots' alert_systems
publish stays in this process, on `Fleet.bus`, from where a server can serve it; nothing is published on the robots.
"""

from __future__ import annotations

import asyncio
import re
import time
from dataclasses import replace
from typing import Callable, Collection, Dict, Iterable, List, Mapping, Optional, Sequence

from robot_health_monitor.core.diagnostics import ARRAY_TYPE, array_message
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LocalBus, LogLine
from robot_health_monitor.core.middleware import NOTHING_CHANGED, Severity
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.node import host_name
from robot_health_monitor.core.nodes.self_monitor import CHECK_PERIOD_S, EMPTY_REPORT, SelfMonitor, SelfReport
from robot_health_monitor.core.outlets import Outlet
from robot_health_monitor.runtime.threads import run_in_daemon_thread

from .fleet_configuration import FleetReader, RobotSettings
from .fleet_robot import Robot, StartAlertSystem

__all__ = ["Fleet", "RobotsChanged"]

NODE = "connect"
"""Name of the node that reports on this process: its status on /diagnostics is `connect: monitor`."""

_DIAGNOSTICS = "/diagnostics"
_START_PERIOD_S = 0.005
"""Between the first attempts of two robots: a fleet that connects at once would answer its own handshakes late."""
_MOST_NAMES = 5
"""Most robots that are named one by one in the log: at the start, and in a line about a reload."""


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
        self_report: SelfReport = EMPTY_REPORT,
    ) -> None:
        """Creates the robots; `run` connects to them.

        Args:
            reader: reads their settings, now and at every reload.
            clock: monotonic seconds.
            on_log: called with every log line; its node is the robot's name, or `connect`.
            outlet: returns the outlet for a robot's transitions and notices, by its name, or for the notices of the
                process itself, as `connect`.
            start: creates an alert_system, with what the process adds, such as a history.
            self_report: what the status of the process shows besides the robots.

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
        self.process_faults = self.faults.current
        """Returns the same, by part."""
        self._node.advertise(_DIAGNOSTICS, ARRAY_TYPE)
        self.robots: List[Robot] = []
        """The robots that are watched now, in the order of the configuration."""
        self._on_change: List[RobotsChanged] = []
        self._tasks: Dict[Robot, asyncio.Future[None]] = {}
        self._is_running = False
        emit = outlet(NODE)
        self_report = replace(
            self_report,
            signals=self._count_signals,
            robots=lambda: len(self.robots),
            unreachable=lambda: sum(not robot.connected for robot in self.robots),
        )
        self._self_monitor = SelfMonitor(self._node, host_name(), CHECK_PERIOD_S, emit, self_report)
        self._node.create_timer(CHECK_PERIOD_S, self._check)
        found = reader.read()
        try:
            for settings in found:
                self.robots.append(self._create(settings, log_details=len(found) == 1))
        except ConfigError:
            self.close()
            raise
        if len(found) > _MOST_NAMES:
            self.log(Severity.INFO, f"watching {len(self.robots)} robots, {self._count_signals()} signals")
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
        """Keeps the connections up until it is cancelled."""
        self._is_running = True
        self._start(self.robots)
        timers = asyncio.ensure_future(self._run_timers())
        try:
            await timers
        finally:
            tasks = {timers, *self._tasks.values()}
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    async def reload(self) -> str:
        """Reads the configuration again and applies what differs; see `Reload`.

        Raises:
            ConfigError: it cannot be used; nothing has changed.
        """
        return self.apply(await run_in_daemon_thread(self._reader.read))

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
        if self._is_running:
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
        return "; ".join(texts) or NOTHING_CHANGED

    def close(self) -> None:
        """Ends every robot's alert_system and connection; open alerts stay open."""
        for robot in self.robots:
            robot.close()
        self._node.close()

    def log(self, severity: Severity, text: str) -> None:
        """Logs a line about the process."""
        self._node.log(severity, text)

    def _count_signals(self) -> int:
        return sum(len(robot.monitor.config.signals) for robot in self.robots)

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
                on_log=self.bus.log,
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

    async def _run_timers(self) -> None:
        while True:
            self.bus.run_due(self._clock())
            due_s = self.bus.next_due_s()
            await asyncio.sleep(1.0 if due_s is None else max(0.0, due_s - self._clock()))

    def _check(self, now_s: float) -> None:
        self._self_monitor.find_pause(now_s)
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
