"""A rosbridge server with its event loop in a thread, for processes whose main thread runs ROS."""

from __future__ import annotations

import asyncio
import concurrent.futures
from typing import Any, Dict

from robot_health_monitor.runtime.threads import LoopThread

from .server import Server

_CLOSE_TIMEOUT_S = 4.0


class ServerThread:
    """Runs a server until `close`."""

    def __init__(self, server: Server) -> None:
        """Opens the port.

        Args:
            server: the server, not started.

        Raises:
            OSError: the port is in use, or the address is not one of this machine.
        """
        self.server = server
        self._thread = LoopThread()
        self._thread.loop.set_exception_handler(self._log_failure)
        try:
            self._thread.call(server.start())
        except BaseException:
            self._thread.close()
            raise

    def close(self) -> None:
        """Closes the port, then every connection. May be called twice."""
        if not self._thread.alive:
            return
        try:
            self._thread.call(self.server.close(), _CLOSE_TIMEOUT_S)
        except concurrent.futures.TimeoutError:
            pass  # the thread's end closes what is left
        self._thread.close()

    def _log_failure(self, loop: asyncio.AbstractEventLoop, context: Dict[str, Any]) -> None:
        error = context.get("exception")
        cause = f": {type(error).__name__}: {error}" if error else ""
        self.server.log(f"{context.get('message', 'unexpected error')}{cause}")
