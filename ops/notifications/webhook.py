"""Target `webhook`: posts each notification as JSON. Also what all targets over HTTP have in common."""

from __future__ import annotations

import http.client
from typing import Optional

from robot_health_monitor.core.formatting import duration_text

from ..configuration import TargetSettings
from .http_request import Answer, request
from .notification import Notification
from .sender import Address, DeliveryError, Sender

_RETRIED = (408, 429)
"""Responses 4xx that are temporary: Request Timeout, Too Many Requests."""


class HttpTarget(Address):
    """A target that is called over HTTP, with failures as `DeliveryError`."""

    def __init__(self, settings: TargetSettings) -> None:
        """Connects only when something is sent."""
        super().__init__(settings)
        self._timeout_s = settings.timeout_s

    def call(self, body: Optional[str], path: str = "") -> Answer:
        """Sends a request and returns the response, of any status.

        Args:
            body: JSON to POST; None: GET.
            path: appended to the address.

        Raises:
            DeliveryError: no response.
        """
        url = self.http_address()
        if path:
            url = url.rstrip("/")
            url = url if url.endswith(path) else url + path
        return request(url, None if body is None else body.encode(), self._timeout_s)

    def deliver(self, body: Optional[str]) -> str:
        """Sends a request, as `call`, and returns the status of its response, as `status_of`."""
        return self.status_of(self.call(body))

    def status_of(self, answer: Answer) -> str:
        """Returns the status of a response.

        Raises:
            DeliveryError: another response than success (2xx).
        """
        status = answer.status
        reason = http.client.responses.get(status, "") if self.is_secret else answer.reason
        title = f"{status} {reason}".strip()
        if 200 <= status < 300:
            return title
        text = f"response {title}"
        if 300 <= status < 400:
            text += "; redirects are not followed"
        elif answer.text and not self.is_secret:  # a page that says "not found" may repeat the address
            text += f": {answer.text}"
        if answer.retry_after_s:
            text += f"; the server asks to wait {duration_text(answer.retry_after_s)}"
        is_refused = 400 <= status < 500 and status not in _RETRIED
        raise DeliveryError(text, is_refused=is_refused, retry_after_s=answer.retry_after_s)


class Webhook(HttpTarget, Sender):
    """Posts the JSON of `--json`, with the fields `notification` (firing or resolved) and `time`."""

    def send(self, notification: Notification) -> str:
        """Posts a notification."""
        return self.deliver(notification.as_json())
