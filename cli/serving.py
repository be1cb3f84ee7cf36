"""Starts a rosbridge server beside an alert_system. Every executable that serves clients starts it here."""

from __future__ import annotations

import asyncio
import os
import ssl
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Callable, Sequence

from ..core.nodes.node import host_name
from ..core.nodes.outlets import Event, event_severity, event_text
from ..core.port import LogLine, Middleware, ServedMiddleware, Severity
from ..core.values import ConfigError
from ..ops.configuration import ServerOptions
from ..runtime.libraries import ROSBRIDGE, missing_libraries, missing_text
from ..runtime.tokens import TokenFiles
from .output.lines import Monitors

if TYPE_CHECKING:
    from ..core.config.monitor_config import MonitorConfig
    from ..core.nodes import AlertSystem
    from ..ops.web import WebInterface
    from ..rosbridge.server import Server, ServerThread
    from .operations import Operations

DEFAULT_PORT = 9090
DEFAULT_ADDRESS = "127.0.0.1"
_FAULT = "server"
_OFF = "web page and rosbridge are off"
_CLOSE_S = 2.5
"""Longest time to close the port and the connections; the server itself takes at most 2 s."""


@dataclass(frozen=True)
class ServerSettings(ServerOptions):
    """Where a server listens, and what its clients may do besides reading.

    Patterns may contain `*` and `?` as in file names. Clients may always call rosapi, and `reset` and `reload` of
    alert_system.
    """

    port: int = DEFAULT_PORT
    """0 picks a free one."""
    address: str = DEFAULT_ADDRESS
    """Any address except loopback requires a token."""
    token: str = ""
    """Token that clients must present; empty if none is required."""
    origins: Sequence[str] = ()
    """Origins of web pages that may connect, besides those of this machine."""


def server_settings(
    config: MonitorConfig | None,
    options: ServerOptions | None,
    arguments: ServerOptions | None = None,
    origins: Sequence[str] = (),
    *,
    tokens: TokenFiles,
) -> ServerSettings:
    """Returns the settings of a server: each value from the first source that sets it, otherwise the default.

    The command line comes first, then the parameters `rosbridge_...` of the alert_system, then `options`, the section
    `server` of ops.yaml. Without a `config`, for several robots, the token comes from a file alone: the variable has
    that of the robots. Raises ConfigError if the token file cannot be used.
    """
    values: dict[str, Any] = {}
    parameters = ServerOptions()
    if config is not None:
        address = config.rosbridge_address if config.rosbridge_address != DEFAULT_ADDRESS else ""
        parameters = ServerOptions(config.rosbridge_port or None, address, config.rosbridge_token_file)
    for source in (options or ServerOptions(), parameters, arguments or ServerOptions()):
        values.update((name, value) for name, value in vars(source).items() if value not in (None, "", ()))
    file = values.pop("token_file", "")
    token = "" if config is None and not file else tokens.find_own(file)
    return ServerSettings(**values, token=token, origins=origins)


class _BesideRos:
    """The one alert_system of a ROS process, as `Monitors` show theirs."""

    def __init__(self, alert_system: AlertSystem, middleware: Middleware) -> None:
        self.alert_systems = [alert_system]
        self.alert_system_pattern = middleware.name
        self.parameters = lambda: {middleware.name: middleware.given_parameters()}
        self.process_faults = dict


def _make_server(
    node: ServedMiddleware,
    settings: ServerSettings,
    monitors: Monitors | _BesideRos,
    operations: Operations,
    *,
    threads: bool,
) -> tuple[Server, WebInterface]:
    """Returns a server that is not started, and its page. `node` is not closed here.

    With `threads`, the node is called back, and robots are judged, in other threads than the server's loop. Raises
    ConfigError if the address is not protected or the certificate cannot be used, ModuleNotFoundError if a library is
    not installed.
    """
    from ..ops.web import WebInterface
    from ..rosbridge.server import Access, Server

    web = WebInterface(
        lambda: monitors.alert_systems,
        operations.history,
        operations.silences,
        threads=threads,
        black_boxes=None if operations.black_box is None else operations.black_box.settings.folder,
        notifications_waiting=lambda: operations.notifier.waiting,
        process_faults=monitors.process_faults,
    )
    pattern = monitors.alert_system_pattern
    services = (f"{pattern}/reset", f"{pattern}/reload", *settings.allow_call)
    server = Server(
        node,
        host=settings.address,
        port=settings.port,
        access=Access(settings.allow_publish, services, settings.allow_offer, settings.origins, settings.token),
        threads=threads,
        parameters=monitors.parameters,
        routes=web.routes,
        on_close=web.close,
        ssl_context=_tls_context(settings),
    )
    return server, web


