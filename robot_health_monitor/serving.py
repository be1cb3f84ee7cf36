"""Starts a rosbridge server beside an alert_system. Every executable that serves clients starts it here."""

from __future__ import annotations

import asyncio
import os
import platform
from typing import TYPE_CHECKING, Any, Callable, Dict, Mapping, NamedTuple, Optional, Protocol, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.local import LocalBus, LogLine
from robot_health_monitor.core.middleware import Middleware, ServedMiddleware, Severity
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.outlets import Event

from .tokens import find_token

if TYPE_CHECKING:
    from robot_health_monitor.core.config import MonitorConfig
    from robot_health_monitor.core.nodes import AlertSystem
    from robot_health_monitor.ops.web import WebInterface
    from robot_health_monitor.rosbridge.server import Server, ServerThread

DEFAULT_PORT = 9090
_FAULT = "rosbridge"
_CLOSE_S = 2.5
"""Longest time to close the port and the connections; the server itself takes at most 2 s."""
_SEVERITY_OF_LEVEL = {
    Level.OK: Severity.INFO,
    Level.WARN: Severity.WARN,
    Level.ERROR: Severity.ERROR,
    Level.STALE: Severity.WARN,
}


class ServerSettings(NamedTuple):
    """Where a server listens, and what its clients may do besides reading."""

    port: int
    """0: a free one."""
    address: str = "127.0.0.1"
    """Any address except loopback requires a token."""
    token: str = ""
    """Token that clients must present; empty: none."""
    origins: Sequence[str] = ()
    """Origins of web pages that may connect, besides those of this machine."""
    allow_publish: Sequence[str] = ()
    """Topics that clients may publish on; `*` and `?` as in file names."""
    allow_call: Sequence[str] = ()
    """Services that clients may call, besides rosapi and `reset` and `reload` of alert_system."""
    allow_offer: Sequence[str] = ()
    """Services that clients may offer."""


def make_server(
    middleware: ServedMiddleware,
    alert_system: str,
    settings: ServerSettings,
    parameters: Callable[[], Mapping[str, Mapping[str, Any]]],
    web: WebInterface,
    *,
    threads: bool,
) -> Server:
    """Returns a server that is not started.

    Args:
        middleware: a node for the server; not closed here.
        alert_system: the fully qualified name of the alert node; `*` as in file names.
        settings: where it listens and what clients may do.
        parameters: what clients may read of the nodes' parameters, by the full name of the node.
        web: the page and its API.
        threads: whether the middleware calls back from other threads than the server's loop.

    Raises:
        ConfigError: the address is not protected.
        ModuleNotFoundError: a library is not installed.
    """
    from robot_health_monitor.rosbridge.server import Server
    from robot_health_monitor.rosbridge.server.access import monitor_access

    access = monitor_access(
        alert_system,
        publish=settings.allow_publish,
        services=settings.allow_call,
        offer=settings.allow_offer,
        origins=settings.origins,
        token=settings.token,
    )
    return Server(
        middleware,
        host=settings.address,
        port=settings.port,
        access=access,
        threads=threads,
        parameters=parameters,
        routes=web.routes(),
        on_close=(web.close,),
    )


class Served(Protocol):
    """The monitors of one process, on one bus: an embedded monitor or a fleet."""

    bus: LocalBus
    """Its topics, services and log are served."""

    @property
    def alert_systems(self) -> Sequence[AlertSystem]:
        """One per robot that is watched now."""

    @property
    def alert_system_pattern(self) -> str:
        """The full names of their nodes; `*` as in file names."""

    @property
    def self_report(self) -> Dict[str, Callable[[], str]]:
        """Key-values of the status of the process."""

    @property
    def faults(self) -> Faults:
        """Where a server that cannot be started is reported."""

    def parameters(self) -> Mapping[str, Mapping[str, Any]]:
        """Returns the parameters that clients may read, by the full name of the node."""

    def on_new_alert_system(self, callback: Callable[[AlertSystem], None]) -> None:
        """Calls back in the loop with each alert_system that is added later."""


def make_web(robots: Callable[[], Sequence[AlertSystem]], settings: ServerSettings, *, threads: bool) -> WebInterface:
    """Returns the page and its API, for `make_server`.

    Args:
        robots: returns the alert_systems of the robots that are watched now.
        settings: those of the server.
        threads: whether robots are judged in other threads than the server's loop.

    Raises:
        ModuleNotFoundError: a library is not installed.
    """
    from robot_health_monitor.ops.web import WebInterface

    web = WebInterface(robots, token=settings.token, threads=threads)
    for alert_system in robots():
        web.watch(alert_system)
    return web


def report_web(web: WebInterface, log: Callable[[Severity, str], None], settings: ServerSettings, port: int) -> None:
    """Logs the address of the page, and what is missing.

    Args:
        web: the page and its API.
        log: writes a line.
        settings: those of the server.
        port: its port.
    """
    log(Severity.INFO, f"web page: {page_address(settings.address, port)}")
    missing = web.missing()
    if missing is not None:
        log(Severity.WARN, missing)


