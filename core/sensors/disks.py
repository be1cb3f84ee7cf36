"""Disks of this computer, as sources: space, inodes, whether they can be written, and how long they take.

A disk on a network that does not answer blocks whatever touches it, so `read_space` is called with `Computer.ask`.
Format of /proc/diskstats: the kernel's Documentation/admin-guide/iostats.rst; psutil 5.5, that of Noetic, cannot read
the one of Linux 5.5 and newer.
"""

from __future__ import annotations

import contextlib
import os
import re

from .computer import HostPaths, chosen, load_psutil, read_bytes
from .source import SensorError

_NO_DISK = re.compile(
    r"(?:(?:loop|ram|zram|fd|sr|dm-|md)\d+|[hsv]d[a-z]+\d+|xvd[a-z]+\d+|(?:nvme\d+n\d+|mmcblk\d+)(?:p|boot|rpmb)\d*)\Z"
)
"""Devices without a latency, those that consist of others, and partitions; they can be selected by their names."""


def read_space(paths: HostPaths, path: str = "/") -> dict[str, float]:
    """Returns what is known of the space of the disk that is mounted at `path`, by the names of the sources; may hang.

    The number of inodes is not fixed on every file system.
    """
    # The empty folder of an unmounted disk would be read as the disk that contains it.
    if not os.path.ismount(path):
        raise SensorError(f"no disk is mounted at {path}")
    stats = os.statvfs(path)
    used = stats.f_blocks - stats.f_bfree
    usable = used + stats.f_bavail
    numbers = {
        "disk_percent": 100.0 * used / usable if usable else 0.0,
        "disk_free": stats.f_bavail * stats.f_frsize * 1e-9,
        "disk_read_only": float(_is_read_only(paths, os.path.realpath(path), bool(stats.f_flag & os.ST_RDONLY))),
    }
    if stats.f_files:
        numbers["disk_inodes_percent"] = 100.0 * (stats.f_files - stats.f_ffree) / stats.f_files
    return numbers


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


def mount_points(paths: HostPaths) -> list[str]:
    """Returns where disks are mounted, each disk once."""
    partitions = [each for each in load_psutil(paths).disk_partitions(all=False) if os.path.isdir(each.mountpoint)]
    first = {each.device: each.mountpoint for each in reversed(partitions)}
    return sorted(path for path in {"/", *first.values()} if os.path.ismount(path))


def read_requests(paths: HostPaths, device: str = "") -> dict[str, tuple[int, int]]:
    """Returns the number of reads and writes that disks finished, and the time that they took in ms.

    Of one device or, without a name, of all disks: no partitions, no loops.
    """
    requests: dict[str, tuple[int, int]] = {}
    for line in read_bytes(f"{paths.proc}/diskstats").decode("utf-8", "replace").splitlines():
        columns = line.split(None, 11)
        with contextlib.suppress(IndexError, ValueError):
            requests[columns[2]] = int(columns[3]) + int(columns[7]), int(columns[6]) + int(columns[10])
    return chosen(requests, "disk", device, [name for name in requests if not _NO_DISK.match(name)])


def latency_ms(grown: list[list[float]], elapsed_s: float) -> float:
    """Returns the mean time that the slowest disk took for each request, in ms, 0 without a request."""
    return max(ms / requests if requests else 0.0 for requests, ms in grown)
