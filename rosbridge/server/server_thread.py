"""The rosbridge server beside ROS: an event loop in a thread of its own."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.middleware import ServedMiddleware, Severity

from ..loop_thread import LoopThread
from .access import monitor_access
from .server import Server


class ServerThread:
    """A server that serves what the alert node of this process watches."""

    def __init__(
        self,
        middleware: ServedMiddleware,
        alert_system: str,
        topics: Sequence[str],
        given: Mapping[str, Any],
        *,
        host: str,
        port: int,
        token: str,
    ) -> None:
        """Opens the port.

        Args:
            middleware: a node of its own for the server, with threads of its own; not closed here.
            alert_system: the fully qualified name of the alert node.
            topics: the topics of its signals, as the node names them.
            given: its parameters, for clients to look at; the token is kept from them.
            host: address to listen on.
            port: port to listen on.
            token: what clients have to show; empty: nothing.

        Raises:
            ConfigError: the port cannot be had, or is not protected.
        """
        shown = {name: value for name, value in given.items() if name != "rosbridge_token"}
        server = Server(
            middleware,
            host=host,
            port=port,
            access=monitor_access(alert_system, topics, token=token),
            parameters=lambda: {alert_system: shown},
        )
        self._server = server
        self._thread = LoopThread()
        try:
            self._thread.call(server.start())
        except OSError as error:
            self._thread.close()
            problem = f"found {port}, but that port of {host} cannot be had: {error.strerror or error}"
            raise ConfigError(problem, ("rosbridge_port",)) from None
        middleware.log(Severity.INFO, f"rosbridge: serving on ws://{host}:{server.port}")

    @property
    def port(self) -> int:
        """The port."""
        return self._server.port

    def close(self) -> None:
        """Says goodbye to every client and closes the port."""
        self._thread.call(self._server.close())
        self._thread.close()
