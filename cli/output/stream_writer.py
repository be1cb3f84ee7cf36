"""Writes to a stream in a separate thread, so that a reader that does not read delays nothing else.

A terminal that is paused (Ctrl-S), a hung ssh connection and a full pipe block every write, for hours if need be. Only
this thread waits there. It writes to the file descriptor, past Python's buffers: at the end of the process Python would
wait for the lock of a buffer that is being written.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import threading
from typing import Callable, Generic, Sequence, TextIO, TypeVar

from ...runtime.bounded_queue import BoundedQueue
from ..standard_streams import join_unless_blocked

Item = TypeVar("Item")

MOST_ITEMS = 2_000
"""Items that wait for a stream that is not read."""
_CLOSE_S = 0.5
_POLL_S = 0.5
"""Period of the check whether the reader still exists, while there is nothing to write."""
_RETRY_S = 1.0
"""Until the next attempt on a full disk."""
_GONE = (errno.EPIPE, errno.EIO, errno.EBADF, errno.ENXIO)
"""Errors of a pipe without a reader and of a terminal that was closed; all others may pass, such as a full disk."""


class StreamWriter(Generic[Item]):
    """Renders items as text and writes it."""

    def __init__(self, stream: TextIO, render: Callable[[Sequence[Item], int], str], *, last: str = "") -> None:
        """Prepares a writer; `start` begins writing: what `render` returns, at the end `last`.

        `render` is called in the writer's thread, with new items and with how many were dropped before them.
        """
        self._stream = stream
        self._render = render
        self._last = last
        self._file = -1
        self._items: BoundedQueue[Item] = BoundedQueue(MOST_ITEMS)
        self._woken = False
        self._closing = False
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._error = ""
        self._abandoned = False
        self.reader_is_gone = False
        """Whether nothing reads the stream any more."""

    @property
    def problem(self) -> str:
        """Why the stream is not written at present; empty if it is."""
        if self._error:
            return f"the output cannot be written: {self._error}"
        return "the output is not read: the oldest lines are dropped" if self._items.dropped or self._abandoned else ""

    def start(self) -> None:
        """Begins writing."""
        self._stream.flush()
        self._file = self._stream.fileno()
        self._thread = threading.Thread(target=self._run, name="output", daemon=True)
        self._thread.start()

    def put(self, item: Item) -> None:
        """Writes an item soon; drops the oldest one if too many wait."""
        with self._changed:
            self._items.put(item, 1)
            self._changed.notify_all()

    def wake(self) -> None:
        """Calls `render` soon, even without new items."""
        with self._changed:
            self._woken = True
            self._changed.notify_all()

    def close(self) -> bool:
        """Writes what is left; returns False if the stream is not read."""
        if self._thread is None:
            return True
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        join_unless_blocked(self._thread, self._file, _CLOSE_S)
        self._abandoned = self._thread.is_alive()
        return not self._abandoned

    def _run(self) -> None:
        while not self.reader_is_gone:
            with self._changed:
                self._changed.wait_for(lambda: self._items or self._woken or self._closing, _POLL_S)
                items = [self._items.pop() for _ in range(len(self._items))]
                dropped, self._items.dropped = self._items.dropped, 0
                woken, self._woken = self._woken, False
                closing = self._closing
            if items or woken:
                self._write(self._render(tuple(items), dropped))
            elif not closing:
                self.reader_is_gone = _is_hung_up(self._file)
            if closing:
                self._write(self._last)
                break

    def _write(self, text: str) -> None:
        """Writes all of a text, however long that takes; gives up when the reader is gone or at the end."""
        data = text.encode(self._stream.encoding or "utf-8", "backslashreplace")
        while data and not self.reader_is_gone:
            try:
                data = data[os.write(self._file, data) :]
            except BlockingIOError:  # another process that shares the stream has made it non-blocking
                select.select([], [self._file], [], _POLL_S)
            except OSError as error:
                if error.errno in _GONE:
                    self.reader_is_gone = True
                    return
                self._note_error(error.strerror or str(error))
                with self._changed:
                    if self._changed.wait_for(lambda: self._closing, _RETRY_S):
                        return
            else:
                self._note_error("")

    def _note_error(self, error: str) -> None:
        if error and not self._error:
            _write_error(f"robot-health: the output cannot be written: {error}; monitoring continues")
        elif self._error and not error:
            _write_error("robot-health: the output can be written again")
        self._error = error


def _write_error(line: str) -> None:
    """Writes a line to stderr past Python's buffers, as far as possible."""
    with contextlib.suppress(OSError):
        os.write(2, f"{line}\n".encode("utf-8", "backslashreplace"))


def _is_hung_up(file: int) -> bool:
    """Returns whether a pipe has no reader, or a terminal was closed."""
    watch = select.poll()
    watch.register(file, 0)
    return len(watch.poll(0)) > 0
