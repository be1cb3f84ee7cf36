"""A thread that calls a function again and again, with the wait that the function requests."""

from __future__ import annotations

import threading
from typing import Callable

_WAIT_AFTER_ERROR_S = 1.0


class StepThread:
    """Calls `step` until it is closed. A daemon: a step that hangs does not keep the process alive."""

    def __init__(self, name: str, step: Callable[[], float], on_error: Callable[[Exception], object]) -> None:
        """Prepares the thread; `start` begins.

        Args:
            name: the thread's name.
            step: called again after the number of seconds that it returns, or after `wake`.
            on_error: receives what `step` raises; then the thread continues.
        """
        self._step = step
        self._on_error = on_error
        self._wake = threading.Event()
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begins."""
        self._thread.start()

    def wake(self) -> None:
        """Ends the present wait; returns at once."""
        self._wake.set()

    def close(self) -> None:
        """Ends the thread after the present step; returns at once."""
        self._is_closed = True
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        """Waits for the end of the thread."""
        self._thread.join(timeout_s)

    def _run(self) -> None:
        while not self._is_closed:
            self._wake.clear()
            if self._is_closed:  # closed before `clear`
                return
            try:
                wait_s = self._step()
            except Exception as error:
                self._on_error(error)
                wait_s = _WAIT_AFTER_ERROR_S
            self._wake.wait(wait_s)
