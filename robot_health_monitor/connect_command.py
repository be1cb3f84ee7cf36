"""`robot-health connect`: watches robots over rosbridge, without ROS on this machine."""

from __future__ import annotations

import argparse
import time
from contextlib import asynccontextmanager
from typing import AsyncIterator, Awaitable, Optional

from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity

from .fleet import Fleet
from .fleet_configuration import FleetReader, Options, read_addresses
from .installed_files import find_installed
from .interrupts import Interrupts
from .live_session import run_session
from .output.choice import choose_output
from .output.events import Events
from .serving import ServerSettings, serve, stop_serving


def connect(arguments: argparse.Namespace, interrupts: Interrupts) -> bool:
    """Watches robots until an interrupt, or for `--duration`. SIGHUP reloads their configuration.

    Returns:
        Whether the duration has passed and there were alerts.

    Raises:
        ConfigError: an address or a file cannot be used; or, at the end of the duration, a robot refuses this client.
    """
    addresses = read_addresses(arguments.urls)
    output = choose_output(arguments.json, name_robots=len(addresses) > 1 or bool(arguments.fleet))
    events = Events(output.add, Severity[arguments.log_level])

    def warn(text: str) -> None:
        events.on_log(LogLine(time.monotonic(), "connect", Severity.WARN, text))

    options = Options(
        thresholds=str(arguments.thresholds or find_installed("config/thresholds.yaml") or ""),
        namespace=arguments.namespace,
        token_file=arguments.token_file,
        ca=arguments.ca,
    )
    fleet = Fleet(
        FleetReader(addresses, arguments.fleet, options, warn),
        clock=time.monotonic,
        on_log=events.on_log,
        outlet=events.outlet,
    )

    settings = server_settings(arguments)

    @asynccontextmanager
    async def work() -> AsyncIterator[Awaitable[None]]:
        server = None if settings is None else await serve(fleet, settings, required=arguments.port is not None)
        try:
            yield fleet.run()
        finally:
            if server is not None:
                await stop_serving(server)

    alerts_found = run_session(fleet, work(), events, output, interrupts, arguments.duration)
    if arguments.duration is not None and not interrupts.came:
        fleet.check_own_faults()
    return alerts_found


def server_settings(arguments: argparse.Namespace) -> Optional[ServerSettings]:
    """Returns the settings of the server for the whole fleet; None: not requested.

    The token that the command line names is for the robots. It is never the one that this server requires.
    """
    if arguments.port is None:
        return None
    return ServerSettings(arguments.port, arguments.host or "127.0.0.1")
