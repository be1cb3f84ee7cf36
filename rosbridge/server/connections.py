"""Limits the number of open connections.

If the limit is reached, a new connection replaces the oldest one that has not presented anything: first connections
without a complete request (or without the token, if one is required), then WebSockets that have sent no operation. The
former are also closed after a timeout.
"""

from __future__ import annotations

import enum
import resource
from typing import Any, Callable, Dict, Optional, Tuple

__all__ = ["Connections", "Stage", "connection_limit"]


class Stage(enum.IntEnum):
    """What a connection has presented. Lower ones are closed first."""

    OPENED = 0
    """Nothing yet, or not the token. Closed after the timeout."""
    ACCEPTED = 1
    """It may send operations, but has sent none."""
    ACTIVE = 2
    """It is in use. Never closed for others."""


class Connections:
    """The open connections. A connection is an object with `transport`, which is None once it is closed."""

    def __init__(self, limit: int, timeout_s: float, clock: Callable[[], float], on_full: Callable[[], None]) -> None:
        """Starts without connections.

        Args:
            limit: most open connections.
            timeout_s: connections in stage OPENED are closed after this time, in s.
            clock: monotonic seconds.
            on_full: called when the limit is reached, once until the number falls below nine tenths of it.
        """
        self._limit = limit
        self._timeout_s = timeout_s
        self._clock = clock
        self._on_full = on_full
        self._full = False
        self._stages: Dict[Any, Tuple[Stage, float]] = {}

    def __len__(self) -> int:
        return len(self._stages)

    def add(self, connection: Any) -> bool:
        """Adds a connection, in stage OPENED; returns False if there is no room for it."""
        if len(self._stages) >= self._limit:
            self._remove_closed()
        if len(self._stages) >= self._limit:
            if not self._full:
                self._full = True
                self._on_full()
            closable = [known for known in self._stages if known.transport is not None]
            oldest = min(closable, key=self._stages.__getitem__, default=None)
            if oldest is None or self._stages[oldest][0] is Stage.ACTIVE:
                return False
            self.abort(oldest)
        self._stages[connection] = (Stage.OPENED, self._clock())
        return True

    def set_stage(self, connection: Any, stage: Stage) -> None:
        """Changes the stage of a connection; its timeout begins anew."""
        if connection in self._stages:
            self._stages[connection] = (stage, self._clock())

    def opened_s(self, connection: Any) -> Optional[float]:
        """Returns since when a connection is in stage OPENED, in s; None in any other stage."""
        stage, since_s = self._stages.get(connection, (None, None))
        return since_s if stage is Stage.OPENED else None

    def sweep(self) -> None:
        """Closes connections that have been in stage OPENED for too long. Call every second."""
        self._remove_closed()
        now_s = self._clock()
        for connection, (stage, since_s) in tuple(self._stages.items()):
            if stage is Stage.OPENED and now_s - since_s > self._timeout_s:
                self.abort(connection)
        if len(self._stages) < 0.9 * self._limit:
            self._full = False

    def abort(self, connection: Any) -> None:
        """Closes a connection at once."""
        self._stages.pop(connection, None)
        if connection.transport is not None:
            connection.transport.abort()

    def abort_all(self) -> None:
        """Closes every connection at once. One that has just been accepted has no transport yet: call again later."""
        for connection in tuple(self._stages):
            if connection.transport is not None:
                self.abort(connection)

    def _remove_closed(self) -> None:
        for connection, (stage, _) in tuple(self._stages.items()):
            transport = connection.transport
            # A connection in stage OPENED has no transport yet during the TLS handshake.
            if (transport is None and stage is not Stage.OPENED) or (transport is not None and transport.is_closing()):
                del self._stages[connection]


def connection_limit(requested: int) -> int:
    """Returns a limit that leaves at least half of the process's file descriptors to others."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return requested if descriptors == resource.RLIM_INFINITY else max(1, min(requested, descriptors // 2))
