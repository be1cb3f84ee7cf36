"""Target `webhook`: posts each notification as JSON."""

from __future__ import annotations

from .http_target import HttpTarget
from .notification import Notification
from .sender import Sender


class Webhook(HttpTarget, Sender):
    """Posts the JSON of `--json`, with the fields `notification` (firing or resolved) and `time`."""

    def send(self, notification: Notification) -> str:
        """Posts a notification.

        Raises:
            DeliveryError: no response, or another one than success.
        """
        return self.deliver(notification.as_json())
