"""Limits the number of open connections.

If the limit is reached, a new connection replaces the oldest one that has presented least: first connections that have
not presented the token (or, where none is required, no complete request), whatever they have begun; then those that
wait for the next request; then WebSockets that have sent no operation. The first two are also closed after a timeout.
"""

from __future__ import annotations

import enum
import resource
from typing import Callable, Dict, Optional, Protocol


class Closable(Protocol):
    """An open connection."""

    def abort(self) -> None:
        """Closes it at once."""


class Stage(enum.IntEnum):
    """What a connection has presented. Lower ones are closed first."""

    OPENED = 0
    """Nothing yet, or not the token: in the TLS handshake, within a request, or served without a token. Closed after
    the timeout."""
    KNOWN = 1
    """It has presented the token, and waits for its next request. Closed after the timeout."""
    ACCEPTED = 2
    """It may send operations, but has sent none."""
    ACTIVE = 3
    """It is in use. Never closed for others."""


class Connections:
    """The open connections, in each stage the oldest first."""

    def __init__(self, limit: int, timeout_s: float, clock: Callable[[], float], on_full: Callable[[], None]) -> None:
        """Starts without connections.

        Args:
            limit: most open connections.
            timeout_s: connections in the stages OPENED and KNOWN are closed after this time, in s.
            clock: monotonic seconds.
            on_full: called when the limit is reached, once until the number falls below nine tenths of it.
        """
        self._limit = limit
        self._timeout_s = timeout_s
        self._clock = clock
        self._on_full = on_full
        self._full = False
        self._stages: Dict[Closable, Stage] = {}
        self._since_s: Dict[Stage, Dict[Closable, float]] = {stage: {} for stage in Stage}

    def __len__(self) -> int:
        return len(self._stages)

    def add(self, connection: Closable) -> bool:
        """Adds a connection, in stage OPENED; returns False if there is no room for it."""
        if len(self._stages) >= self._limit:
            if not self._full:
                self._full = True
                self._on_full()
            replaceable = (one for stage in sorted(Stage)[: Stage.ACTIVE] for one in self._since_s[stage])
            oldest = next(replaceable, None)
            if oldest is None:
                return False
            self.abort(oldest)
        self._stages[connection] = Stage.OPENED
        self._since_s[Stage.OPENED][connection] = self._clock()
        return True

    def set_stage(self, connection: Closable, stage: Stage) -> None:
        """Changes the stage of a connection; its timeout begins anew, also in the same stage."""
        before = self._stages.get(connection)
        if before is None:
            return
        if before is not stage:
            del self._since_s[before][connection]
            self._stages[connection] = stage
        self._since_s[stage][connection] = self._clock()  # in the same stage it keeps its place

    def waiting_since_s(self, connection: Closable) -> Optional[float]:
        """Returns since when a connection is in stage OPENED or KNOWN, in s; None in any other stage."""
        stage = self._stages.get(connection, Stage.ACTIVE)
        return self._since_s[stage][connection] if stage <= Stage.KNOWN else None

    def sweep(self) -> None:
        """Closes connections that have been in stage OPENED or KNOWN for too long. Call every second."""
        latest_s = self._clock() - self._timeout_s
        for stage in (Stage.OPENED, Stage.KNOWN):
            for connection in [one for one, since_s in self._since_s[stage].items() if since_s < latest_s]:
                self.abort(connection)
        if len(self._stages) < 0.9 * self._limit:
            self._full = False

    def abort(self, connection: Closable) -> None:
        """Closes a connection at once."""
        self.remove(connection)
        connection.abort()

    def abort_all(self) -> None:
        """Closes every connection at once."""
        for connection in tuple(self._stages):
            self.abort(connection)

    def remove(self, connection: Closable) -> None:
        """Removes a connection that is closed."""
        stage = self._stages.pop(connection, None)
        if stage is not None:
            del self._since_s[stage][connection]


def connection_limit(requested: int) -> int:
    """Returns a limit that leaves at least half of the process's file descriptors to others."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return requested if descriptors == resource.RLIM_INFINITY else max(1, min(requested, descriptors // 2))
