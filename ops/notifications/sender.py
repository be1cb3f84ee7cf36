"""The interface of a target: delivers one notification per call, or raises a `DeliveryError`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Optional, Sequence

from robot_health_monitor.core.errors import ServiceError

from .notification import Notification, Notified


class DeliveryError(ServiceError):
    """One attempt failed. `str()` is one line, without secrets: of an address only scheme and host."""

    def __init__(
        self,
        text: str,
        *,
        is_refused: bool = False,
        may_have_arrived: bool = True,
        retry_after_s: float = 0.0,
        is_corrected: bool = False,
    ) -> None:
        """Stores what is known.

        Args:
            text: what failed and why.
            is_refused: the target rejects this notification; another attempt will probably fail as well.
            may_have_arrived: False: the target certainly did not receive it.
            retry_after_s: the target requests this wait, in s.
            is_corrected: the cause was on this side and is corrected; another attempt will probably succeed.
        """
        super().__init__(text)
        self.is_refused = is_refused
        self.may_have_arrived = may_have_arrived
        self.retry_after_s = retry_after_s
        self.is_corrected = is_corrected


class Sender(ABC):
    """Delivers notifications to one target; used by one thread. A call may block until the target's timeout."""

    repeat_every_s: Optional[float] = None
    """Period at which open alerts are repeated, in s; None: they are sent once."""

    @property
    @abstractmethod
    def place(self) -> str:
        """Where the target is, without secrets."""

    @property
    def warning(self) -> str:
        """One line about the target that is no failure, such as an unprotected secret; empty: none."""
        return ""

    @abstractmethod
    def send(self, notification: Notification) -> str:
        """Delivers a notification and returns how the target responded.

        Raises:
            DeliveryError: it failed.
        """

    def repeat(self, alerts: Sequence[Notified]) -> None:  # noqa: B027 - optional
        """Repeats open alerts; called only with `repeat_every_s`.

        Raises:
            DeliveryError: it failed.
        """

    def close(self) -> None:  # noqa: B027 - optional
        """Ends a call of `send` in another thread early, where that is possible."""
