"""What the daemons of this computer know, as sources: chrony, systemd-timesyncd and systemd, by their own sockets.

No program is run. Protocols: chrony's command port (candm.h, version 6); the D-Bus specification, of which this module
reads one property per connection. A daemon may hang: everything here is called with `Computer.ask`.
"""

from __future__ import annotations

import os
import socket
import struct
from typing import NamedTuple, Optional, Tuple

from .computer import HostPaths
from .source import NoSuchSensor, SensorError

__all__ = ["Clock", "clock_offset_ms", "failed_units", "read_chrony", "read_clock"]

_TIMEOUT_S = 2.0
_CHRONY = "127.0.0.1", 323
_MOST_BYTES = 1 << 16
"""Of an answer on D-Bus."""


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
        body = read_property(paths, "org.freedesktop.timesync1", "Manager", "NTPMessage")
        place = _after_signature(body, b"(uuuuittayttttbtt)", 8) + 20  # leap, version, mode, stratum, precision
        place = _aligned(place, 8) + 16  # root delay and dispersion
        (length,) = struct.unpack_from("<I", body, place)
        times = struct.unpack_from("<4Q", body, _aligned(place + 4 + length, 8))
    except (SensorError, struct.error):
        return None
    origin, received, transmitted, arrived = times
    return None if not origin else ((received - origin) + (transmitted - arrived)) / 2000.0


def failed_units(paths: HostPaths) -> float:
    """Returns the number of units of systemd that failed; raises SensorError. May hang."""
    body = read_property(paths, "org.freedesktop.systemd1", "Manager", "NFailedUnits")
    try:
        (number,) = struct.unpack_from("<I", body, _after_signature(body, b"u", 4))
    except struct.error:
        raise SensorError("systemd's answer is cut off") from None
    return float(number)


def read_property(paths: HostPaths, service: str, interface: str, name: str) -> bytes:
    """Returns a property of a service on the system's D-Bus, as the body of the answer; raises SensorError."""
    address = os.path.join(paths.run, "dbus", "system_bus_socket")
    if not os.path.exists(address):
        raise NoSuchSensor(f"no D-Bus of the system: there is no {address}")
    path = "/" + service.replace(".", "/")
    try:
        with socket.socket(socket.AF_UNIX) as bus:
            bus.settimeout(_TIMEOUT_S)
            bus.connect(address)
            bus.sendall(b"\0AUTH EXTERNAL " + str(os.getuid()).encode().hex().encode() + b"\r\n")
            if not _receive_line(bus).startswith(b"OK"):
                raise SensorError("the system's D-Bus refuses this user")
            own = "org.freedesktop.DBus"
            get = _call(2, service, path, f"{own}.Properties", "Get", f"{service}.{interface}", name)
            bus.sendall(b"BEGIN\r\n" + _call(1, own, "/org/freedesktop/DBus", own, "Hello") + get)
            _receive_reply(bus)
            is_error, body = _receive_reply(bus)
    except OSError as error:
        raise SensorError(f"{service} does not answer on D-Bus: {error}") from None
    if is_error:
        text = body[4:-1].decode("utf-8", "replace") if len(body) > 5 else "no reason given"
        raise NoSuchSensor(f"{service} is not there: {text[:200]}")
    return body


def _call(serial: int, destination: str, path: str, interface: str, member: str, *arguments: str) -> bytes:
    """Returns a call of a method with texts as arguments, which starts no service."""
    fields = [(1, "o", path), (2, "s", interface), (3, "s", member), (6, "s", destination)]
    body = b""
    for argument in arguments:
        body = _padded(body, 4) + _text(argument)
    header = b""
    for code, kind, value in fields:
        header = _padded(header, 8) + bytes([code, 1]) + kind.encode() + b"\0" + _text(value)
    if arguments:
        signature = b"s" * len(arguments)
        header = _padded(header, 8) + bytes([8, 1]) + b"g\0" + bytes([len(signature)]) + signature + b"\0"
    no_auto_start = 2
    start = struct.pack("<cBBBIII", b"l", 1, no_auto_start, 1, len(body), serial, len(header))
    return _padded(start + header, 8) + body


def _text(value: str) -> bytes:
    content = value.encode()
    return struct.pack("<I", len(content)) + content + b"\0"


def _aligned(place: int, to: int) -> int:
    return -(-place // to) * to


def _padded(content: bytes, to: int) -> bytes:
    return content.ljust(_aligned(len(content), to), b"\0")


def _after_signature(body: bytes, signature: bytes, to: int) -> int:
    """Returns where the value of a variant begins."""
    expected = bytes([len(signature)]) + signature + b"\0"
    if not body.startswith(expected):
        raise SensorError(f"unexpected answer on D-Bus: {body[:40]!r}")
    return _aligned(len(expected), to)


def _receive_line(bus: socket.socket) -> bytes:
    line = b""
    while not line.endswith(b"\r\n"):
        byte = bus.recv(1)
        if not byte or len(line) > 1000:
            raise SensorError("the system's D-Bus closed the connection")
        line += byte
    return line


def _receive_reply(bus: socket.socket) -> Tuple[bool, bytes]:
    """Returns whether the next reply is an error, and its body; signals are skipped."""
    for _ in range(20):
        start = _receive(bus, 16)
        order, kind, _, _, length, _, header = struct.unpack("<cBBBIII", start)
        if order != b"l" or length + header > _MOST_BYTES:
            break
        rest = _receive(bus, _aligned(header, 8) + length)
        if kind in (2, 3):
            return kind == 3, rest[_aligned(header, 8) :]
    raise SensorError("unexpected answer on D-Bus")


def _receive(bus: socket.socket, length: int) -> bytes:
    content = b""
    while len(content) < length:
        part = bus.recv(length - len(content))
        if not part:
            raise SensorError("the system's D-Bus closed the connection")
        content += part
    return content
