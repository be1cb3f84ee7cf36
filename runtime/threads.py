"""Threads that nothing waits for at the end of the process.

The threads of `loop.run_in_executor` are joined when the loop and the process end: a look-up of a host name that hangs
would delay the exit by half a minute, and a folder on a server that does not answer by hours.
"""

from __future__ import annotations

import math
import os
import queue
import select
import threading
import time
from contextlib import closing
from typing import Callable

from ..core.values import Clock, ServiceError

_WAIT_AFTER_ERROR_S = 1.0
_JOIN_PERIOD_S = 0.005
_LONGEST_WAIT_S = 86400.0
"""Of one call of `poll`, which takes at most 24 days."""


class MonotonicEvent:
    """A `threading.Event` for one waiting thread, whose timed wait follows the monotonic clock.

    Until Python 3.10, timed waits of `threading` follow the wall clock: if it is set back by an hour, they last an hour
    longer (bpo-41710).
    """

    def __init__(self) -> None:
        """Creates an event that is not set."""
        self._is_set = False
        self._lock = threading.Lock()
        reader, writer = os.pipe()  # not a pair of sockets: `import socket` takes memory in every node
        self._reader, self._writer = open(reader, "rb", buffering=0), open(writer, "wb", buffering=0)
        self._poll = select.poll()
        self._poll.register(self._reader, select.POLLIN)

    def close(self) -> None:
        """Releases its two file descriptors, when nothing waits any more. From then on it counts as set."""
        with self._lock:
            self._is_set = True
            self._reader.close()
            self._writer.close()

    __del__ = close

    def is_set(self) -> bool:
        """Returns whether it is set."""
        return self._is_set

    def set(self) -> None:
        """Ends the wait."""
        with self._lock:
            if not self._is_set:
                self._is_set = True
                self._writer.write(b"1")

    def clear(self) -> None:
        """Lets `wait` wait again."""
        with self._lock:
            if self._is_set:
                self._is_set = False
                self._reader.read(1)

    def wait(self, timeout_s: float) -> bool:
        """Waits until it is set, at most `timeout_s`; returns whether it is set."""
        self._poll.poll(min(max(0.0, timeout_s), _LONGEST_WAIT_S) * 1000.0)
        return self._is_set


class DaemonThreads:
    """A bounded number of threads that run functions, each the next one that waits. Used from one thread at a time."""

    def __init__(self, name: str, most: int) -> None:
        """Starts no thread."""
        self._name = name
        self._most = most
        self._started = 0
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()

    def run(self, function: Callable[[], None], pending: int) -> None:
        """Runs a function, which must not raise, in a thread; `pending` functions have not finished, with this one."""
        if self._started < min(pending, self._most):
            self._started += 1
            threading.Thread(target=self._work, args=(self._jobs,), name=self._name, daemon=True).start()
        self._jobs.put(function)

    def close(self) -> None:
        """Ends the threads, each after its function. Nothing may be run afterwards."""
        for _ in range(self._started):
            self._jobs.put(None)
        self._started = 0

    @staticmethod
    def _work(jobs: queue.SimpleQueue[Callable[[], None] | None]) -> None:
        while True:
            job = jobs.get()
            if job is None:
                return
            job()
            del job  # what it belongs to may be large, or have to be freed before the next one comes


class DetachedCalls:
    """Runs functions that may hang, such as reads of a disk on a network, each in a thread; nothing waits for them.

    Called from one thread at a time.
    """

    def __init__(self, name: str, most_threads: int = 32, patience_s: float = 0.02) -> None:
        """Starts no thread. `patience_s` is the time that a call waits for its function."""
        self._threads = DaemonThreads(name, most_threads)
        self._most_threads = most_threads
        self._patience_s = patience_s
        self._running: list[MonotonicEvent] = []

    def __call__(self, function: Callable[[], None]) -> bool:
        """Starts a function, which must not raise; returns whether it has finished.

        Raises ServiceError if too many functions are running already.
        """
        self._running = [each for each in self._running if not each.is_set()]
        if len(self._running) >= self._most_threads:
            raise ServiceError(f"{len(self._running)} sources do not answer: no thread is left")
        finished = MonotonicEvent()

        def run() -> None:
            function()
            finished.set()

        self._running.append(finished)
        self._threads.run(run, len(self._running))
        return finished.wait(self._patience_s)

    def close(self) -> None:
        """Ends the threads, each after its function. Nothing may be called afterwards."""
        self._threads.close()

    __del__ = close


class StepThread(threading.Thread):
    """Calls a function again and again, with the wait that the function requests, until it is closed."""

    def __init__(self, name: str, step: Clock, on_error: Callable[[Exception], object]) -> None:
        """Prepares the thread; `on_error` receives what `step` raises, then the thread continues.

        `step` is called again after the number of seconds that it returns, or after `wake`.
        """
        super().__init__(name=name, daemon=True)
        self._step = step
        self._on_error = on_error
        self._wake = MonotonicEvent()
        self.active = True
        """False from `close` on."""

    def wake(self) -> None:
        """Ends the present wait; returns at once."""
        self._wake.set()

    def close(self) -> None:
        """Ends the thread after the present step; returns at once."""
        self.active = False
        self._wake.set()

    cancel = close
    """Of `core.port.middleware.Timer`."""

    def join(self, timeout: float | None = None) -> None:
        """Waits for the end of the thread, for `timeout` seconds of the monotonic clock, or without a limit."""
        until_s = math.inf if timeout is None else time.monotonic() + timeout
        while self.is_alive() and time.monotonic() < until_s:
            select.select([], [], [], _JOIN_PERIOD_S)  # not `sleep`, which fails where the clock is set meanwhile

    def run(self) -> None:
        """Calls the function until `close`."""
        with closing(self._wake):
            while self.active:
                self._wake.clear()
                if not self.active:  # closed before `clear`
                    return
                try:
                    wait_s = self._step()
                except Exception as error:
                    self._on_error(error)
                    wait_s = _WAIT_AFTER_ERROR_S
                self._wake.wait(wait_s)
