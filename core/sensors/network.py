"""Network interfaces of this computer, as sources: traffic, errors, carrier, Wi-Fi and CAN.

Formats: /proc/net/wireless as in proc(5) and the kernel's wireless extensions (wireless.h), files below /sys/class/net
as in Documentation/ABI/testing/sysfs-class-net. psutil counts the traffic.
"""

from __future__ import annotations

import os
import re
import socket
import struct
from typing import Callable, Sequence

from .computer import HostPaths, chosen, load_psutil, read_text, sorted_paths
from .source import NoSuchSensor, SensorError

_WIRELESS = re.compile(r"^ *([^\s:]+): +\S+ +\S+ +(-?[0-9]+)", re.MULTILINE)
"""Name, and the third column behind it: the signal."""
_CAN_TYPE = "280"
"""ARPHRD_CAN of if_arp.h."""
_GET_RATE = 0x8B21
"""SIOCGIWRATE of wireless.h."""


def read_counters(paths: HostPaths, interface: str = "") -> dict[str, Sequence[int]]:
    """Returns the counters of a network interface or, without a name, of all but the loopback, as psutil has them."""
    counters = load_psutil(paths).net_io_counters(pernic=True, nowrap=False)
    return chosen(counters, "network interface", interface, sorted(name for name in counters if name != "lo"))


def read_can_counters(paths: HostPaths, interface: str = "") -> dict[str, Sequence[int]]:
    """Returns the counters of a CAN interface or, without a name, of all of them."""
    names = can_interfaces(paths)
    counters = {name: each for name, each in read_counters(paths).items() if name in names}
    return chosen(counters, "CAN interface", interface, counters)


RECEIVED, SENT, ERRORS, DROPS = slice(1, 2), slice(0, 1), slice(4, 6), slice(6, 8)
"""The places of counters; those of errors and drops are of both directions."""


def rate(counters: slice, scale: float = 1.0) -> Callable[[list[list[float]], float], float]:
    """Returns what makes a rate per second of the growth of the counters of interfaces, added up."""
    return lambda grown, elapsed_s: scale * sum(sum(each[counters]) for each in grown) / elapsed_s


def can_interfaces(paths: HostPaths) -> list[str]:
    """Returns the names of the CAN interfaces; raises NoSuchSensor if there is none."""
    names = [name for name in _names(paths) if read_text(paths.sys, "class", "net", name, "type") == _CAN_TYPE]
    if not names:
        raise NoSuchSensor("this machine has no CAN interface")
    return names


def carrier(paths: HostPaths, interface: str = "") -> float:
    """Returns 1 if an interface has a carrier, else 0; without a name, that of any but the loopback."""
    names = _names(paths)
    chosen_names = chosen(
        dict.fromkeys(names), "network interface", interface, [name for name in names if name != "lo"]
    )
    # The file of an interface that is down cannot be read.
    return float(any(read_text(paths.sys, "class", "net", name, "carrier") == "1" for name in chosen_names))


def _names(paths: HostPaths) -> list[str]:
    return [os.path.basename(path) for path in sorted_paths(f"{paths.sys}/class/net/*")]


def wifi_signals(paths: HostPaths) -> dict[str, float]:
    """Returns the signal in dBm of each Wi-Fi interface that is connected; raises NoSuchSensor if there is none."""
    file = os.path.join(paths.proc, "net", "wireless")
    signals = {name: float(level) for name, level in _WIRELESS.findall(read_text(file) or "")}
    if not signals:
        raise NoSuchSensor(f"no Wi-Fi interface in {file}")
    # Some drivers give a byte that is to be read with its sign (wireless.h: IW_QUAL_DBM).
    return {name: level - 256.0 if level >= 64.0 else level for name, level in signals.items()}


def _wifi(paths: HostPaths, interface: str) -> tuple[str, float]:
    """Returns the name and the signal of a Wi-Fi interface, without a name of the first."""
    signals = wifi_signals(paths)
    (named_signal,) = chosen(signals, "Wi-Fi interface", interface, [*signals][:1]).items()
    return named_signal


def signal_dbm(paths: HostPaths, interface: str = "") -> float:
    """Returns the signal of a Wi-Fi interface, without a name of the first, in dBm."""
    name, level = _wifi(paths, interface)
    if level >= 0.0:  # what drivers give while they are not connected
        raise SensorError(f"{name} is not connected: its signal reads {level:g} dBm")
    return level


def bitrate(paths: HostPaths, interface: str = "") -> float:
    """Returns the bit rate of a Wi-Fi interface, without a name of the first, in Mbit/s."""
    import fcntl

    name, _ = _wifi(paths, interface)
    request = struct.pack("16s16x", name.encode("utf-8", "replace")[:15])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        answer = fcntl.ioctl(control.fileno(), _GET_RATE, request)
    (bits_per_s,) = struct.unpack_from("i", answer, 16)
    return float(bits_per_s) * 1e-6
