"""What the daemons of this computer know, as sources: chrony, systemd-timesyncd and systemd.

Their own tools ask them: chronyc, and systemd's busctl on D-Bus. A daemon may hang: everything here is called with
`Computer.ask`.
"""

from __future__ import annotations

import os
import subprocess
from typing import Any, Dict, Optional

from ..values import printable
from .computer import HostPaths
from .source import NoSuchSensor, SensorError

_TIMEOUT_S = 2.0


Clock = Dict[str, Optional[float]]
"""What the time daemon knows of this computer's clock, by the names of the sources.

The offset, the time of the servers minus that of this clock, is None if it is not measured."""


def read_clock(paths: HostPaths) -> Clock:
    """Returns what chrony knows, else systemd-timesyncd; raises SensorError. May hang."""
    clock = read_chrony() if paths.run == "/run" else None
    if clock is not None:
        return clock
    folder = os.path.join(paths.run, "systemd", "timesync")
    if not os.path.isdir(folder):
        raise NoSuchSensor(f"no time daemon: chronyc reaches none, and there is no {folder}")
    is_synchronized = os.path.exists(os.path.join(folder, "synchronized"))
    return {"clock_synchronized": float(is_synchronized), "clock_offset_ms": _timesyncd_offset_ms(paths)}


def read_chrony(*options: str) -> Clock | None:
    """Returns what chronyd knows, as chronyc prints it in CSV: the offset is the fifth field. None if none answers."""
    try:
        fields = _run("chronyc", "-n", "-c", *options, "tracking").strip().split(",")
    except (SensorError, subprocess.TimeoutExpired):
        return None
    if len(fields) < 14:
        return None
    is_synchronized = fields[-1] != "Not synchronised"
    offset_ms = 1000.0 * float(fields[4]) if is_synchronized else None
    return {"clock_synchronized": float(is_synchronized), "clock_offset_ms": offset_ms}


def _run(*command: str) -> str:
    """Returns what a tool prints; raises NoSuchSensor if it is not installed or its daemon is not there."""
    options: Any = {"stdin": subprocess.DEVNULL, "capture_output": True, "encoding": "utf-8", "errors": "replace"}
    try:
        done: subprocess.CompletedProcess[str] = subprocess.run(command, timeout=2.0 * _TIMEOUT_S, **options)
    except OSError as error:
        raise NoSuchSensor(f"{command[0]} cannot be run: {error.strerror}") from None
    if done.returncode:
        raise NoSuchSensor(f"{command[0]}: {printable(done.stderr.strip()[:200]) or 'no reason given'}")
    return done.stdout


def _timesyncd_offset_ms(paths: HostPaths) -> float | None:
    """Returns the offset of the latest answer of the server (RFC 5905, section 8), None without one."""
    try:
        words = read_property(paths, "org.freedesktop.timesync1", "NTPMessage")
        # (uuuuittayttttbtt): leap, version, mode, stratum, precision, two delays, the bytes of a name, four times.
        begin = 9 + int(words[8])
        origin, received, transmitted, arrived = map(int, words[begin : begin + 4])
    except (SensorError, subprocess.TimeoutExpired, ValueError, IndexError):
        return None
    return None if not origin else ((received - origin) + (transmitted - arrived)) / 2000.0


def failed_units(paths: HostPaths) -> float:
    """Returns the number of units of systemd that failed; raises SensorError. May hang."""
    _, number = read_property(paths, "org.freedesktop.systemd1", "NFailedUnits")
    return float(number)


def read_property(paths: HostPaths, service: str, name: str) -> list[str]:
    """Returns a property of a service's manager on the system's D-Bus, as busctl prints it: its type, then its values.

    Starts no service. Raises SensorError.
    """
    address = os.path.join(paths.run, "dbus", "system_bus_socket")
    options = [f"--address=unix:path={address}", "--auto-start=no", f"--timeout={_TIMEOUT_S:g}"]
    names = [service, "/" + service.replace(".", "/"), f"{service}.Manager", name]
    return _run("busctl", *options, "get-property", *names).split()
