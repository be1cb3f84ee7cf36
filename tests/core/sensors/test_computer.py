"""What several sources read is read once per period; what hangs delays nothing."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from harness.waiting import wait_for

from robot_health_monitor.core.sensors.computer import (
    Computer,
    HostPaths,
    read_bytes,
    read_float,
    read_text,
    sorted_paths,
)
from robot_health_monitor.core.sensors.source import NoSuchSensor, NotMeasuredYet, SensorError
from robot_health_monitor.runtime.threads import DetachedCalls


class Disk:
    """A disk on a network that answers when it is told to."""

    def __init__(self) -> None:
        self.answers = threading.Event()
        self.answers.set()
        self.reads = 0

    def read(self, paths: HostPaths) -> int:
        self.reads += 1
        assert self.answers.wait(30.0)
        return self.reads


def test_absent_hardware_is_searched_for_every_ten_seconds_and_other_errors_are_read_each_time() -> None:
    computer, searched_s = Computer(), []
    error = [NoSuchSensor("no battery"), NoSuchSensor("no battery"), SensorError("unplugged")]

    def search(paths: HostPaths) -> None:
        searched_s.append(now_s)
        raise error[min(len(searched_s) - 1, 2)]

    for now_s in (0.0, 1.0, 9.9, 10.0, 19.0, 20.0, 21.0):
        with pytest.raises(SensorError):
            computer.ask(now_s, 0.0, "the battery", search)
    assert searched_s == [0.0, 10.0, 20.0, 21.0]


def test_after_time_went_back_absent_hardware_is_searched_for_again() -> None:
    computer, searched_s = Computer(), []

    def search(paths: HostPaths) -> None:
        searched_s.append(now_s)
        raise NoSuchSensor("no battery")

    for now_s in (100.0, 5.0, 6.0):
        with pytest.raises(NoSuchSensor):
            computer.ask(now_s, 0.0, "the battery", search)
    assert searched_s == [100.0, 5.0]


def test_an_answer_is_asked_for_when_it_is_due() -> None:
    computer, disk = Computer(), Disk()
    answers = [computer.ask(now_s, 5.0, "the disk", disk.read) for now_s in (0.0, 1.0, 4.9, 5.0, 5.0, 9.0, 10.0)]
    assert answers == [1, 1, 1, 2, 2, 2, 3]
    assert computer.ask(3.0, 5.0, "the disk", disk.read) == 4  # time went back


def test_what_is_asked_every_period_is_shared_within_it() -> None:
    computer, disk = Computer(), Disk()
    assert [computer.ask(now_s, 0.0, "the disk", disk.read) for now_s in (0.0, 0.0, 1.0)] == [1, 1, 2]


def test_a_disk_that_hangs_delays_nothing_and_comes_back() -> None:
    calls = DetachedCalls("test", patience_s=0.0)
    computer, disk, other = Computer(background=calls), Disk(), Disk()

    disk.answers.clear()
    for now_s in (0.0, 1.0, 4.9):
        with pytest.raises(NotMeasuredYet, match=r"no answer from the disk yet"):
            computer.ask(now_s, 0.0, "the disk", disk.read)
    for now_s in (5.0, 6.0):
        with pytest.raises(SensorError, match=r"no answer from the disk for more than 5 s") as caught:
            computer.ask(now_s, 0.0, "the disk", disk.read)
        assert not isinstance(caught.value, NotMeasuredYet)
    other.answers.clear()
    with pytest.raises(NotMeasuredYet):
        computer.ask(6.0, 0.0, "another disk", other.read)
    disk.answers.set()
    other.answers.set()
    wait_for(lambda: all(each.is_set() for each in calls._running))
    assert disk.reads == 1  # one thread hangs, however often it is read
    assert computer.ask(7.0, 0.0, "the disk", disk.read) == 1  # the late answer
    calls.close()


def test_sources_that_hang_are_bounded() -> None:
    calls = DetachedCalls("test", most_threads=2, patience_s=0.0)
    computer = Computer(background=calls)
    disks = [Disk() for _ in range(3)]
    try:
        for disk in disks:
            disk.answers.clear()
        for disk in disks[:2]:
            with pytest.raises(NotMeasuredYet):
                computer.ask(0.0, 0.0, "the disk", disk.read)
        with pytest.raises(SensorError, match=r"^2 sources do not answer: no thread is left$"):
            computer.ask(0.0, 0.0, "the disk", disks[2].read)
    finally:
        for disk in disks:
            disk.answers.set()
        calls.close()


def test_what_a_driver_raises_is_an_error_of_the_source() -> None:
    def broken(paths: HostPaths) -> int:
        raise ZeroDivisionError("driver")

    with pytest.raises(SensorError, match=r"^the driver cannot be read: ZeroDivisionError: driver$"):
        Computer().ask(0.0, 0.0, "the driver", broken)


def test_a_file_that_comes_in_parts_is_read_to_its_end_and_not_beyond(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)

    def write() -> None:
        with open(pipe, "wb", buffering=0) as stream:
            for _ in range(10):
                stream.write(b"x" * 1000)

    writer = threading.Thread(target=write)
    writer.start()
    assert read_bytes(str(pipe)) == b"x" * 10_000
    writer.join()
    large = tmp_path / "large"
    large.write_bytes(b"y" * 100_000)
    assert len(read_bytes(str(large), 70_000)) == 70_000
    with pytest.raises(FileNotFoundError):
        read_bytes(str(tmp_path / "missing"))


def test_a_file_that_is_missing_or_no_number_is_none(tmp_path: Path) -> None:
    (tmp_path / "number").write_text(" 42\n")
    (tmp_path / "text").write_bytes(b"\xff\n")
    assert read_float(str(tmp_path), "number") == 42.0
    assert read_float(str(tmp_path), "text") is None
    assert read_float(str(tmp_path), "missing") is None
    assert read_text(str(tmp_path), "text") == "\N{REPLACEMENT CHARACTER}"
    assert read_text(str(tmp_path), "missing") is None


def test_paths_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for name in ("hwmon10", "hwmon9", "hwmon1"):
        (tmp_path / name).touch()
    assert [os.path.basename(path) for path in sorted_paths(f"{tmp_path}/hwmon*")] == ["hwmon1", "hwmon9", "hwmon10"]
