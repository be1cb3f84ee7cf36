"""The operating system of this computer, as sources: memory, pressure, killed processes, throttling.

Formats: the kernel's Documentation/accounting/psi.rst, proc(5), and the firmware of the Raspberry Pi (get_throttled).
"""

from __future__ import annotations

import os
from typing import Any

from .computer import HostPaths, read_bytes, read_text
from .source import NoSuchSensor, SensorError


def memory_percent(memory: Any) -> float:
    """Returns the memory that programs can no longer get, in %, of `psutil.virtual_memory()`."""
    return float(100.0 * (memory.total - memory.available) / memory.total)  # its own percentage is rounded


def swap_percent(swap: Any) -> float:
    """Returns the swap in use, in %, of `psutil.swap_memory()`."""
    if not swap.total:
        raise NoSuchSensor("this machine has no swap")
    return float(100.0 * (swap.total - swap.free) / swap.total)


def pressure_percent(paths: HostPaths, resource: str) -> float:
    """Returns the share of the last 10 s in which some process waited for a resource: cpu, memory or io."""
    file = os.path.join(paths.proc, "pressure", resource)
    text = read_text(file)
    if text is None:  # there is a file, but it cannot be read, where the kernel was started with psi=0
        raise NoSuchSensor(f"this kernel does not measure pressure: {file} cannot be read")
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["some"]:
            for word in words[1:]:
                name, _, value = word.partition("=")
                if name == "avg10":
                    return _number(value, file)
    raise SensorError(f"{file} has no avg10")


def oom_kills(paths: HostPaths) -> float:
    """Returns how many processes the kernel has killed since it started because memory was used up."""
    file = os.path.join(paths.proc, "vmstat")
    try:
        content = read_bytes(file)
    except OSError:
        content = b""
    _, found, rest = content.partition(b"\noom_kill ")  # since Linux 4.13
    if not found:
        raise NoSuchSensor(f"this kernel does not count processes that it kills: {file} has no oom_kill")
    return _number(rest.split(b"\n", 1)[0].decode("ascii", "replace"), file)


def throttled(paths: HostPaths) -> float:
    """Returns 1 while a Raspberry Pi runs slower because of its supply or its temperature, else 0."""
    file = os.path.join(paths.sys, "devices", "platform", "soc", "soc:firmware", "get_throttled")
    text = read_text(file)
    if text is None:
        raise NoSuchSensor(f"no Raspberry Pi: there is no {file}")
    try:
        bits = int(text, 16)
    except ValueError:
        raise SensorError(f"{file}: expected a hexadecimal number, got {text[:40]!r}") from None
    # Bits 0 to 3: under-voltage, frequency capped, throttled, soft temperature limit, now; 16 to 19: since the start.
    return float(bits & 0xF != 0)


def _number(text: str, file: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise SensorError(f"{file}: expected a number, got {text[:40]!r}") from None
