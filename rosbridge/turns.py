"""Shares the event loop between connections, so that no peer keeps it from the others.

Receiving a message that already waits does not yield to other tasks, and asyncio reads up to 256 kB at once, which very
small frames turn into most of a second of work.
"""

from __future__ import annotations

READ_BYTES = 16_384
"""Most bytes that are read at once.

Also makes each message cheaper: for the 256 kB of asyncio, glibc maps memory at every read and unmaps it again.
"""

TURN_S = 0.01
"""Longest time for which one connection is read while others wait, in s."""
_WAITED_S = 0.0005
"""A call of `receive` that took longer has waited for a message, and other tasks have run meanwhile."""


class Turns:
    """The turns of one connection."""

    def __init__(self, now_s: float) -> None:
        """Begins a turn.

        Args:
            now_s: monotonic seconds.
        """
        self._begin_s = self._done_s = now_s

    def note_received(self, now_s: float) -> None:
        """Call when a message was received, in s."""
        if now_s - self._done_s > _WAITED_S:
            self._begin_s = now_s

    def is_over(self, now_s: float) -> bool:
        """Call when a message was processed, in s; returns whether other tasks must run now: a new turn begins."""
        self._done_s = now_s
        if now_s - self._begin_s <= TURN_S:
            return False
        self._begin_s = now_s
        return True


def limit_reads(transport: object) -> None:
    """Makes a transport of asyncio read at most `READ_BYTES` at once. Those for TLS lack this setting."""
    if hasattr(transport, "max_size"):
        transport.max_size = READ_BYTES
