"""Reports to systemd that the process has started, is alive, or is ending (sd_notify(3)).

systemd asks for this with NOTIFY_SOCKET (`Type=notify`), and for signs of life with WATCHDOG_USEC (`WatchdogSec=`).
Elsewhere, nothing is sent.
"""

from __future__ import annotations

import os
from typing import Any, Callable, MutableMapping

_LONGEST_TICK_AGE_S = 5.0
_SHORTEST_PERIOD_S = 0.1
"""Of signs of life, in s."""


class ServiceManager:
    """The connection to the service manager that started this process. Never raises and never waits."""

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        """Takes the variables of systemd out of the environment: they are not for commands that this process starts."""
        self._address = environment.pop("NOTIFY_SOCKET", "")
        limit_us = environment.pop("WATCHDOG_USEC", "")
        is_meant = environment.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._limit_s = float(limit_us) / 1e6 if limit_us.isdigit() and is_meant else 0.0

    def ready(self) -> None:
        """To be called when everything has started."""
        self._send("READY=1")

    def watch(self, node: Any, tick_age_s: Callable[[], float]) -> None:
        """Sends signs of life from now on, if systemd asks for them, while the timers of a node run.

        `node` is a `Middleware`. While the last tick is too old, in s, nothing is sent, and systemd restarts the
        process.
        """

        def send(now_s: float) -> None:
            if tick_age_s() <= max(_LONGEST_TICK_AGE_S, self._limit_s):
                self._send("WATCHDOG=1")

        if self._limit_s:  # twice as often as systemd asks for
            node.create_timer(max(_SHORTEST_PERIOD_S, self._limit_s / 4.0), send, steady=True)

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