def page_address(address: str, port: int) -> str:
    """Returns the address to open in a browser: of all addresses of this machine, its name."""
    host = platform.node() if address in ("0.0.0.0", "::", "") else address
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


async def serve(monitor: Served, settings: ServerSettings, *, required: bool) -> Optional[Server]:
    """Serves monitors in the running loop; `stop_serving` ends it.

    Args:
        monitor: what is served.
        settings: where to listen, and what clients may do.
        required: whether a port that is in use is an error.

    Returns:
        The server; None: it cannot be started, which is now a fault of alert_system.

    Raises:
        ConfigError: the address is not protected, or the required port cannot be opened.
    """
    node = monitor.bus.node("rosbridge")
    try:
        web = make_web(lambda: monitor.alert_systems, settings, threads=False)
        server = make_server(node, monitor.alert_system_pattern, settings, monitor.parameters, web, threads=False)
        await server.start()
    except ModuleNotFoundError as error:
        node.close()
        monitor.faults.report(_FAULT, f"not served: {error.name} is not installed")
        return None
    except OSError as error:
        node.close()
        problem = f"port {settings.port} of {settings.address} cannot be opened: {_cause(error)}"
        if required:
            raise ConfigError(f"{problem}; --port 0 picks a free one") from None
        monitor.faults.report(_FAULT, f"not served: {problem}; --port chooses another")
        return None
    monitor.on_new_alert_system(web.watch)
    _show_log(monitor, server)
    node.log(Severity.INFO, f"serving on ws://{settings.address}:{server.port}")
    report_web(web, node.log, settings, server.port)
    return server


async def stop_serving(server: Server) -> None:
    """Closes the port and every connection."""
    await asyncio.wait({asyncio.ensure_future(server.close())}, timeout=_CLOSE_S)


def serve_in_thread(
    create_node: Callable[[], ServedMiddleware], middleware: Middleware, alert_system: AlertSystem
) -> Optional[ServerThread]:
    """Serves what alert_system watches, as its configuration says. A failure never stops the monitoring.

    Args:
        create_node: creates the node for the server.
        middleware: the node of alert_system.
        alert_system: the node that is served.

    Returns:
        The running server; None: it cannot be started, which is now a fault of alert_system.
    """
    config = alert_system.monitor.config
    node: Optional[ServedMiddleware] = None
    try:
        from robot_health_monitor.rosbridge.server import ServerThread

        settings = _settings_of(config, middleware)
        node = create_node()
        given = middleware.given_parameters()
        web = make_web(lambda: [alert_system], settings, threads=True)
        server = make_server(node, middleware.name, settings, lambda: {middleware.name: given}, web, threads=True)
        thread = ServerThread(server)
    except ModuleNotFoundError as error:
        problem = f"{error.name} is not installed"
    except ConfigError as error:
        problem = str(error)
    except OSError as error:
        address = config.rosbridge_address
        problem = f"port {config.rosbridge_port} of {address} cannot be opened: {_cause(error)}"
    else:
        _report_server(alert_system.self_report, server)
        node.log(Severity.INFO, f"rosbridge: serving on ws://{settings.address}:{server.port}")
        report_web(web, node.log, settings, server.port)
        return thread
    if node is not None:
        node.close()
    middleware.faults.report(_FAULT, f"not served: {problem}")
    return None


def _cause(error: OSError) -> str:
    """Returns what the operating system says; asyncio puts the address before it."""
    return os.strerror(error.errno) if error.errno else str(error)


def _settings_of(config: MonitorConfig, middleware: Middleware) -> ServerSettings:
    def warn(text: str) -> None:
        middleware.log(Severity.WARN, text)

    token = find_token(config.rosbridge_token_file, warn)
    return ServerSettings(config.rosbridge_port, config.rosbridge_address, token)


def _show_log(monitor: Served, server: Server) -> None:
    """Publishes log lines and alerts on /rosout, which the local middleware lacks."""
    on_log = monitor.bus.on_log

    def publish_line(line: LogLine) -> None:
        on_log(line)
        server.publish_log(line)

    def add(alert_system: AlertSystem) -> None:
        def publish_event(event: Event) -> None:
            severity = _SEVERITY_OF_LEVEL[event.to_level] if isinstance(event, Transition) else event.severity
            server.publish_log(LogLine(event.now_s, alert_system.node_name, severity, event.text))

        alert_system.outlets.add("rosout", publish_event)

    monitor.bus.on_log = publish_line
    for alert_system in monitor.alert_systems:
        add(alert_system)
    monitor.on_new_alert_system(add)
    _report_server(monitor.self_report, server)


def _report_server(self_report: Dict[str, Callable[[], str]], server: Server) -> None:
    """Shows the server in the status of alert_system, or of the process."""
    self_report["clients"] = lambda: str(server.clients)
    self_report["clients_dropped"] = lambda: str(server.dropped)
