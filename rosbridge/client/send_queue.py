"""What waits to be sent to the server, bounded in bytes."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Deque

from ..protocol import Wire


class SendQueue:
    """WebSocket messages on their way to one server. Used in the event loop only."""

    def __init__(self, bound_bytes: int = 4_000_000) -> None:
        """Starts empty.

        Args:
            bound_bytes: most bytes that may wait.
        """
        self._bound_bytes = bound_bytes
        self._wires: Deque[Wire] = deque()
        self._bytes = 0
        self._filled = asyncio.Event()
        self.dropped = 0
        """How many messages did not fit."""

    def put(self, wire: Wire) -> bool:
        """Adds a message; returns False if it does not fit."""
        if self._bytes + len(wire) > self._bound_bytes:
            self.dropped += 1
            return False
        self._wires.append(wire)
        self._bytes += len(wire)
        self._filled.set()
        return True

    async def get(self) -> Wire:
        """Waits for the next message and removes it."""
        while not self._wires:
            self._filled.clear()
            await self._filled.wait()
        wire = self._wires.popleft()
        self._bytes -= len(wire)
        return wire
