"""Ports and ROS 2 domains that no other test run on this machine uses: several sessions run at the same time."""

from __future__ import annotations

import errno
import fcntl
import functools
import os
import socket
import tempfile
from typing import IO, Iterable

_locks: list[IO[str]] = []
"""Open as long as this process: closing a file releases its lock."""
_ports: list[int] = []
_FIRST_PORT = 12_000
"""The ports are below Linux's ephemeral range, from which the kernel gives ports to any process."""
_PORTS_PER_RUN = 200
_RUNS = 100


def free_port() -> int:
    """Returns a TCP port that no process listens on, and that no other test run takes."""
    if not _ports:
        first = _FIRST_PORT + _PORTS_PER_RUN * _reserve("ports", range(_RUNS))
        _ports.extend(range(first, first + _PORTS_PER_RUN))
    for _ in range(_PORTS_PER_RUN):
        _ports.append(_ports.pop(0))
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", _ports[-1]))
                return _ports[-1]
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
    raise AssertionError("every reserved port is in use")


@functools.lru_cache(maxsize=None)
def ros2_domain(user: str) -> int:
    """Returns a ROS 2 domain, for each user another one. Domains above 101 would use ephemeral ports."""
    return _reserve("domain", range(1, 102))


def _reserve(name: str, numbers: Iterable[int]) -> int:
    """Returns the first number that no other process has reserved."""
    for number in numbers:
        try:
            lock = open(os.path.join(tempfile.gettempdir(), f"robot_health_monitor_{name}_{number}.lock"), "a")
        except PermissionError:
            continue  # another user's
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
        else:
            _locks.append(lock)
            return number
    raise AssertionError(f"{name}: every number is reserved")
