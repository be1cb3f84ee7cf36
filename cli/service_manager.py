"""Reports to systemd that the process has started, is alive, or is ending (sd_notify(3)).

systemd asks for this with NOTIFY_SOCKET (`Type=notify`), and for signs of life with WATCHDOG_USEC (`WatchdogSec=`).
Elsewhere, nothing is sent.
"""

from __future__ import annotations

import os
import time
from typing import MutableMapping

from ..core.values import Clock

_LONGEST_TICK_AGE_S = 5.0


class ServiceManager:
    """The connection to the service manager that started this process. Never raises and never waits."""

    def __init__(self, environment: MutableMapping[str, str] = os.environ, clock: Clock = time.monotonic) -> None:
        """Takes the variables of systemd out of the environment: they are not for commands that this process starts."""
        self._clock = clock
        self._address = environment.pop("NOTIFY_SOCKET", "")
        limit_us = environment.pop("WATCHDOG_USEC", "")
        is_meant = environment.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._limit_s = float(limit_us) / 1e6 if limit_us.isdigit() and is_meant else 0.0
        self._alive_at_s: float | None = None
        self.watchdog_period_s = self._limit_s / 2.0 if self._address and self._limit_s else None
        """Longest time between two calls of `alive`, in s; None if systemd does not watch this process."""

    def ready(self) -> None:
        """To be called when everything has started."""
        self._send("READY=1")

    def alive(self, tick_age_s: float) -> None:
        """Sends a sign of life if one is due. Call it in the thread that runs the ticks.

        If the last tick is too old, nothing is sent, and systemd restarts the process.
        """
        period_s = self.watchdog_period_s
        if period_s is None or tick_age_s > max(_LONGEST_TICK_AGE_S, self._limit_s):
            return
        now_s = self._clock()
        # Half a period early rather than one call too late.
        if self._alive_at_s is None or now_s - self._alive_at_s >= period_s / 2.0:
            self._alive_at_s = now_s
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """To be called when the end begins."""
        self._send("STOPPING=1")

    def _send(self, state: str) -> None:
        if not self._address:
            return
        import socket  # takes 0.3 MB, and most processes are not started by systemd

        # "@name" is a name in Linux's abstract namespace, which begins with a zero byte.
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as connection:
                connection.setblocking(False)
                connection.sendto(state.encode(), address)
        except (OSError, ValueError):  # systemd notices that nothing comes
            pass
