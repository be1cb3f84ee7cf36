"""Empties the send queues of slow clients, and disconnects those that do not catch up."""

from __future__ import annotations

import asyncio
from typing import Callable, Protocol, Set

from .send_queue import SendQueue

_PERIOD_S = 0.02


class SlowClient(Protocol):
    """A client with frames in its send queue."""

    @property
    def queue(self) -> SendQueue:
        """Its send queue."""

    def caught_up(self) -> None:
        """Called when the queue is empty again."""

    def abort(self) -> None:
        """Closes the connection at once."""


class SlowClients:
    """The clients that read more slowly than they are sent to."""

    def __init__(self, loop: asyncio.AbstractEventLoop, timeout_s: float, log: Callable[[str], None]) -> None:
        """Starts without clients.

        Args:
            loop: the server's loop.
            timeout_s: clients that are behind for longer are disconnected, in s.
            log: writes one line.
        """
        self._loop = loop
        self._timeout_s = timeout_s
        self._log = log
        self._clients: Set[SlowClient] = set()
        self._running = False

    def add(self, client: SlowClient) -> None:
        """Adds a client that is behind."""
        if client.queue.behind_since_s is None:
            client.queue.behind_since_s = self._loop.time()
        self._clients.add(client)
        if not self._running:
            self._running = True
            self._loop.call_later(_PERIOD_S, self._flush)

    def discard(self, client: SlowClient) -> None:
        """Removes a client that has left."""
        self._clients.discard(client)

    def _flush(self) -> None:
        now_s = self._loop.time()
        for client in tuple(self._clients):
            queue = client.queue
            queue.flush()
            if not queue.behind:
                queue.behind_since_s = None
                self._clients.discard(client)
                client.caught_up()
            elif queue.behind_since_s is not None and now_s - queue.behind_since_s > self._timeout_s:
                self._clients.discard(client)
                self._log(f"disconnected a client: behind for more than {self._timeout_s:g} s")
                client.abort()
        self._running = bool(self._clients)
        if self._running:
            self._loop.call_later(_PERIOD_S, self._flush)
