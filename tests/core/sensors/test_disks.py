"""Disks: latency from captured counters, space of this machine beside df."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import Computer
from robot_health_monitor.core.sensors.disks import read_requests, read_space
from robot_health_monitor.core.sensors.source import NoSuchSensor, NotMeasuredYet, SensorError

# iostats.rst: reads, merged, sectors, ms; writes, merged, sectors, ms; in flight, ms, weighted ms.
DISKS = """   7       0 loop0 9 0 9 9 0 0 0 0 0 9 9
 179       0 mmcblk0 100 5 900 400 50 7 400 1100 0 900 1500
 179       1 mmcblk0p1 60 5 400 200 0 0 0 0 0 100 200
 259       0 nvme0n1 {nvme} 0 0 0 0
 259       1 nvme0n1p2 1 0 0 1 1 0 0 1 0 1 2
   8       0 sda {sda} 0 0 0 0 0 0
   8       1 sda1 1 0 0 1 1 0 0 1 0 1 2
 253       0 dm-0 1 0 0 1 1 0 0 1 0 1 2
short 1
"""


def disks(nvme: str = "0 0 0 0 0 0 0 0", sda: str = "0 0 0 0 0 0 0 0") -> Any:
    return {"/proc/diskstats": DISKS.format(nvme=nvme, sda=sda)}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_the_disks_are_listed_without_partitions_and_loops(machine: Machine) -> None:
    machine(disks())
    assert list(read_requests(machine.paths)) == ["mmcblk0", "nvme0n1", "sda"]


def test_a_disk_is_read_only_if_nobody_can_write_to_it(machine: Machine) -> None:
    """The last mount at a place counts; that of a service may be read-only on a disk that is not."""
    for disk, mount, expected in (("rw,errors=remount-ro", "ro,nosuid", False), ("ro,seclabel", "ro", True)):
        line = "29 1 8:1 / / {mount},relatime shared:1 - ext4 /dev/sda1 {disk}\n"
        first = line.format(mount="rw", disk="ro" if not expected else "rw")
        machine(
            {"/proc/self/mountinfo": f"{first}30 29 0:5 / /dev rw - tmpfs x rw\n{line.format(mount=mount, disk=disk)}"}
        )
        assert read_space(machine.paths, "/")["disk_read_only"] == expected


def test_latency_is_the_time_per_request_of_the_slowest_disk(machine: Machine) -> None:
    machine(disks())
    slowest = HOST_SOURCES["disk_latency_ms"].make(machine.computer)
    nvme = HOST_SOURCES["disk_latency_ms"].make(machine.computer, device="nvme0n1")
    for each in (slowest, nvme):
        with pytest.raises(NotMeasuredYet):
            each.read(0.0)
    machine(disks(nvme="30 0 0 20 20 0 0 5", sda="1 0 0 250 1 0 0 150"))
    assert nvme.read(1.0) == 0.5  # 25 ms for 50 requests
    assert slowest.read(1.0) == 200.0  # 400 ms for 2
    assert slowest.read(1.0) == 200.0
    assert (slowest.read(2.0), nvme.read(2.0)) == (0.0, 0.0)  # idle
    machine(disks())  # counters began again
    assert slowest.read(3.0) == 0.0


def test_a_disk_that_is_not_there_is_named(machine: Machine) -> None:
    machine(disks())
    with pytest.raises(
        SensorError, match=r"^this machine has no disk sdb; available: loop0, mmcblk0, mmcblk0p1, .*, sda, "
    ):
        HOST_SOURCES["disk_latency_ms"].make(machine.computer, device="sdb").read(0.0)
    machine({"/proc/diskstats": "   7       0 loop0 9 0 9 9 0 0 0 0 0 9 9"})
    with pytest.raises(NoSuchSensor, match=r"^this machine has no disk$"):
        HOST_SOURCES["disk_latency_ms"].make(machine.computer).read(1.0)
    machine({"/proc/diskstats": None})
    with pytest.raises(SensorError, match=r"^the disks cannot be read: FileNotFoundError: "):
        HOST_SOURCES["disk_latency_ms"].make(machine.computer).read(20.0)


def test_the_space_of_this_machine_is_what_df_shows(machine: Machine) -> None:
    df = shutil.which("df")
    if not df:
        pytest.skip("df is not installed")
    printed = subprocess.check_output([df, "--output=ipcent,itotal,avail", "-B1000000", "/"], text=True).split()[-3:]
    space = read_space(machine.paths, "/")
    assert space["disk_free"] == pytest.approx(int(printed[2]) / 1e3, abs=1.0)
    assert space["disk_inodes_percent"] == pytest.approx(float(printed[0].rstrip("%")), abs=1.0)
    assert space["disk_read_only"] == 0.0


def test_a_read_only_disk_and_one_without_fixed_inodes(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    read_only = [path for path in ("/proc/sys", "/sys", "/sys/firmware") if os.path.ismount(path)]
    for path in read_only:
        if os.statvfs(path).f_flag & os.ST_RDONLY:
            assert read_space(machine.paths, path)["disk_read_only"] == 1.0
    plain = os.statvfs("/")
    for inodes, free in ((1000, 40), (0, 0)):
        stats = os.statvfs_result((*plain[:5], inodes, free, *plain[7:]))
        monkeypatch.setattr(os, "statvfs", lambda path, stats=stats: stats)
        read = HOST_SOURCES["disk_inodes_percent"].make(Computer(machine.paths), path="/").read
        if inodes:
            assert read(0.0) == 96.0
        else:
            with pytest.raises(NoSuchSensor, match=r"^this machine has no disk_inodes_percent$"):
                read(0.0)

    def fail(path: str) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "statvfs", fail)
    with pytest.raises(SensorError, match=r"^the disk cannot be read: OSError: .*Input/output error"):
        HOST_SOURCES["disk_free"].make(machine.computer, path="/").read(0.0)
