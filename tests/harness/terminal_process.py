"""A program on a terminal: a real pseudo-terminal, whose screen pyte keeps as a terminal would show it."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
import time
from typing import Callable, List, Mapping, Sequence

import pyte

DEADLINE_S = 30.0

_TAKE_TERMINAL = (
    "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); os.execvp(sys.argv[1], sys.argv[1:])"
)
"""Makes the terminal the controlling one, so that Ctrl-C and a changed size reach the program, and becomes it."""


class TerminalProcess:
    """A running program, with a terminal of its own."""

    def __init__(
        self, command: Sequence[str], environment: Mapping[str, str], *, columns: int = 80, lines: int = 24
    ) -> None:
        """Starts `command` on a terminal of the given size."""
        self.screen = pyte.Screen(columns, lines)
        self.bytes = b""
        """All that it has written until now, as far as `wait_until` and `wait` have looked."""
        self._stream = pyte.ByteStream(self.screen)
        self._terminal, inside = pty.openpty()
        _set_size(inside, columns, lines)
        self._process = subprocess.Popen(
            [sys.executable, "-c", _TAKE_TERMINAL, *command],
            env=dict(environment),
            stdin=inside,
            stdout=inside,
            stderr=inside,
            start_new_session=True,
        )
        os.close(inside)

    @property
    def text(self) -> str:
        """What the screen shows, without the blanks at the ends of its lines."""
        return "\n".join(line.rstrip() for line in self.screen.display).rstrip()

    @property
    def rows(self) -> List[str]:
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
        """Changes the size of the window, which the kernel tells the program by SIGWINCH."""
        self.screen.resize(lines, columns)
        _set_size(self._terminal, columns, lines)

    def signal(self, number: int) -> None:
        os.kill(self._process.pid, number)

    def wait_for_stop(self) -> None:
        """Waits until the program is stopped, as by Ctrl-Z."""
        _, status = os.waitpid(self._process.pid, os.WUNTRACED)
        assert os.WIFSTOPPED(status)
        while self._read(0.0):
            pass

    def wait(self, deadline_s: float = DEADLINE_S) -> int:
        """Returns the exit code; negative: the signal that killed it."""
        give_up_s = time.monotonic() + deadline_s
        while self._read(max(0.0, give_up_s - time.monotonic())):
            pass
        assert time.monotonic() < give_up_s, f"still runs after {deadline_s:g} s; the screen is:\n{self.text}"
        return self._process.wait()

    def end(self) -> None:
        """Ends it if it still runs, for the end of a test."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        os.close(self._terminal)

    def _read(self, timeout_s: float) -> bool:
        """Takes what has arrived; false: nothing came in time, or the program has left the terminal."""
        if not select.select([self._terminal], [], [], timeout_s)[0]:
            return False
        try:
            data = os.read(self._terminal, 65536)
        except OSError:
            return False  # Linux says EIO when nobody has the terminal open any more
        self.bytes += data
        self._stream.feed(data)
        return bool(data)


def _set_size(terminal: int, columns: int, lines: int) -> None:
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
