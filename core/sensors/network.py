"""Network interfaces of this computer, as sources: traffic, errors, carrier, Wi-Fi and CAN.

Formats: /proc/net/wireless as in proc(5) and the kernel's wireless extensions (wireless.h), files below /sys/class/net
as in Documentation/ABI/testing/sysfs-class-net. psutil counts the traffic.
"""

from __future__ import annotations

import os
import socket
import struct
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

from .computer import Computer, HostPaths, call_psutil, read_bytes, read_text
from .source import NoSuchSensor, NotMeasuredYet, SensorError

_CAN_TYPE = "280"
"""ARPHRD_CAN of if_arp.h."""
_GET_RATE = 0x8B21
"""SIOCGIWRATE of wireless.h."""


class CounterRate:
    """Rate at which counters of network interfaces grow, per second."""

    def __init__(
        self,
        fields: Tuple[str, ...],
        scale: float,
        computer: Computer,
        interface: str = "",
        among: Optional[Callable[[HostPaths], List[str]]] = None,
    ) -> None:
        """Adds up counters of one interface or, without a name, of all of `among`.

        Args:
            fields: names of the counters, as psutil.net_io_counters has them.
            scale: the rate is multiplied by it.
            computer: whose interfaces.
            interface: name of one; empty: all together.
            among: returns the names that `interface` may have; None: any, and all together without the loopback.
        """
        self._fields = fields
        self._scale = scale
        self._computer = computer
        self._interface = interface
        self._among = among
        self._last: Optional[Tuple[float, int]] = None
        self._rate: Optional[float] = None

    def read(self, now_s: float) -> float:
        """Returns the rate since the previous read; the previous one if no time has passed since.

        Raises SensorError if there is no such interface, or if the rate has not been measured yet.
        """
        try:
            count = self._count(now_s)
        except NotMeasuredYet:
            raise
        except SensorError:
            self._last = self._rate = None
            raise
        if self._last is None or now_s < self._last[0]:
            self._last = now_s, count
        elif now_s > self._last[0]:
            # A counter that is smaller than before was reset.
            self._rate = self._scale * max(0, count - self._last[1]) / (now_s - self._last[0])
            self._last = now_s, count
        if self._rate is None:
            raise NotMeasuredYet("the rate is not measured yet: it takes two reads")
        return self._rate

    def _count(self, now_s: float) -> int:
        among = None if self._among is None else self._computer.ask(now_s, 0.0, "the network", self._among)
        counters = self._computer.ask(now_s, 0.0, "the network", read_counters)
        named = [name for name in (counters if among is None else among) if name in counters]
        chosen = [self._interface] if self._interface else [name for name in named if name != "lo"]
        if not chosen or chosen[0] not in named:
            name = f" {self._interface}" if self._interface else ""
            available = ", ".join(sorted(named)) or "none"
            raise SensorError(f"this machine has no network interface{name}; available: {available}")
        return sum(getattr(counters[name], field) for name in chosen for field in self._fields)


def read_counters(paths: HostPaths) -> Dict[str, Any]:
    """Returns the counters of each network interface, as psutil does."""
    found: Dict[str, Any] = call_psutil("net_io_counters", "the network counters", paths, pernic=True, nowrap=False)
    return found


def interfaces(paths: HostPaths) -> List[str]:
    """Returns the names of the network interfaces, without the loopback."""
    return sorted(name for name in read_counters(paths) if name != "lo")


def can_interfaces(paths: HostPaths) -> List[str]:
    """Returns the names of the CAN interfaces; raises NoSuchSensor if there is none."""
    folder = os.path.join(paths.sys, "class", "net")
    found = [name for name in _names(folder) if read_text(folder, name, "type") == _CAN_TYPE]
    if not found:
        raise NoSuchSensor(f"no CAN interface in {folder}")
    return found


def carrier(paths: HostPaths, interface: str) -> float:
    """Returns 1 if an interface has a carrier, else 0; without a name, that of any but the loopback."""
    folder = os.path.join(paths.sys, "class", "net")
    names = _names(folder)
    if interface and interface not in names:
        raise SensorError(f"this machine has no network interface {interface}; available: {', '.join(names) or 'none'}")
    chosen = [interface] if interface else [name for name in names if name != "lo"]
    if not chosen:
        raise NoSuchSensor(f"no network interface in {folder}")
    # The file of an interface that is down cannot be read.
    return float(any(read_text(folder, name, "carrier") == "1" for name in chosen))


def _names(folder: str) -> List[str]:
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []


def wifi_signals(paths: HostPaths) -> Dict[str, float]:
    """Returns the signal in dBm of each Wi-Fi interface that is connected; raises NoSuchSensor if there is none."""
    file = os.path.join(paths.proc, "net", "wireless")
    try:
        lines = read_bytes(file).decode("utf-8", "replace").splitlines()[2:]
    except OSError:
        raise NoSuchSensor(f"no Wi-Fi interface: there is no {file}") from None
    found = {}
    for line in lines:
        name, colon, numbers = line.partition(":")
        columns = numbers.split()
        try:
            level = float(columns[2].rstrip("."))
        except (IndexError, ValueError):
            continue
        if colon:
            # Some drivers give a byte that is to be read with its sign (wireless.h: IW_QUAL_DBM).
            found[name.strip()] = level - 256.0 if level >= 64.0 else level
    if not found:
        raise NoSuchSensor(f"no Wi-Fi interface in {file}")
    return found


def wifi_interfaces(paths: HostPaths) -> List[str]:
    """Returns the names of the Wi-Fi interfaces."""
    return list(wifi_signals(paths))


def signal_dbm(paths: HostPaths, interface: str) -> float:
    """Returns the signal of a Wi-Fi interface, without a name of the first, in dBm."""
    signals = wifi_signals(paths)
    level = signals[_chosen(signals, interface)]
    if level >= 0.0:  # what drivers give while they are not connected
        raise SensorError(f"{_chosen(signals, interface)} is not connected: its signal reads {level:g} dBm")
    return level


def bitrate(paths: HostPaths, interface: str) -> float:
    """Returns the bit rate of a Wi-Fi interface, without a name of the first, in Mbit/s."""
    import fcntl

    name = _chosen(wifi_signals(paths), interface)
    request = struct.pack("16s16x", name.encode("utf-8", "replace")[:15])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        try:
            answer = fcntl.ioctl(control.fileno(), _GET_RATE, request)
        except OSError as error:
            raise SensorError(f"the bit rate of {name} cannot be read: {error.strerror}") from None
    (bits_per_s,) = struct.unpack_from("i", answer, 16)
    return float(bits_per_s) * 1e-6


def _chosen(signals: Mapping[str, float], interface: str) -> str:
    if interface and interface not in signals:
        raise SensorError(f"this machine has no Wi-Fi interface {interface}; available: {', '.join(signals)}")
    return interface or next(iter(signals))
