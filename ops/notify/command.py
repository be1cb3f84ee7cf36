"""Target `command`: runs a program for each notification, with the JSON on its stdin."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import threading
from typing import Any

from .sender import DeliveryError, Notification, Sender

# Variables that are for the monitor only: a secret, and systemd's supervision.
_NOT_INHERITED = ("ROBOT_HEALTH_TOKEN", "NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC")


class Command(Sender):
    """Runs a program, without a shell. It must end with code 0 within the timeout, else it is run again later.

    Its stderr is that of the monitor.
    """

    def __init__(self, *arguments: Any) -> None:
        """Runs nothing yet."""
        super().__init__(*arguments)
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._is_closed = False

    def send(self, notification: Notification) -> str:
        """Runs the program and waits for it. After the timeout it is killed, with the processes that it started."""
        with tempfile.TemporaryFile() as stdin:  # not a pipe: the program need not read it
            stdin.write(notification.as_json().encode("ascii") + b"\n")
            stdin.seek(0)
            process = self._start(stdin.fileno())
        try:
            code = process.wait(self._settings.timeout_s)
        except subprocess.TimeoutExpired:
            _kill(process)
            process.wait()
            raise DeliveryError(f"killed after {self._settings.timeout_s:g} s") from None
        finally:
            self._process = None
        end = f"ended with code {code}" if code >= 0 else f"killed by signal {-code}"
        if code != 0:
            raise DeliveryError(end)
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
                    env=variables,
                    start_new_session=True,
                )
            except (OSError, ValueError) as error:
                problem = f"cannot be started: {getattr(error, 'strerror', error)}"
                raise DeliveryError(problem, may_have_arrived=False) from None
            return self._process


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kills a program and the processes of its group, unless it has ended and its number may be another's."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):  # it ended at this moment
            os.killpg(process.pid, signal.SIGKILL)
