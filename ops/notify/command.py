"""Target `command`: runs a program for each notification, with the JSON on its stdin."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import tempfile
import threading
import time
from typing import Any, Optional

from ...core.values.formatting import printable
from .sender import DeliveryError, Notification, Sender

# Variables that are for the monitor only: a secret, and systemd's supervision.
_NOT_INHERITED = ("ROBOT_HEALTH_TOKEN", "NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC")
_MOST_SHOWN = 200  # characters of stderr
_POLL_S = 0.05


class Command(Sender):
    """Runs a program, without a shell. It must end with code 0 within the timeout, else it is run again later."""

    def __init__(self, *arguments: Any) -> None:
        """Runs nothing yet."""
        super().__init__(*arguments)
        self._lock = threading.Lock()
        self._process: Optional[subprocess.Popen[bytes]] = None
        self._is_closed = False

    def send(self, notification: Notification) -> str:
        """Runs the program and waits for it. After the timeout it is killed, with the processes that it started."""
        with tempfile.TemporaryFile() as stdin:  # not a pipe: the program need not read it
            stdin.write(notification.as_json().encode("ascii") + b"\n")
            stdin.seek(0)
            process = self._start(stdin.fileno())
        assert process.stderr is not None
        try:
            text = self._follow(process, process.stderr.fileno())
        finally:
            process.stderr.close()
            self._process = None
        code = process.returncode
        end = f"ended with code {code}" if code >= 0 else f"killed by signal {-code}"
        if code != 0:
            raise DeliveryError(f"{end}: {text}" if text else end)
        return end

    def close(self) -> None:
        """Kills the program if it runs."""
        with self._lock:
            self._is_closed = True
            if self._process is not None:
                _kill(self._process)

    def _start(self, stdin: int) -> subprocess.Popen[bytes]:
        variables = {name: value for name, value in os.environ.items() if name not in _NOT_INHERITED}
        with self._lock:
            if self._is_closed:
                raise DeliveryError("the monitor ends", may_have_arrived=False)
            try:
                self._process = subprocess.Popen(
                    self._settings.command,
                    stdin=stdin,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                    env=variables,
                    start_new_session=True,
                )
            except (OSError, ValueError) as error:
                problem = f"cannot be started: {getattr(error, 'strerror', error)}"
                raise DeliveryError(problem, may_have_arrived=False) from None
            return self._process

    def _follow(self, process: subprocess.Popen[bytes], stderr: int) -> str:
        """Waits for the end of a program; returns the beginning of its stderr, all of which is read."""
        deadline_s = time.monotonic() + self._settings.timeout_s
        poll = select.poll()  # not `select`: it cannot handle file descriptors above 1023
        poll.register(stderr, select.POLLIN)

        def read(wait_s: float) -> bytes:
            return os.read(stderr, 65536) if poll.poll(wait_s * 1000.0) else b""

        text = b""
        while process.poll() is None:
            if time.monotonic() > deadline_s:
                _kill(process)
                process.wait()
                raise DeliveryError(f"killed after {self._settings.timeout_s:g} s")
            data = read(_POLL_S)
            text = (text + data)[: 4 * _MOST_SHOWN]
            if not data:  # also if it has closed stderr
                time.sleep(_POLL_S)
        # A process that it left running may keep stderr open: only what is there already is read.
        for data in iter(lambda: read(0.0), b""):
            text += data
            if len(text) >= _MOST_SHOWN:
                break
        return printable(" ".join(text.decode("utf-8", "replace").split()))[:_MOST_SHOWN]


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kills a program and the processes of its group, unless it has ended and its number may be another's."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):  # it ended at this moment
            os.killpg(process.pid, signal.SIGKILL)
