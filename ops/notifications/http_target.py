"""Requests to a target over HTTP, with failures as `DeliveryError`."""

from __future__ import annotations

from typing import Optional

from robot_health_monitor.core.formatting import duration_text

from ..configuration import TargetSettings
from .address import Address
from .http_request import Answer, request
from .sender import DeliveryError

_RETRIED = (408, 429)
"""Responses 4xx that are temporary: Request Timeout, Too Many Requests."""


class HttpTarget:
    """A target that is called over HTTP."""

    def __init__(self, settings: TargetSettings) -> None:
        """Connects only when something is sent."""
        self._address = Address(settings)
        self._timeout_s = settings.timeout_s

    @property
    def place(self) -> str:
        """Scheme and host of the address."""
        return self._address.place

    @property
    def warning(self) -> str:
        """One line if other users may read the address; empty: no."""
        return self._address.warning

    def call(self, body: Optional[str], path: str = "") -> Answer:
        """Sends a request and returns the response, of any status.

        Args:
            body: JSON to POST; None: GET.
            path: appended to the address.

        Raises:
            DeliveryError: no response.
        """
        url = self._address.http()
        if path:
            url = url.rstrip("/")
            url = url if url.endswith(path) else url + path
        return request(url, None if body is None else body.encode("utf-8", "replace"), self._timeout_s)

    def deliver(self, body: Optional[str], path: str = "") -> str:
        """Sends a request and returns the status of the response.

        Raises:
            DeliveryError: no response, or another one than success (2xx).
        """
        answer = self.call(body, path)
        return self.require_success(answer)

    def require_success(self, answer: Answer) -> str:
        """Returns the status of a response.

        Raises:
            DeliveryError: another response than success (2xx).
        """
        title = answer.standard_title if self._address.is_secret else answer.title
        if answer.is_success:
            return title
        text = f"response {title}"
        if 300 <= answer.status < 400:
            text += "; redirects are not followed"
        elif answer.text and not self._address.is_secret:  # a page that says "not found" may repeat the address
            text += f": {answer.text}"
        if answer.retry_after_s:
            text += f"; the server asks to wait {duration_text(answer.retry_after_s)}"
        is_refused = 400 <= answer.status < 500 and answer.status not in _RETRIED
        raise DeliveryError(text, is_refused=is_refused, retry_after_s=answer.retry_after_s)
