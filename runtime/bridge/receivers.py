"""What the subscriptions over every bridge share: reports of messages that cannot be read."""

from __future__ import annotations

from ...core.port import LoggedSubscription
from ...core.values import Level


class BridgeReceiver(LoggedSubscription):
    """A node's subscription to a topic. Messages that are too large are a fault until one can be read."""

    active: bool
    dropped = 0
    """Messages that were too large to be read."""
    largest_bytes: float
    """Size above which messages are not decoded."""
    _is_dropping = False

    def too_large(self, size_bytes: int) -> None:
        """Reports a dropped message."""
        self._is_dropping = True
        self.dropped += 1
        sizes = f"{size_bytes / 1e6:.1f} MB (limit {self.largest_bytes / 1e6:.1f} MB)"
        text = f"dropped {self.dropped} messages, the last of {sizes}"
        self._node.faults.report(f"topic {self.topic}", text, Level.WARN)

    def note_readable(self) -> None:
        """Ends the fault."""
        if self._is_dropping:
            self._is_dropping = False
            self._node.faults.clear(f"topic {self.topic}")

    def note_mismatch(self, error: Exception) -> None:
        """Logs once that a message does not match its type."""
        self.log_once(f"{self.topic}: a message does not match its type: {error}")

    def end(self) -> None:
        """Ends the subscription and its fault."""
        self.active = False
        self.note_readable()