def _tls_context(settings: ServerSettings) -> ssl.SSLContext | None:
    """Returns the TLS context of a server, None without TLS; raises ConfigError if it cannot be made."""
    if not settings.tls_certificate:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        # With an empty password, a key that is encrypted is an error; otherwise OpenSSL asks on the terminal.
        context.load_cert_chain(settings.tls_certificate, settings.tls_key, password="")
    except (OSError, ValueError) as error:  # SSLError is an OSError
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or error
        problem = f"cannot be used as a certificate with the key {settings.tls_key}: {reason}"
        raise ConfigError(problem, file=settings.tls_certificate) from None
    return context


def _report_start(
    server: Server, settings: ServerSettings, log: Callable[[Severity, str], None], subject: str = ""
) -> None:
    """Logs the addresses of a server and its page."""
    secure = "s" if settings.tls_certificate else ""
    log(Severity.INFO, f"{subject}serving on ws{secure}://{settings.address}:{server.port}")
    log(Severity.INFO, f"web page: {page_address(settings.address, server.port, f'http{secure}')}")


def page_address(address: str, port: int, scheme: str = "http") -> str:
    """Returns the address to open in a browser: of all addresses of this machine, its name."""
    host = host_name() if address in ("0.0.0.0", "::", "") else address
    return f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}/"


async def serve(
    monitor: Monitors, settings: ServerSettings, operations: Operations, *, required: bool
) -> Server | None:
    """Serves monitors, and what the page shows of `operations`, in the running loop; `stop_serving` ends it.

    Returns None if the server cannot be started, which is now a fault of alert_system. Raises ConfigError if the
    address is not protected, or if the port cannot be opened and is `required`.
    """
    node = monitor.bus.node("rosbridge")
    try:
        server, web = _make_server(node, settings, monitor, operations, threads=False)
        await server.start()
    except (ModuleNotFoundError, OSError) as error:
        node.close()
        problem = _problem(error, settings)
        if isinstance(error, OSError):
            if required:
                raise ConfigError(f"{problem}; --port 0 picks a free one") from None
            problem += "; --port chooses another"
        monitor.node.faults.report(_FAULT, f"{_OFF}: {problem}")
        return None
    monitor.bus.add_log(server.publish_log)

    def watch(alert_system: AlertSystem) -> None:
        def publish(event: Event) -> None:
            line = LogLine(event.now_s, alert_system.node_name, event_severity(event), event_text(event))
            server.publish_log(line)

        web.watch(alert_system)
        alert_system.outlets.add("rosout", publish)  # which the local middleware lacks

    for each in monitor.alert_systems:
        watch(each)
    operations.on_start.append(watch)
    operations.server = server
    _report_start(server, settings, node.log)
    return server


async def stop_serving(server: Server) -> None:
    """Closes the port and every connection."""
    await asyncio.wait({asyncio.ensure_future(server.close())}, timeout=_CLOSE_S)


def serve_in_thread(
    create_node: Callable[[], ServedMiddleware],
    middleware: Middleware,
    alert_system: AlertSystem,
    operations: Operations,
) -> ServerThread | None:
    """Serves what alert_system watches, beside ROS; `create_node` creates the node for the server.

    Returns the running server. Returns None if it cannot be started: that is a fault of alert_system and stops nothing.
    """
    node: ServedMiddleware | None = None
    settings = ServerSettings(0)
    try:
        from ..rosbridge.server import ServerThread

        tokens = TokenFiles(lambda text: middleware.log(Severity.WARN, text))
        settings = server_settings(alert_system.monitor.config, operations.config.server, tokens=tokens)
        node = create_node()
        monitors = _BesideRos(alert_system, middleware)
        server, web = _make_server(node, settings, monitors, operations, threads=True)
        thread = ServerThread(server)
    except (ModuleNotFoundError, ConfigError, OSError) as error:
        if node is not None:
            node.close()
        middleware.faults.report(_FAULT, f"{_OFF}: {_problem(error, settings)}")
        return None
    web.watch(alert_system)
    operations.server = server
    _report_start(server, settings, node.log, "rosbridge: ")
    return thread


def _problem(error: Exception, settings: ServerSettings) -> str:
    """Returns why a server cannot be started."""
    if isinstance(error, ModuleNotFoundError):
        return missing_text(missing_libraries(error, *ROSBRIDGE))
    if isinstance(error, OSError):
        cause = os.strerror(error.errno) if error.errno else str(error)  # asyncio puts the address before it
        return f"port {settings.port} of {settings.address} cannot be opened: {cause}"
    return str(error)
