"""The rosbridge server of `robot-health run`, in the monitor's own event loop."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Optional

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity

from .embedded import EmbeddedMonitor

if TYPE_CHECKING:
    from robot_health_monitor.rosbridge.server.server import Server

_DEFAULT_PORT = 9090


async def start_server(monitor: EmbeddedMonitor, arguments: argparse.Namespace) -> Optional[Server]:
    """Serves the monitor's topics, services and log as the arguments say.

    Returns:
        The server; None when the default port is taken or a library is missing: the log says so, and the monitor does
        its work without.

    Raises:
        ConfigError: a port or address that was asked for cannot be had, or is not protected.
    """
    node = monitor.bus.node("rosbridge")
    try:
        from robot_health_monitor.rosbridge.server.access import LOCAL_PAGES, monitor_access
        from robot_health_monitor.rosbridge.server.server import Server
    except ModuleNotFoundError as error:
        node.log(Severity.WARN, f"not served: {error.name} is not installed")
        return None
    access = monitor_access(
        "/alert_system",
        [signal.topic for signal in monitor.alert_system.monitor.config.signals.values()],
        token=arguments.token,
        origins=(*LOCAL_PAGES, *arguments.origin),
    )
    port = _DEFAULT_PORT if arguments.port is None else arguments.port
    server = Server(node, host=arguments.host, port=port, access=access, threads=False, parameters=monitor.parameters)
    try:
        await server.start()
    except OSError as error:
        problem = f"port {port} of {arguments.host} cannot be had ({error.strerror or error})"
        if arguments.port is not None:
            raise ConfigError(f"{problem}; --port 0 takes a free one") from None
        node.log(Severity.WARN, f"not served: {problem}; --port chooses another")
        return None
    on_log = monitor.bus.on_log

    def show_log(line: LogLine) -> None:
        on_log(line)
        server.publish_log(line)

    monitor.bus.on_log = show_log
    node.log(Severity.INFO, f"serving on ws://{arguments.host}:{server.port}")
    return server
