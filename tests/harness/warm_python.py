"""A Python that has imported the monitor and forks itself for each program: a start without imports.

Most tests of programs are about what a program does, not about how Python starts. A forked program is a process of a
new session with its own streams, variables and folder, and it ends as every Python does. It does not import: tests of
signals during the start, of missing libraries and of executables as they are installed start a new Python.
"""

from __future__ import annotations

import array
import atexit
import contextlib
import fcntl
import functools
import importlib
import json
import os
import pkgutil
import runpy
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
import weakref
from pathlib import Path
from typing import Any, Mapping, Sequence

PACKAGE = "robot_health_monitor"
_FREE = ("PYTHONIOENCODING", "PYTHONUNBUFFERED")
_READ_AT_START = ("PYTHON", "LD_", "SSL_", "LANG", "LC_")
"""How the names of variables begin that Python and its libraries read when they start, but for those in `_FREE`."""


class ForkedProgram:
    """A running program, with the methods of `subprocess.Popen` that the tests use."""

    def __init__(self, status: int) -> None:
        """Waits for its process number, the first line of `status`; the second one will be its exit code."""
        self._status = open(status, "rb", buffering=0)
        weakref.finalize(self, self._status.close)  # not when it has ended: other threads may wait for it, too
        self._reading = threading.Lock()
        self.pid = int(self._status.readline())
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Returns the exit code, as `Popen` has it; None while it runs."""
        return self._exit_code(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Returns the exit code once it has ended, or raises `subprocess.TimeoutExpired`."""
        code = self._exit_code(timeout)
        if code is None:
            raise subprocess.TimeoutExpired("a forked program", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Sends a signal, unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):  # it has ended since
                os.kill(self.pid, number)

    def kill(self) -> None:
        """Sends SIGKILL, unless it has ended."""
        self.send_signal(signal.SIGKILL)

    def _exit_code(self, timeout_s: float | None) -> int | None:
        if self.returncode is None and select.select([self._status], [], [], timeout_s)[0]:
            with self._reading:
                if self.returncode is None:
                    self.returncode = int(self._status.readline())
        return self.returncode


def start_fork(
    command: Sequence[object], streams: Sequence[int], environment: Mapping[str, str] | None = None, cwd: Any = None
) -> ForkedProgram:
    """Starts a program of this Python in a new session, as a fork of one that has imported the monitor.

    Args:
        command: the interpreter, then -m with a module, or -c with code, and arguments.
        streams: the file descriptors that become its stdin, stdout and stderr; the program's terminal, if it is one.
        environment: its variables; None for those of this process.
        cwd: its folder; None for that of this process.
    """
    words, variables = [str(word) for word in command], dict(os.environ if environment is None else environment)
    assert words[0] == sys.executable and words[1] in ("-m", "-c")
    fixed = [(name, value) for name, value in variables.items() if name.startswith(_READ_AT_START)]
    warm = _warm(tuple(sorted(pair for pair in fixed if pair[0] not in _FREE)))
    return warm.fork(words[1:], streams, variables, str(cwd or os.getcwd()))


@functools.lru_cache(maxsize=None)
def _warm(fixed: tuple[tuple[str, str], ...]) -> WarmPython:
    return WarmPython(dict(fixed))


class WarmPython:
    """A Python that forks itself."""

    def __init__(self, fixed: Mapping[str, str]) -> None:
        """Starts it with these of the variables that Python reads when it starts; it ends with this process."""
        others = {name: value for name, value in os.environ.items() if not name.startswith(_READ_AT_START)}
        self._connection, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for each in (self._connection, theirs):
            each.setblocking(True)  # whatever the default: rospy changes it
        with theirs:
            command = [sys.executable, __file__, str(theirs.fileno())]
            process = subprocess.Popen(
                command, env={**others, **fixed}, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL
            )
        atexit.register(process.wait)
        atexit.register(self._connection.close)

    def fork(
        self, arguments: Sequence[str], streams: Sequence[int], variables: Mapping[str, str], folder: str
    ) -> ForkedProgram:
        """Starts a program."""
        reading, status = os.pipe()
        request = json.dumps({"arguments": arguments, "variables": variables, "folder": folder}).encode()
        descriptors = array.array("i", [*streams, status])
        self._connection.sendmsg([request], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, descriptors)])
        os.close(status)
        return ForkedProgram(reading)


def import_all() -> None:
    """Imports every module of the monitor whose libraries are installed."""
    package = importlib.import_module(PACKAGE)
    for module in pkgutil.walk_packages(package.__path__, f"{PACKAGE}.", onerror=lambda name: None):
        if not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ImportError:
                pass
    for name in ("aiohttp.web", "cbor2", "rich.live", "rich.table"):
        try:
            importlib.import_module(name)
        except ImportError:
            pass


def serve(connection: socket.socket) -> list[str]:
    """Forks for each request; returns in a program only, with what it is to run. It exits when the tests have ended."""
    while True:
        message, ancillary, _, _ = connection.recvmsg(1 << 20, socket.CMSG_SPACE(4 * 4))
        _reap()
        if not message:
            while _reap(0):
                pass
            sys.exit()
        descriptors = array.array("i")
        descriptors.frombytes(ancillary[0][2])
        *streams, status = descriptors
        if os.fork() == 0:  # a process that waits for the program, whose parent it is
            connection.close()
            program = os.fork()
            if program == 0:
                os.close(status)
                return become(json.loads(message), streams)
            os.setsid()  # no signal to the program's or the tests' process group ends it
            os.write(status, b"%d\n" % program)
            for stream in streams:
                os.close(stream)
            ended = os.waitpid(program, 0)[1]
            code = -os.WTERMSIG(ended) if os.WIFSIGNALED(ended) else os.WEXITSTATUS(ended)
            os.write(status, b"%d\n" % code)
            os._exit(0)
        for descriptor in descriptors:
            os.close(descriptor)


def _reap(options: int = os.WNOHANG) -> bool:
    """Ends what waited for a program that has ended; returns whether there was one."""
    try:
        return os.waitpid(-1, options)[0] != 0
    except ChildProcessError:
        return False


def become(request: dict[str, Any], streams: Sequence[int]) -> list[str]:
    """Makes this process the program of a request; returns its arguments."""
    os.setsid()
    if os.isatty(streams[0]):
        fcntl.ioctl(streams[0], termios.TIOCSCTTY, 0)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
    os.closerange(3, max(streams) + 1)
    os.environ.clear()
    os.environ.update(request["variables"])
    os.chdir(request["folder"])
    time.tzset()
    encoding = os.environ.get("PYTHONIOENCODING") or "utf-8"
    at_once = bool(os.environ.get("PYTHONUNBUFFERED"))
    sys.stdin = sys.__stdin__ = open(0, encoding=encoding, closefd=False)
    sys.stdout = sys.__stdout__ = open(
        1, "w", buffering=1 if os.isatty(1) or at_once else -1, encoding=encoding, closefd=False
    )
    sys.stderr = sys.__stderr__ = open(2, "w", buffering=1, encoding=encoding, errors="backslashreplace", closefd=False)
    return list(request["arguments"])


def run(kind: str, what: str, *arguments: str) -> None:
    """Runs `python -m MODULE` or `python -c CODE` with arguments."""
    sys.argv = [what if kind == "-m" else "-c", *arguments]
    if kind == "-m":
        runpy.run_module(what, run_name="__main__", alter_sys=True)
    else:
        exec(compile(what, "<string>", "exec"), {"__name__": "__main__"})


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[2])
    import_all()
    requests = socket.socket(fileno=int(sys.argv[1]))
    requests.setblocking(True)
    run(*serve(requests))
