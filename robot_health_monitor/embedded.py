"""The monitor in one process without any middleware: the three nodes on a `LocalBus`, driven by an asyncio loop."""

from __future__ import annotations

import asyncio
import time
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from robot_health_monitor.core.config import Section, sections
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LocalBus, LogLine
from robot_health_monitor.core.middleware import Middleware
from robot_health_monitor.core.model import Transition
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor
from robot_health_monitor.core.outlets import Event, Outlet
from robot_health_monitor.core.sensors.configuration import METRICS
from robot_health_monitor.core.yaml_file import YamlFile

_HEALTH_KEEPS_S = 3.0


class EmbeddedMonitor:
    """battery_sensor, aggregator and alert_system on one bus."""

    def __init__(
        self,
        file: Optional[YamlFile] = None,
        *,
        robot: str = "",
        source: str = "",
        start_s: float = 0.0,
        on_log: Optional[Callable[[LogLine], None]] = None,
        on_transition: Optional[Callable[[Transition], None]] = None,
    ) -> None:
        """Starts the nodes; time stands still until `bus.run_due` is called.

        Args:
            file: the configuration of the nodes, each under its name; None: their defaults.
            robot: the robot's name, in place of the file's.
            source: where all metrics come from, in place of the file's: simulated or host.
            start_s: the time at the start, in seconds.
            on_log: called with every line that a node logs.
            on_transition: called with every transition, right after its line was logged.

        Raises:
            ConfigError: the configuration cannot be used; the message names file and line.
        """
        self.bus = LocalBus(start_s, on_log)
        self.alert_system: AlertSystem
        self._nodes: List[Any] = []
        self._file = file
        self._sections = {} if file is None else sections_of_nodes(file)
        self.unused_sections = sorted(self._sections.keys() - {"alert_system", "aggregator", "battery_sensor"})
        """Names of nodes in the file that are not among those that run here."""
        self._robot = robot
        self._source = source
        self.alert_system = self._start("alert_system", lambda node: _alert_system(node, on_transition))
        self._start("aggregator", Aggregator)
        self._start("battery_sensor", BatterySensor)  # last, so that nobody misses its first values
        self._health: Optional[Tuple[float, float]] = None
        listener = self.bus.node("terminal")
        listener.subscribe("system_health", "std_msgs/Float32", self._take_health, field="data")
        self._nodes.append(listener)

    @property
    def monitors(self) -> Sequence[Monitor]:
        """The one monitor that there is."""
        return (self.alert_system.monitor,)

    @property
    def now_s(self) -> float:
        """The time of the bus, in seconds."""
        return self.bus.now_s

    def parameters(self) -> Mapping[str, Mapping[str, Any]]:
        """Returns the parameters that were given, nested, by the full name of their node."""
        return {node.name: node.given_parameters() for node in self.bus.nodes}

    @property
    def system_health(self) -> Optional[float]:
        """The latest system_health, None while it is not published."""
        if self._health is None or self.bus.now_s - self._health[1] > _HEALTH_KEEPS_S:
            return None
        return self._health[0]

    def close(self) -> None:
        """Ends the nodes."""
        for node in self._nodes:
            node.close()

    def _take_health(self, value: float, now_s: float) -> None:
        self._health = value, now_s

    def _start(self, name: str, make: Callable[[Middleware], Any]) -> Any:
        section = self._sections.get(name, Section((), {}))
        middleware = self.bus.node(name, parameters=self._parameters(name, section.tree))
        try:
            node = make(middleware)
        except ConfigError as error:
            middleware.close()
            self.close()
            path = (*section.path, *error.path)
            if self._file is None or not section.path:
                raise ConfigError(error.problem, path) from None
            raise self._file.locate(ConfigError(error.problem, path)) from None
        self._nodes.append(node)
        return node

    def _parameters(self, name: str, given: Mapping[str, Any]) -> Mapping[str, Any]:
        parameters: Dict[str, Any] = dict(given)
        if self._robot:
            parameters["robot_name"] = self._robot
        elif "alert_system" in self._sections:  # one robot, which the file need not name three times
            parameters = {"robot_name": self._sections["alert_system"].tree.get("robot_name", ""), **parameters}
        if name == "battery_sensor" and self._source:
            for metric in METRICS:
                section = parameters.get(metric, {})
                if isinstance(section, Mapping):  # what is not is left for the node to refuse
                    parameters[metric] = {**section, "source": self._source}
        return parameters


def _alert_system(node: Middleware, on_transition: Optional[Callable[[Transition], None]]) -> AlertSystem:
    if on_transition is None:
        return AlertSystem(node)
    return AlertSystem(node, {"output": transitions_to(on_transition, node)}, log_alerts=False)


def transitions_to(on_transition: Callable[[Transition], None], node: Middleware) -> Outlet:
    """Returns an outlet that calls `on_transition` with each transition and logs each notice."""

    def outlet(event: Event) -> None:
        if isinstance(event, Transition):
            on_transition(event)
        else:
            node.log(event.severity, event.text)

    return outlet


def clock() -> Callable[[], float]:
    """Returns a clock that starts with the seconds since 1970 and then runs as the monotonic one does.

    The stamps of messages mean something to whoever receives them, and a step of the system's clock changes nothing.
    """
    offset_s = time.time() - time.monotonic()
    return lambda: offset_s + time.monotonic()


async def run_timers(
    bus: LocalBus, now_s: Callable[[], float], stop: asyncio.Event, after_due: Callable[[], None]
) -> None:
    """Runs the timers of a bus in real time until `stop` is set.

    Args:
        bus: whose timers to run.
        now_s: the clock.
        stop: ends it.
        after_due: called each time after timers have run.
    """
    while not stop.is_set():
        bus.run_due(now_s())
        after_due()
        due_s = bus.next_due_s()
        wait_s = None if due_s is None else max(0.0, due_s - now_s())
        try:
            await asyncio.wait_for(stop.wait(), wait_s)
        except asyncio.TimeoutError:
            pass  # the next timer is due


def sections_of_nodes(file: YamlFile) -> Dict[str, Section]:
    """Returns the sections of a file by the node that they are for.

    Raises:
        ConfigError: none is for alert_system.
    """
    try:
        found = sections(file.tree)
    except ConfigError as error:
        raise file.locate(error) from None
    if "alert_system" not in found:
        with_signals = [name for name, section in found.items() if "signals" in section.tree]
        if len(with_signals) != 1:
            raise ConfigError(
                f"found {', '.join(map(str, file.tree)) or 'nothing'}, "
                "allowed is one node with ros__parameters.signals, usually alert_system",
                file=file.file,
            )
        found["alert_system"] = found.pop(with_signals[0])
    return found
