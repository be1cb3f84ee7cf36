"""Target `apprise`: every service that the library Apprise knows. The library is optional."""

from __future__ import annotations

import importlib
import logging
from typing import Any, Optional, Sequence

from robot_health_monitor.core.model import Level

from ..configuration import TargetSettings
from .address import Address
from .notification import Notification, Notified
from .sender import DeliveryError

MISSING = "apprise is not installed: pip install apprise"

_TYPES = {Level.OK: "info", Level.WARN: "warning", Level.STALE: "warning", Level.ERROR: "failure"}


class AppriseTarget:
    """Sends the alert line to one or several addresses of Apprise, one per line of `url_file`.

    Apprise's own timeouts apply; `?rto=` and `?cto=` in an address change them.
    """

    repeat_every_s: Optional[float] = None

    def __init__(self, settings: TargetSettings) -> None:
        """Imports nothing yet: the library is large."""
        self._address = Address(settings)

    @property
    def place(self) -> str:
        """The kinds of services."""
        return self._address.place

    @property
    def warning(self) -> str:
        """One line if other users may read the addresses."""
        return self._address.warning

    def send(self, notification: Notification) -> str:
        """Sends a notification.

        Raises:
            DeliveryError: the library is missing, does not know an address, or a service did not accept it.
        """
        library = self._library()
        service = library.Apprise()
        for number, url in enumerate(self._address.lines(), start=1):
            if not service.add(url):
                raise DeliveryError(f"Apprise does not accept address {number}", may_have_arrived=False)
        state = "resolved" if notification.is_resolved else notification.level.name
        title = f"{'TEST ' if notification.is_test else ''}{notification.robot}: {notification.signal} {state}"
        kind = "success" if notification.is_resolved else _TYPES[notification.level]
        try:
            delivered = service.notify(body=notification.text, title=title, notify_type=kind)
        except Exception as error:  # its text may contain the address
            raise DeliveryError(f"Apprise failed ({type(error).__name__})") from None
        if not delivered:
            raise DeliveryError("Apprise could not deliver it")
        return "delivered"

    def repeat(self, alerts: Sequence[Notified]) -> None:
        """Does nothing: a message is sent once."""

    def close(self) -> None:
        """Does nothing: the request ends with Apprise's timeout."""

    @staticmethod
    def _library() -> Any:
        try:
            library = importlib.import_module("apprise")
        except ImportError:
            raise DeliveryError(MISSING, may_have_arrived=False) from None
        logging.getLogger("apprise").disabled = True  # its lines contain addresses
        return library
