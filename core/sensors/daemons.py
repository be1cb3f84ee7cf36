"""What the daemons of this computer know, as sources: chrony, systemd-timesyncd and systemd.

Protocol of chrony: its command port (candm.h, version 6). On D-Bus, systemd's busctl asks. A daemon may hang:
everything here is called with `Computer.ask`.
"""

from __future__ import annotations

import os
import socket
import struct
import subprocess
from typing import List, NamedTuple, Optional, Tuple

from ..values.formatting import printable
from .computer import HostPaths
from .source import NoSuchSensor, SensorError

_TIMEOUT_S = 2.0
_CHRONY = "127.0.0.1", 323


class Clock(NamedTuple):
    """What the time daemon knows of this computer's clock."""

    is_synchronized: bool
    offset_ms: Optional[float]
    """Time of the servers minus that of this clock; None: not measured."""


def read_clock(paths: HostPaths) -> Clock:
    """Returns what chrony knows, else systemd-timesyncd; raises SensorError. May hang."""
    found = read_chrony(_CHRONY) if paths.run == "/run" else None
    if found is not None:
        return found
    folder = os.path.join(paths.run, "systemd", "timesync")
    if not os.path.isdir(folder):
        raise NoSuchSensor(f"no time daemon: chrony does not answer on {_CHRONY[1]}/udp, and there is no {folder}")
    return Clock(os.path.exists(os.path.join(folder, "synchronized")), _timesyncd_offset_ms(paths))


def clock_offset_ms(clock: Clock) -> float:
    """Returns the offset; raises SensorError if it is not known."""
    if clock.offset_ms is None:
        raise SensorError("the time daemon has not measured the offset yet")
    return clock.offset_ms


def read_chrony(address: Tuple[str, int]) -> Optional[Clock]:
    """Returns what chronyd knows; None if none answers."""
    request = struct.pack("!BBBBHHIII", 6, 1, 0, 0, 33, 0, 1, 0, 0).ljust(108, b"\0")  # as long as the answer
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(_TIMEOUT_S)
            client.connect(address)
            client.send(request)
            answer = client.recv(1024)
    except OSError:
        return None
    if len(answer) < 104 or struct.unpack_from("!BBxxHHH", answer) != (6, 2, 33, 5, 0):
        return None
    leap, correction = struct.unpack_from("!H12xI", answer, 28 + 26)
    if leap == 3:  # not synchronised
        return Clock(False, None)
    return Clock(True, 1000.0 * _chrony_float(correction))


def _chrony_float(bits: int) -> float:
    """Returns a number of chrony's: 7 bits of exponent and 25 of coefficient, both with signs."""
    exponent, coefficient = bits >> 25, bits & 0x1FFFFFF
    exponent -= 128 if exponent >= 64 else 0
    coefficient -= 1 << 25 if coefficient >= 1 << 24 else 0
    return float(coefficient * 2.0 ** (exponent - 25))


def _timesyncd_offset_ms(paths: HostPaths) -> Optional[float]:
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


def read_property(paths: HostPaths, service: str, name: str) -> List[str]:
    """Returns a property of a service's manager on the system's D-Bus, as busctl prints it: its type, then its values.

    Starts no service. Raises SensorError.
    """
    address = os.path.join(paths.run, "dbus", "system_bus_socket")
    if not os.path.exists(address):
        raise NoSuchSensor(f"no D-Bus of the system: there is no {address}")
    options = [f"--address=unix:path={address}", "--auto-start=no", f"--timeout={_TIMEOUT_S:g}"]
    names = [service, "/" + service.replace(".", "/"), f"{service}.Manager", name]
    try:
        done = subprocess.run(
            ["busctl", *options, "get-property", *names],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=2.0 * _TIMEOUT_S,
            check=False,
        )
    except FileNotFoundError:
        raise NoSuchSensor("no systemd: busctl is not installed") from None
    if done.returncode:
        text = printable(done.stderr.decode("utf-8", "replace").strip()[:200])
        raise NoSuchSensor(f"{service} is not there: {text or 'no reason given'}")
    return done.stdout.decode("utf-8", "replace").split()
