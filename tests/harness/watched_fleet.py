"""A fleet that runs, and what it announced."""

from __future__ import annotations

import asyncio
import contextlib
import time
from functools import partial
from pathlib import Path
from typing import AsyncIterator

from robot_health_monitor.cli.fleet import Fleet
from robot_health_monitor.cli.fleet_configuration import Options, read_addresses, read_robots
from robot_health_monitor.cli.operations import Operations
from robot_health_monitor.core.nodes.outlets import Event, Outlet
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.ops.configuration import OpsConfig
from robot_health_monitor.runtime.tokens import TokenFiles

THRESHOLDS = """
alert_system:
  ros__parameters:
    use_sim_time: {sim}
    signals:
      battery_level: {{type: std_msgs/Float32, field: data, warn_below: 20.0, stale_after_s: 5.0, startup_grace_s: 5.0}}
"""


class Watching:
    """The fleet of `watching`."""

    def __init__(self, urls: list[str], thresholds: Path, sim: bool) -> None:
        file = thresholds / "thresholds.yaml"
        file.write_text(THRESHOLDS.format(sim=str(sim).lower()))
        self.log: list[LogLine] = []
        self.alerts: list[str] = []
        read = partial(
            read_robots, read_addresses(urls), "", Options(thresholds=str(file)), TokenFiles(lambda text: None)
        )
        self.operations = Operations(OpsConfig())
        self.fleet = Fleet(read, self.operations, clock=time.monotonic, on_log=self.log.append, outlet=self._outlet)

    def _outlet(self, robot: str) -> Outlet:
        def on_event(event: Event) -> None:
            if isinstance(event, Transition):
                self.alerts.append(f"{robot}: {event.text.partition(' (was')[0]}")

        return on_event

    def lines(self, least: Severity) -> list[str]:
        return [f"{line.node}: {line.text}" for line in self.log if line.severity >= least]


@contextlib.asynccontextmanager
async def watching(urls: list[str], thresholds: Path, *, sim: bool = False) -> AsyncIterator[Watching]:
    watched = Watching(urls, thresholds, sim)
    task = asyncio.ensure_future(watched.fleet.run())
    try:
        yield watched
    finally:
        watched.fleet.close()
        task.cancel()
        await asyncio.wait({task})
        watched.operations.close()
