"""stdout and stderr that never block and never fail, however slowly or badly they are read.

A terminal that is stopped with Ctrl-S, a pipe whose reader hangs or a full disk would stop the whole process: ROS logs
to stdout and stderr synchronously, rospy with Python's file objects, rclpy in C while it holds the GIL. So the file
descriptors 1 and 2 become pipes that never block, and a thread per stream copies each pipe to the original stream.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import select
import sys
import termios
import threading
import time
from typing import Callable

_CHUNK_BYTES = 4096
"""PIPE_BUF: so much can be written without blocking once a pipe is ready."""
_PIPE_BYTES = 1_000_000
_F_SETPIPE_SZ = 1031
_SILENT_READER_S = 5.0
_RETRY_S = 1.0
"""Until the next attempt on a full disk."""
_DRAIN_S = 0.5
_NOT_READ = "is not being read: lines may be lost"
_BUSY_S = 5.0
"""Longest wait for a thread that gets no processor time on a busy machine."""

OnChange = Callable[[str, str], None]
"""Called with the name of a stream and what is wrong with it, an empty text once it works again. From a thread."""


class StandardStreams:
    """Replaces stdout and stderr while it is entered as a context."""

    def __init__(self) -> None:
        """Changes nothing until it is entered."""
        self._on_change: OnChange = lambda name, problem: None
        self._copies: dict[str, _Copy] = {}

    def __enter__(self) -> StandardStreams:
        """Replaces both streams."""
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is None:  # closed before this process started
                setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
            else:
                self._copies[name] = _Copy(name, lambda *change: self._on_change(*change))
        return self

    @property
    def stdout(self) -> _Copy:
        """What has replaced stdout, which was open."""
        return self._copies["stdout"]

    def __exit__(self, *error: object) -> None:
        """Restores both streams; what has been written gets through, unless a stream is not read for 0.5 s."""
        for copy in self._copies.values():
            copy.close()

    def on_change(self, callback: OnChange) -> None:
        """Calls back from now on, in place of an earlier function."""
        self._on_change = callback


class _Copy:
    """One stream: the pipe in its place, and the thread that copies the pipe to the original."""

    def __init__(self, name: str, on_change: OnChange) -> None:
        self._name = name
        self._on_change = on_change
        self._problem = ""
        self._closing = threading.Event()
        self._is_writing = False
        self._python_stream = getattr(sys, name)
        self._python_stream.flush()
        self._number = number = self._python_stream.fileno()
        self.original = os.dup(number)
        """File descriptor of the original stream."""
        is_terminal = os.isatty(self.original)
        self._read_end, write_end = os.pipe()
        with contextlib.suppress(OSError):  # the default is 64 KB
            fcntl.fcntl(write_end, _F_SETPIPE_SZ, _PIPE_BYTES)
        os.set_blocking(write_end, False)
        os.dup2(write_end, number)
        os.close(write_end)
        if is_terminal and name == "stderr":
            os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")  # rclpy sees a pipe now
        setattr(sys, name, _Stream(number, is_terminal, self._python_stream.encoding))
        self._thread = threading.Thread(target=self._run, name=f"{name} copy", daemon=True)
        self._thread.start()

    @property
    def unread_bytes(self) -> int:
        """How much waits in the pipe; a pipe takes at least 64 KB."""
        return int.from_bytes(fcntl.ioctl(self._read_end, termios.FIONREAD, bytes(4)), sys.byteorder)

    @property
    def reader_is_gone(self) -> bool:
        """Whether the original is a pipe without a reader, or a terminal that was closed."""
        poll = select.poll()
        poll.register(self.original, 0)
        return bool(poll.poll(0))

    def close(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # what does not fit into the pipe is lost
            getattr(sys, self._name).flush()
        setattr(sys, self._name, self._python_stream)
        self._closing.set()
        os.dup2(self.original, self._number)  # closes the pipe: the thread reads to its end
        self._thread.join(_DRAIN_S)
        poll = select.poll()
        poll.register(self.original, select.POLLOUT)
        end_s = time.monotonic() + _BUSY_S
        # A command of `notify` that still runs keeps the pipe open, but not the process.
        while (self.unread_bytes or self._is_writing) and poll.poll(0) and time.monotonic() < end_s:
            self._thread.join(0.05)
        if self.unread_bytes or self._is_writing:
            self._set_problem(_NOT_READ)

    def _run(self) -> None:
        poll = select.poll()
        poll.register(self._read_end, select.POLLIN)
        data = b"unknown"
        while data:
            poll.poll()
            self._is_writing = True  # before it is read, so that `close` misses nothing
            data = os.read(self._read_end, _CHUNK_BYTES)
            if data:
                self._write(data)
            self._is_writing = False

    def _write(self, data: bytes) -> None:
        """Writes what one read returned; it is lost if the reader is gone, or on an error at the end."""
        poll = select.poll()
        poll.register(self.original, select.POLLOUT)
        while data:
            try:
                if not poll.poll(_SILENT_READER_S * 1000.0):
                    self._set_problem(_NOT_READ)
                    continue
                data = data[os.write(self.original, data) :]
            except BlockingIOError:
                continue
            except OSError as error:
                self._set_problem(f"cannot be written ({error.strerror or error}): lines may be lost")
                if self.reader_is_gone or self._closing.wait(_RETRY_S):
                    return
        self._set_problem("")

    def _set_problem(self, problem: str) -> None:
        if problem != self._problem:
            self._problem = problem
            self._on_change(self._name, problem)


class _Stream(io.TextIOWrapper):
    """A text stream on a pipe that writes each line at once, never raises, and is a terminal if the original was."""

    def __init__(self, number: int, is_terminal: bool, encoding: str) -> None:
        raw = io.FileIO(number, "w", closefd=False)
        super().__init__(io.BufferedWriter(raw), encoding=encoding, errors="backslashreplace", line_buffering=True)
        self._is_terminal = is_terminal

    def isatty(self) -> bool:
        return self._is_terminal

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError:  # the pipe is full, because the original is not being read
            return len(text)
