"""Notices a peer that floods a connection with frames that carry nothing: pings, pongs and empty messages.

aiohttp stops reading from a connection while the messages that wait exceed a size. These frames have none: any number
of them may wait, and each costs time.
"""

from __future__ import annotations

MOST_PER_SECOND = 100
"""Most frames without content in one second. Healthy peers send one every few seconds."""


class FloodLimit:
    """Counts the frames without content of one connection."""

    def __init__(self) -> None:
        """Starts with none."""
        self._begin_s = float("-inf")
        self._count = 0

    def is_exceeded(self, now_s: float) -> bool:
        """Counts a frame; returns whether there have been too many within a second.

        Args:
            now_s: monotonic seconds.
        """
        if now_s - self._begin_s >= 1.0:
            self._begin_s, self._count = now_s, 0
        self._count += 1
        return self._count > MOST_PER_SECOND
