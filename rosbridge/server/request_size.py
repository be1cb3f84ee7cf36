"""Limits what a connection may send before it has presented a complete request, and the token where one is required.

Older versions of aiohttp (up to 3.10, the last for Python 3.8) keep any number of headers.
"""

from __future__ import annotations

import asyncio
from typing import Any, Callable, Optional

__all__ = ["MOST_REQUEST_BYTES", "SizeLimitedProtocol"]

MOST_REQUEST_BYTES = 131_072
"""Size of a request, or of its head if its body is read later, and of a first message with the token."""


class SizeLimitedProtocol(asyncio.Protocol):
    """Passes the events of a connection on to another protocol, until the connection sends too much."""

    def __init__(
        self, protocol: Any, waiting_since_s: Callable[[], Optional[float]], on_excess: Callable[[], None]
    ) -> None:
        """Starts before the connection is made.

        Args:
            protocol: receives the events.
            waiting_since_s: returns since when the server waits for a request of this connection, in s; None while it
                does not.
            on_excess: closes the connection.
        """
        self._protocol = protocol
        self._waiting_since_s = waiting_since_s
        self._on_excess = on_excess
        self._since_s: Optional[float] = None
        self._received = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Passes the event on."""
        self._protocol.connection_made(transport)

    def connection_lost(self, exc: Optional[Exception]) -> None:
        """Passes the event on."""
        self._protocol.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Passes data on, up to the limit."""
        since_s = self._waiting_since_s()
        if since_s is not None:
            if since_s != self._since_s:
                self._since_s, self._received = since_s, 0
            self._received += len(data)
            if self._received > MOST_REQUEST_BYTES:
                self._on_excess()
                return
        self._protocol.data_received(data)

    def eof_received(self) -> Optional[bool]:
        """Passes the event on."""
        keep_open: Optional[bool] = self._protocol.eof_received()
        return keep_open

    def pause_writing(self) -> None:
        """Passes the event on."""
        self._protocol.pause_writing()

    def resume_writing(self) -> None:
        """Passes the event on."""
        self._protocol.resume_writing()
