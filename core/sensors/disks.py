"""Disks of this computer, as sources: space, inodes, whether they can be written, and how long they take.

A disk on a network that does not answer blocks whatever touches it, so `read_space` is called with `Computer.ask`.
Format of /proc/diskstats: the kernel's Documentation/admin-guide/iostats.rst; psutil 5.5, that of Noetic, cannot read
the one of Linux 5.5 and newer.
"""

from __future__ import annotations

import os
import re
from typing import Dict, List, NamedTuple, Tuple

from .computer import Computer, HostPaths, call_psutil, read_bytes
from .source import NoSuchSensor, NotMeasuredYet, SensorError

_NO_DISK = re.compile(r"(loop|ram|zram|fd|sr|dm-|md)\d+\Z")
"""Devices without a latency of their own, and those that consist of others; they can be selected by their names."""


class Space(NamedTuple):
    """What a file system has left."""

    percent: float
    """Space in use, of what users may use."""
    free_gb: float
    inodes: int
    """Number of files that it can have; 0: as many as fit."""
    free_inodes: int
    is_read_only: bool


def read_space(paths: HostPaths, path: str) -> Space:
    """Returns the space of the disk that is mounted at `path`; may hang."""
    # The empty folder of an unmounted disk would be read as the disk that contains it.
    if not os.path.ismount(path):
        raise SensorError(f"no disk is mounted at {path}{_containing_disk(path)}")
    try:
        found = os.statvfs(path)
    except (AttributeError, OSError) as error:
        raise SensorError(f"the disk at {path} cannot be read: {error}") from None
    used = found.f_blocks - found.f_bfree
    usable = used + found.f_bavail
    return Space(
        percent=100.0 * used / usable if usable else 0.0,
        free_gb=found.f_bavail * found.f_frsize * 1e-9,
        inodes=found.f_files,
        free_inodes=found.f_ffree,
        is_read_only=_is_read_only(paths, os.path.realpath(path), bool(found.f_flag & os.ST_RDONLY)),
    )


def _is_read_only(paths: HostPaths, path: str, is_for_us: bool) -> bool:
    """Returns whether nobody can write to the disk at a mount point.

    A mount may be read-only for this process alone (`is_for_us`), as under systemd's ProtectSystem=strict.
    """
    escaped = "".join(f"\\{ord(letter):03o}" if letter in " \t\n\\" else letter for letter in path)
    options = []
    try:
        for line in read_bytes(f"{paths.proc}/self/mountinfo").decode("utf-8", "surrogateescape").splitlines():
            words = line.split(" ")
            if words[4:5] == [escaped]:
                options.append(words[-1].split(","))  # those of the disk; those of the mount are before
    except OSError:
        pass
    return "ro" in options[-1] if options else is_for_us


def inodes_percent(space: Space) -> float:
    """Returns the inodes in use, in %; raises NoSuchSensor if their number is not fixed."""
    if not space.inodes:
        raise NoSuchSensor("this file system has no fixed number of inodes")
    return 100.0 * (space.inodes - space.free_inodes) / space.inodes


def _containing_disk(path: str) -> str:
    if not os.path.exists(path):
        return ": there is no such folder"
    above = os.path.realpath(path)
    while not os.path.ismount(above):
        above = os.path.dirname(above)
    return f": the folder is on the disk at {above}"


def mount_points(paths: HostPaths) -> List[str]:
    """Returns where disks are mounted, each disk once."""
    found = {"/": ""}
    for partition in call_psutil("disk_partitions", "mounted disks", paths, all=False):
        if partition.device not in found.values() and os.path.isdir(partition.mountpoint):
            found[partition.mountpoint] = partition.device
    return sorted(path for path in found if os.path.ismount(path))


class DiskLatency:
    """Mean time that a disk took for each request since the previous read, in ms."""

    def __init__(self, computer: Computer, device: str = "") -> None:
        """Measures one device or, without a name, the slowest disk."""
        self._computer = computer
        self._device = device
        self._last: Dict[str, Tuple[int, int]] = {}
        self._last_s = 0.0
        self._ms: float = -1.0

    def read(self, now_s: float) -> float:
        """Returns the time in ms, 0 without a request; the previous one if no time has passed since. May raise."""
        found = self._computer.ask(now_s, 0.0, "the disks", read_requests)
        names = [self._device] if self._device else whole_disks(found)
        if not names:
            raise NoSuchSensor("this machine has no disk")
        if names[0] not in found:
            available = ", ".join(whole_disks(found)) or "none"
            raise SensorError(f"this machine has no disk {self._device}; available: {available}")
        last, measured = self._last, [name for name in names if name in self._last]
        if last and now_s == self._last_s:
            measured = []
        else:
            self._last, self._last_s = {name: found[name] for name in names}, now_s
        if measured:
            self._ms = max(_latency_ms(last[name], found[name]) for name in measured)
        if self._ms < 0.0:
            raise NotMeasuredYet("the latency is not measured yet: it takes two reads")
        return self._ms


def _latency_ms(before: Tuple[int, int], now: Tuple[int, int]) -> float:
    requests, ms = now[0] - before[0], now[1] - before[1]
    return ms / requests if requests > 0 and ms > 0 else 0.0


def read_requests(paths: HostPaths) -> Dict[str, Tuple[int, int]]:
    """Returns per device the number of reads and writes that it finished, and the time that they took in ms."""
    file = os.path.join(paths.proc, "diskstats")
    try:
        lines = read_bytes(file).decode("utf-8", "replace").splitlines()
    except OSError as error:
        raise NoSuchSensor(f"no disks in {file}: {error.strerror}") from None
    found = {}
    for line in lines:
        columns = line.split(None, 11)
        try:
            found[columns[2]] = int(columns[3]) + int(columns[7]), int(columns[6]) + int(columns[10])
        except (IndexError, ValueError):
            continue
    return found


_PARTITION = re.compile(r"(?:[hsv]d[a-z]+\d+|xvd[a-z]+\d+|(?:nvme\d+n\d+|mmcblk\d+)(?:p|boot|rpmb)\d*)\Z")


def whole_disks(found: Dict[str, Tuple[int, int]]) -> List[str]:
    """Returns the names of those devices that are disks: no partitions, no loops."""
    return [name for name in found if not _NO_DISK.match(name) and not _PARTITION.match(name)]


def devices(paths: HostPaths) -> List[str]:
    """Returns the names of the disks."""
    return whole_disks(read_requests(paths))
