"""Target `apprise`: every service that the library Apprise knows. The library is optional."""

from __future__ import annotations

import importlib
import logging
from typing import Any

from ...core.values import Level
from ...runtime.libraries import missing_text
from .sender import DeliveryError, Notification, Sender

_MOST_REMEMBERED = 1_000  # notifications
_TYPES = {Level.OK: "info", Level.WARN: "warning", Level.STALE: "warning", Level.ERROR: "failure"}


class AppriseTarget(Sender):
    """Sends the alert line to one or several addresses of Apprise, one per line of `url_file`.

    Apprise's own timeouts apply; `?rto=` and `?cto=` in an address change them.
    """

    def __init__(self, *arguments: Any) -> None:
        """Imports nothing yet: the library is large."""
        super().__init__(*arguments)
        self._accepted: dict[str, set[str]] = {}
        """The addresses that have accepted a notification which others have not: those are not sent it again."""

    def send(self, notification: Notification) -> str:
        """Sends a notification to every address that has not accepted it before; see `Sender.send`."""
        try:
            library = importlib.import_module("apprise")
        except ImportError:
            raise DeliveryError(missing_text(["apprise"]), may_have_arrived=False) from None
        logging.getLogger("apprise").disabled = True  # its lines contain addresses
        state = "resolved" if notification.is_resolved else notification.level.name
        title = f"{'TEST ' if notification.is_test else ''}{notification.robot}: {notification.signal} {state}"
        kind = "success" if notification.is_resolved else _TYPES[notification.level]
        key = notification.as_json()
        further = [value for name, value in notification.annotations.items() if name != "black_box"]
        body = "\n".join([notification.text, *further])
        accepted = self._accepted.pop(key, set())
        errors: list[DeliveryError] = []
        for number, url in enumerate(self.addresses(), start=1):
            if url not in accepted:
                try:
                    _deliver(library, url, number, body=body, title=title, notify_type=kind)
                    accepted.add(url)
                except DeliveryError as error:
                    errors.append(error)
        if errors:
            self._accepted[key] = accepted
            if len(self._accepted) > _MOST_REMEMBERED:
                del self._accepted[next(iter(self._accepted))]
            may_have_arrived = bool(accepted) or any(error.may_have_arrived for error in errors)
            raise DeliveryError(str(errors[0]), may_have_arrived=may_have_arrived)
        return "delivered"


def _deliver(library: Any, url: str, number: int, **message: str) -> None:
    """Sends a message to one address, which errors show by its number."""
    service = library.Apprise()
    if not service.add(url):
        raise DeliveryError(f"Apprise does not accept address {number}", may_have_arrived=False)
    try:
        is_delivered = service.notify(**message)
    except Exception as error:  # its text may contain the address
        raise DeliveryError(f"Apprise failed for address {number} ({type(error).__name__})") from None
    if not is_delivered:
        raise DeliveryError(f"Apprise could not deliver it to address {number}")
