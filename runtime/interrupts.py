"""SIGINT and SIGTERM: one clean end of a process, whatever its main thread is doing.

Every executable and the command line use this class. It is imported before anything slow, so that a signal during the
imports ends the process cleanly too.

=============  ==========================================================================================
runtime        use
=============  ==========================================================================================
plain Python   nothing: the first signal raises KeyboardInterrupt in the main thread
asyncio,       call `defer()`: signals only set `came`, since none of them survives an exception at any point
rospy, rclpy
=============  ==========================================================================================

SIGHUP ends a process as usual, unless it calls `take_hangups()`: then it means "read the configuration again".
"""

from __future__ import annotations

import contextlib
import signal
import time
from typing import Any, Callable

_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_POLL_PERIOD_S = 0.2


class Interrupts:
    """Handles SIGINT and SIGTERM while it is entered as a context."""

    def __init__(self, patience_s: float | None = None) -> None:
        """Changes nothing until it is entered.

        If something hangs and the context is still entered `patience_s` after the first signal, KeyboardInterrupt is
        raised after all (with SIGALRM). With None, it never is.
        """
        self.came = False
        """Whether a signal has come."""
        self.hung_up = False
        """Whether SIGHUP has come, after `take_hangups`; set it back."""
        self._is_deferred = False
        self._patience_s = patience_s
        self._before: list[Any] = []

    def __enter__(self) -> Interrupts:
        """Replaces the handlers; does nothing outside the main thread, which signals do not reach."""
        with contextlib.suppress(ValueError):
            self._before = [(number, signal.signal(number, self._handle)) for number in _ENDING_SIGNALS]
            if self._patience_s is not None:
                self._before.append((signal.SIGALRM, signal.signal(signal.SIGALRM, signal.default_int_handler)))
        return self

    def __exit__(self, *error: object) -> None:
        """Restores the handlers. After a signal it ignores further ones instead, so that the process ends cleanly."""
        if self.came:
            # Blocked first: Python complains about a signal that arrives while its handler changes. Ignored as well:
            # blocking covers this thread only, and a DDS thread may outlive Python's handlers.
            signal.pthread_sigmask(signal.SIG_BLOCK, (*_ENDING_SIGNALS, signal.SIGALRM))
            for number, _ in self._before:
                signal.signal(number, signal.SIG_IGN)
            return
        for number, handler in self._before:
            signal.signal(number, handler)

    def defer(self) -> None:
        """From now on signals only set `came`; see `check` and `wait_until`."""
        self._is_deferred = True

    def take_hangups(self) -> None:
        """From now on SIGHUP only sets `hung_up`."""
        with contextlib.suppress(ValueError):  # not the main thread, which signals do not reach
            self._before.append((signal.SIGHUP, signal.signal(signal.SIGHUP, self._handle_hangup)))

    def check(self) -> None:
        """Raises KeyboardInterrupt if a signal has come."""
        if self.came:
            raise KeyboardInterrupt

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        """Waits until `predicate()` is true; checks every 0.2 s. Raises KeyboardInterrupt if a signal has come."""
        while not predicate():
            self.check()
            time.sleep(_POLL_PERIOD_S)
        self.check()

    def _handle(self, number: int, frame: object) -> None:
        first, self.came = not self.came, True
        if first and self._patience_s is not None:
            signal.setitimer(signal.ITIMER_REAL, self._patience_s)
        if first and not self._is_deferred:
            raise KeyboardInterrupt

    def _handle_hangup(self, number: int, frame: object) -> None:
        self.hung_up = True
