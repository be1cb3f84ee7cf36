"""Target `webhook`: posts each notification as JSON."""

from __future__ import annotations

from typing import Optional, Sequence

from ..configuration import TargetSettings
from .http_target import HttpTarget
from .notification import Notification, Notified


class Webhook:
    """Posts the JSON of `--json`, with the fields `notification` (firing or resolved) and `time`."""

    repeat_every_s: Optional[float] = None

    def __init__(self, settings: TargetSettings) -> None:
        """Connects only when something is sent."""
        self._target = HttpTarget(settings)

    @property
    def place(self) -> str:
        """Scheme and host."""
        return self._target.place

    @property
    def warning(self) -> str:
        """One line if other users may read the address."""
        return self._target.warning

    def send(self, notification: Notification) -> str:
        """Posts a notification.

        Raises:
            DeliveryError: no response, or another one than success.
        """
        return self._target.deliver(notification.as_json())

    def repeat(self, alerts: Sequence[Notified]) -> None:
        """Does nothing: a webhook keeps its own state."""

    def close(self) -> None:
        """Does nothing: the request ends with its timeout."""
