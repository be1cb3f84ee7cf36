"""A program on a real pseudo-terminal, whose screen pyte emulates."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import sys
import termios
import time
from pathlib import Path
from typing import Any, Callable, Mapping, Sequence

import pyte

from harness.line_process import start_process
from harness.unread import fill
from harness.waiting import wait_for
from harness.warm_python import start_fork

DEADLINE_S = 30.0

_TAKE_TERMINAL = (
    "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execvp(sys.argv[1], sys.argv[1:])"
)
"""Makes the terminal the controlling one, so that Ctrl-C and SIGWINCH reach the program, and executes the program."""


class TerminalProcess:
    """A running program on a terminal."""

    def __init__(
        self,
        command: Sequence[str],
        environment: Mapping[str, str],
        *,
        columns: int = 80,
        lines: int = 24,
        full: bool = False,
    ) -> None:
        """Starts `command` on a terminal of the given size.

        Args:
            command: the program and its arguments.
            environment: its variables.
            columns: width of the terminal.
            lines: height of the terminal.
            full: as if the terminal had not been read for long: the first write blocks.
        """
        self.screen = pyte.Screen(columns, lines)
        self.bytes = b""
        """Everything it has written, as far as `wait_until` and `wait` have read."""
        self._stream = pyte.ByteStream(self.screen)
        self._terminal, inside = pty.openpty()
        _set_size(inside, columns, lines)
        if full:
            fill(inside)
        streams = (inside, inside, inside)
        self._process: Any
        if command[0] == sys.executable:
            self._process = start_fork(command, streams, environment)
        else:
            self._process = start_process([sys.executable, "-c", _TAKE_TERMINAL, *command], streams, environment)
        os.close(inside)

    @property
    def text(self) -> str:
        """The screen, without trailing blanks."""
        return "\n".join(line.rstrip() for line in self.screen.display).rstrip()

    @property
    def rows(self) -> list[str]:
        """The lines of `text`."""
        return self.text.split("\n")

    def wait_until(self, wanted: Callable[[str], bool], deadline_s: float = DEADLINE_S) -> str:
        """Returns the text of the screen once `wanted` is true for it.

        Raises:
            AssertionError: that does not come in time, or the program ends without it.
        """
        give_up_s = time.monotonic() + deadline_s
        while not wanted(self.text):
            left_s = give_up_s - time.monotonic()
            assert left_s > 0.0, f"it did not show in {deadline_s:g} s; the screen is:\n{self.text}"
            assert self._read(left_s), f"ended without it; the screen is:\n{self.text}"
        return self.text

    def type(self, keys: str) -> None:
        os.write(self._terminal, keys.encode())

    def resize(self, columns: int, lines: int) -> None:
        """Changes the size of the window; the kernel sends SIGWINCH."""
        self.screen.resize(lines, columns)
        _set_size(self._terminal, columns, lines)

    def signal(self, number: int) -> None:
        os.kill(self._process.pid, number)

    def wait_for_stop(self) -> None:
        """Waits until the program is stopped, as by Ctrl-Z."""
        stat = Path(f"/proc/{self._process.pid}/stat")
        wait_for(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T")
        while self._read(0.0):
            pass

    def wait(self, deadline_s: float = DEADLINE_S) -> int:
        """Returns the exit code; negative: the signal that killed it."""
        give_up_s = time.monotonic() + deadline_s
        while self._read(max(0.0, give_up_s - time.monotonic())):
            pass
        assert time.monotonic() < give_up_s, f"still runs after {deadline_s:g} s; the screen is:\n{self.text}"
        return self._process.wait()

    def wait_unread(self, deadline_s: float = DEADLINE_S) -> int:
        """Returns the exit code, without reading the terminal."""
        return self._process.wait(deadline_s)

    def end(self) -> None:
        """Kills it if it still runs, at the end of a test."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        os.close(self._terminal)

    def _read(self, timeout_s: float) -> bool:
        """Reads what has arrived; False: nothing came in time, or the program has closed the terminal."""
        if not select.select([self._terminal], [], [], timeout_s)[0]:
            return False
        try:
            data = os.read(self._terminal, 65536)
        except OSError:
            return False  # EIO: no process has the terminal open any more
        self.bytes += data
        self._stream.feed(data)
        return bool(data)


def _set_size(terminal: int, columns: int, lines: int) -> None:
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
