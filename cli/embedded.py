"""The monitor in one process, without ROS: the three nodes on a `LocalBus`, driven by an asyncio loop."""

from __future__ import annotations

import asyncio
import time
from contextlib import nullcontext
from functools import partial
from typing import Any, Callable, Mapping, Sequence

from ..core.config import NODES, MonitorConfig, Section, YamlFile, find_section, read_yaml, sections
from ..core.nodes import Aggregator, AlertSystem, BatterySensor
from ..core.nodes.aggregator import has_inputs
from ..core.nodes.outlets import Outlet
from ..core.port import NOTHING_CHANGED, LocalBus, LocalMiddleware, LogLine
from ..core.sensors.computer import Computer
from ..core.sensors.configuration import METRICS
from ..core.values import Clock, ConfigError, JsonObject, Problems
from ..runtime.event_loops import run_in_daemon_thread
from ..runtime.threads import DetachedCalls

_NO_SECTIONS = dict.fromkeys(NODES, Section((), {}))


class EmbeddedMonitor:
    """battery_sensor, aggregator and alert_system on one bus."""

    alert_system_pattern = "/alert_system"
    """The full name of alert_system."""

    def __init__(
        self,
        file: YamlFile | None = None,
        *,
        robot: str = "",
        source: str = "",
        clock: Clock = time.monotonic,
        wall_time_s: Clock = time.time,
        on_log: Callable[[LogLine], None] | None = None,
        outlet: Outlet | None = None,
        start_alert_system: Callable[..., AlertSystem] = AlertSystem,
    ) -> None:
        """Starts the nodes; their timers run in `run`, or in `bus.run_due`. ConfigError names file and line.

        `robot`, its name, and `source`, that of all metrics (simulated, host or none), replace those in the file.
        `clock` gives monotonic s, `wall_time_s` s since 1970, for the stamps of messages. Without `on_log`, log lines
        are kept in `bus.log_lines`; without `outlet`, transitions and notices are logged.
        """
        self.bus = LocalBus(on_log=on_log, wall_time_s=wall_time_s, clock=clock)
        self._nodes: list[Any] = []
        self._middlewares: dict[str, LocalMiddleware] = {}
        self._file = file
        self._sections = _NO_SECTIONS if file is None else sections_of_nodes(file)
        self._robot = robot
        self._source = source
        outlets = {} if outlet is None else {"output": outlet}
        self.alert_system: AlertSystem = self._start(
            "alert_system", lambda node: start_alert_system(node, outlets, log_alerts=outlet is None)
        )
        self.alert_systems: Sequence[AlertSystem] = (self.alert_system,)
        self.node = self._middlewares["alert_system"]
        """The node whose faults and log are those of the process."""
        self.process_faults = dict
        """Returns nothing: all faults are those of alert_system."""
        if has_inputs({**self._sections["aggregator"].tree, "sensors": source}):
            self._start("aggregator", Aggregator)
        if source != "none":
            computer = Computer(background=DetachedCalls("sources"))
            # last: its first values have subscribers
            self._start("battery_sensor", lambda node: BatterySensor(node, computer))

    @property
    def server_config(self) -> MonitorConfig:
        """The configuration with parameters of the server."""
        return self.alert_system.monitor.config

    def parameters(self) -> Mapping[str, JsonObject]:
        """Returns the parameters that were given, nested, by the full name of their node."""
        return {node.name: node.given_parameters() for node in self.bus.nodes}

    async def run(self) -> None:
        """Runs the timers of the nodes in real time until it is cancelled."""
        await run_timers(self.bus)

    async def reload(self) -> str:
        """Reads the configuration file again; see `Reload`. A node that rejects it keeps its values."""
        if self._file is None:
            return NOTHING_CHANGED
        file = await run_in_daemon_thread(partial(read_yaml, self._file.file))
        self._file, self._sections = file, sections_of_nodes(file)
        problems, texts = Problems(), []
        for name, middleware in self._middlewares.items():
            with problems, file.located(self._sections[name].path):
                text = middleware.set_parameters(self._parameters(name))
                if text != NOTHING_CHANGED:
                    texts.append(text if name == "alert_system" else f"{name}: {text}")
        problems.raise_if_any()
        return "; ".join(texts) or NOTHING_CHANGED

    def close(self) -> None:
        """Ends the nodes."""
        for node in self._nodes:
            node.close()

    def _start(self, name: str, make: Callable[[LocalMiddleware], Any]) -> Any:
        middleware = self.bus.node(name, parameters=self._parameters(name))
        try:
            with self._file.located(self._sections[name].path) if self._file else nullcontext():
                node = make(middleware)
        except ConfigError:
            middleware.close()
            self.close()
            raise
        self._nodes.append(node)
        self._middlewares[name] = middleware
        return node

    def _parameters(self, name: str) -> JsonObject:
        parameters: dict[str, Any] = dict(self._sections[name].tree)
        # One robot: the file need not name it three times.
        parameters.setdefault("robot_name", self._sections["alert_system"].tree.get("robot_name", ""))
        if self._robot:
            parameters["robot_name"] = self._robot
        if name == "battery_sensor" and self._source:
            for metric in METRICS:
                section = parameters.get(metric, {})
                if isinstance(section, Mapping):  # anything else is for the node to reject
                    parameters[metric] = {**section, "source": self._source}
        return parameters


async def run_timers(bus: LocalBus) -> None:
    """Runs the timers of a bus in real time, by the clock that it was given, until it is cancelled."""
    while True:
        bus.run_due(bus.now_s)
        due_s = bus.next_due_s()
        await asyncio.sleep(1.0 if due_s is None else max(0.0, due_s - bus.now_s))


def sections_of_nodes(file: YamlFile) -> dict[str, Section]:
    """Returns the sections of a file by their nodes; those of `NODES` that it does not have are empty.

    Raises ConfigError if alert_system has no section, or one of `NODES` has several.
    """
    with file.located():
        by_node = {section.node: section for section in sections(file.tree)}
        return {**_NO_SECTIONS, **by_node, "alert_system": find_section(file.tree, "alert_system")}
