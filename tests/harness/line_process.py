"""A program under test, whose output is read line by line while it runs."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import threading
import time
from typing import Any, Callable, Mapping, NamedTuple, Sequence

DEADLINE_S = 30.0


def start_process(
    command: Sequence[object], streams: Sequence[int], environment: Mapping[str, str] | None = None, cwd: Any = None
) -> subprocess.Popen:
    """Starts a program in a new session, with these file descriptors as its stdin, stdout and stderr."""
    stdin, stdout, stderr = streams
    variables = dict(environment) if environment is not None else None
    return subprocess.Popen(
        [str(word) for word in command],
        env=variables,
        cwd=cwd,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        start_new_session=True,
    )


class Line(NamedTuple):
    """One line of output."""

    stream: str
    """`out` or `err`."""
    text: str


class LineProcess:
    """A running program."""

    def __init__(
        self,
        command: Sequence[object],
        environment: Mapping[str, str] | None = None,
        cwd: Any = None,
        start: Callable[..., Any] = start_process,
    ) -> None:
        """Starts `command` in a new session; with `start_fork` of `warm_python`, a program of this Python."""
        self.lines: list[Line] = []
        """Its output, as far as `wait_for_line` and `wait` have read."""
        self._arrivals: queue.Queue = queue.Queue()
        reading_out, out = os.pipe()
        reading_err, err = os.pipe()
        nothing = os.open(os.devnull, os.O_RDONLY)
        try:
            self._process = start(command, (nothing, out, err), environment, cwd)
        finally:
            for descriptor in (nothing, out, err):
                os.close(descriptor)
        self._readers = [
            threading.Thread(target=self._read, args=(name, descriptor), daemon=True)
            for name, descriptor in (("out", reading_out), ("err", reading_err))
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    @property
    def errors(self) -> list[str]:
        """The lines of its standard error."""
        return [line.text for line in self.lines if line.stream == "err"]

    @property
    def text(self) -> str:
        """All of its output."""
        return "\n".join(f"{line.stream}: {line.text}" for line in self.lines)

    def wait_for_line(self, wanted: Callable[[str], bool], deadline_s: float = DEADLINE_S) -> str:
        """Returns the next line for which `wanted` is true.

        Raises:
            AssertionError: it does not come in time, or the program ends without it.
        """
        give_up_s = time.monotonic() + deadline_s
        while True:
            left_s = give_up_s - time.monotonic()
            assert left_s > 0.0, f"the line did not come in {deadline_s:g} s; there was:\n{self.text}"
            try:
                line = self._arrivals.get(timeout=min(left_s, 0.1))
            except queue.Empty:
                ended = not self.is_running and not any(reader.is_alive() for reader in self._readers)
                assert not (ended and self._arrivals.empty()), f"ended without the line; there was:\n{self.text}"
                continue
            self.lines.append(line)
            if wanted(line.text):
                return line.text

    def wait_for_text(self, text: str, deadline_s: float = DEADLINE_S) -> str:
        """Returns the next line that contains `text`."""
        return self.wait_for_line(lambda line: text in line, deadline_s)

    def wait_for_texts(self, *texts: str) -> None:
        """Waits until each text has occurred in a line, in any order."""
        missing = set(texts)

        def strike_out(line: str) -> bool:
            missing.difference_update([text for text in missing if text in line])
            return not missing

        self.wait_for_line(strike_out)

    def signal(self, number: int = signal.SIGINT) -> None:
        self._process.send_signal(number)

    def wait(self, deadline_s: float = DEADLINE_S) -> int:
        """Returns the exit code; negative: the signal that killed it.

        Raises:
            AssertionError: it still runs after `deadline_s`.
        """
        try:
            self._process.wait(deadline_s)
        except subprocess.TimeoutExpired:
            self._collect()
            raise AssertionError(f"still runs after {deadline_s:g} s; it wrote:\n{self.text}") from None
        for reader in self._readers:
            reader.join(5.0)
        self._collect()
        return self._process.returncode

    def end(self) -> None:
        """Ends it if it still runs, at the end of a test: with SIGINT, then with SIGKILL for its process group."""
        if self.is_running:
            self.signal()
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()

    def _collect(self) -> None:
        while not self._arrivals.empty():
            self.lines.append(self._arrivals.get())

    def _read(self, name: str, descriptor: int) -> None:
        with open(descriptor, encoding="utf-8", errors="replace") as stream:
            for text in stream:
                self._arrivals.put(Line(name, text.rstrip("\n")))
