"""The operating system of this computer, as sources: memory, pressure, killed processes, throttling.

Formats: the kernel's Documentation/accounting/psi.rst, proc(5), and the firmware of the Raspberry Pi (get_throttled).
"""

from __future__ import annotations

import os
from typing import Any

from .computer import HostPaths, read_text
from .source import NoSuchSensor


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
    # There is a file, but it cannot be read, where the kernel was started with psi=0.
    return _number(f"{paths.proc}/pressure/{resource}", "some avg10=", "this kernel does not measure pressure")


def oom_kills(paths: HostPaths) -> float:
    """Returns how many processes the kernel has killed since it started because memory was used up."""
    return _number(f"{paths.proc}/vmstat", "oom_kill ", "this kernel does not count processes that it kills")


def throttled(paths: HostPaths) -> float:
    """Returns 1 while a Raspberry Pi runs slower because of its supply or its temperature, else 0."""
    file = os.path.join(paths.sys, "devices", "platform", "soc", "soc:firmware", "get_throttled")
    text = read_text(file)
    if text is None:
        raise NoSuchSensor(f"no Raspberry Pi: there is no {file}")
    # Bits 0 to 3: under-voltage, frequency capped, throttled, soft temperature limit, now; 16 to 19: since the start.
    return float(int(text, 16) & 0xF != 0)


def _number(file: str, name: str, missing: str) -> float:
    """Returns the number behind a name at the begin of a line; raises NoSuchSensor if there is no such line."""
    text = read_text(file) or ""
    _, line, rest = f"\n{text}".partition(f"\n{name}")  # much faster than a pattern
    if not line:
        raise NoSuchSensor(f"{missing}: {file} has no {name.rstrip(' =')}")
    return float(rest.split(maxsplit=1)[0])
