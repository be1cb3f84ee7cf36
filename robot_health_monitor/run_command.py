"""`robot-health run`: the monitor in this process, without ROS."""

from __future__ import annotations

import argparse
from contextlib import asynccontextmanager
from typing import AsyncIterator, Awaitable

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.yaml_file import read_yaml

from .embedded import EmbeddedMonitor
from .installed_files import find_installed
from .interrupts import Interrupts
from .live_session import run_session
from .output.choice import choose_output
from .output.events import Events
from .serving import DEFAULT_PORT, ServerSettings, serve, stop_serving
from .tokens import find_token


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> bool:
    """Runs the monitor until an interrupt, or for `--duration`.

    Returns:
        Whether the duration has passed and there were alerts.

    Raises:
        ConfigError: the configuration, the token file or the requested port cannot be used.
    """
    file = arguments.thresholds or find_installed("config/thresholds.yaml")
    output = choose_output(arguments.json)
    events = Events(output.add, Severity[arguments.log_level])
    monitor = EmbeddedMonitor(
        read_yaml(file) if file else None,
        robot=arguments.robot,
        source=arguments.source,
        on_log=events.on_log,
        outlet=events.outlet("alert_system"),
    )
    try:
        settings = server_settings(arguments, monitor)
    except ConfigError:
        monitor.close()
        raise

    @asynccontextmanager
    async def work() -> AsyncIterator[Awaitable[None]]:
        server = await serve(monitor, settings, required=arguments.port is not None)
        try:
            yield monitor.run()
        finally:
            if server is not None:
                await stop_serving(server)

    return run_session(monitor, work(), events, output, interrupts, arguments.duration)


def server_settings(arguments: argparse.Namespace, monitor: EmbeddedMonitor) -> ServerSettings:
    """Returns the settings of the server: those of the command line, then of the configuration, then the defaults.

    Raises:
        ConfigError: the token file cannot be used.
    """
    config = monitor.alert_system.monitor.config

    def warn(text: str) -> None:
        monitor.bus.on_log(LogLine(monitor.now_s, "rosbridge", Severity.WARN, text))

    token_file = arguments.token_file or config.rosbridge_token_file
    return ServerSettings(
        port=config.rosbridge_port or DEFAULT_PORT if arguments.port is None else arguments.port,
        address=arguments.host or config.rosbridge_address,
        token=find_token(token_file, warn),
        origins=arguments.origin,
        allow_publish=arguments.allow_publish,
        allow_call=arguments.allow_call,
        allow_offer=arguments.allow_offer,
    )
