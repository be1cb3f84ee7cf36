"""The black box of a process: disks that fail, limits, other processes, kill -9. An alert never waits for any of it."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Iterator

import pytest
from harness.black_boxes import BATTERY, KILLED, RecordedRobot, recorded
from harness.waiting import wait_for

pytest.importorskip("mcap")

from robot_health_monitor.core import Level
from robot_health_monitor.ops.black_box import black_box
from robot_health_monitor.ops.black_box.folder import find_file
from robot_health_monitor.ops.black_box.recording_file import RecordingFile


def faults(robot: RecordedRobot) -> list[str]:
    return [f"{part}: {fault.text}" for part, fault in robot.operations.faults.current().items() if "black" in part]


def alert(robot: RecordedRobot) -> str:
    """Causes an alert and waits until its recording has ended; returns the name of its file."""
    robot.feed(1.0, 50.0)
    robot.feed(1.0, 15.0)
    name = robot.transitions[-1].black_box
    robot.feed(15.0, 50.0)
    return name


@pytest.fixture
def small_files() -> Iterator[int]:
    """Makes the disk full for files of more than 100 kB: writing fails with EFBIG."""
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    yield 100_000
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_is_a_fault_that_the_next_file_ends(tmp_path: Path, small_files: int) -> None:
    robot = RecordedRobot(tmp_path, topics=("/noise",))
    robot.feed(1.0, 50.0)
    robot.feed(1.0, 15.0)
    robot.publish("/noise", {"data": os.urandom(200_000).hex()}, "std_msgs/String")
    robot.wait(15.0)
    assert robot.files() == []
    assert [text for text in faults(robot) if text.startswith("black box: ") and "File too large" in text]
    assert os.listdir(tmp_path) == []
    assert [each.to_level for each in robot.transitions] == [Level.WARN, Level.STALE]
    robot.wait(60.0)
    alert(robot)
    assert len(robot.files()) == 1
    assert faults(robot) == []
    robot.close()


def test_a_folder_that_cannot_be_created_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    robot = RecordedRobot(tmp_path / "file" / "folder")
    alert(robot)
    assert robot.files() == []
    assert faults(robot) == [f"black box: {tmp_path}/file/folder: Not a directory"]
    robot.close()


def test_a_folder_of_another_monitor_is_a_fault_until_that_one_ends(tmp_path: Path) -> None:
    first = RecordedRobot(tmp_path)
    alert(first)
    (kept,) = first.files()
    second = RecordedRobot(tmp_path, name="r2")
    wait_for(lambda: faults(second))
    assert faults(second) == [f"black box: {tmp_path}: another monitor writes into this folder"]
    alert(second)
    assert second.files() == [kept]
    first.close()
    name = alert(second)
    assert second.files() == [kept, tmp_path / name]
    assert faults(second) == []
    second.close()


def test_without_the_library_there_is_one_fault_and_no_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    monkeypatch.setitem(sys.modules, "mcap", None)
    robot = RecordedRobot(tmp_path)
    assert alert(robot) == ""
    assert faults(robot) == ["black box: nothing is recorded: mcap is not installed: pip install mcap"]
    assert [each.to_level for each in robot.transitions] == [Level.WARN, Level.OK]
    assert robot.bus.graph().nodes["/alert_system"].subscribes.count("/battery") == 1
    robot.close()


def test_a_slow_disk_delays_no_alert_and_what_is_lost_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    may_write = threading.Event()
    write = RecordingFile.write

    def slow(file: RecordingFile, *arguments: Any) -> None:
        may_write.wait(30.0)
        write(file, *arguments)

    monkeypatch.setattr(RecordingFile, "write", slow)
    robot = RecordedRobot(tmp_path, memory_mb=1.0, after_s=600.0)
    robot.feed(1.0, 50.0)
    robot.feed(500.0, 15.0, rate_hz=20.0)  # 10,000 messages take more than 1 MB
    robot.feed(5.0, 5.0)
    assert [each.to_level for each in robot.transitions] == [Level.WARN, Level.ERROR]
    may_write.set()
    robot.wait(1000.0)
    robot.files()
    assert robot.operations.black_box is not None
    robot.operations.black_box.wake()
    wait_for(lambda: faults(robot))
    (text,) = faults(robot)
    assert text.startswith("black box messages: ")
    assert text.endswith(" messages are missing in recordings: the disk was too slow for memory_mb 1")
    robot.close()


def test_a_folder_full_of_open_alerts_is_a_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    signals = {name: {**BATTERY, "topic": name} for name in "abc"}
    robot = RecordedRobot(tmp_path, signals, keep_mb=1.0, topics=("/noise",), after_s=1.0)
    names = []
    for name in "abc":
        for each in "abc":
            robot.publish(each, 50.0 if each >= name else 15.0)
        robot.wait(1.0)
        robot.publish("/noise", {"data": os.urandom(300_000).hex()}, "std_msgs/String")
        robot.publish(name, 15.0)
        names.append(robot.transitions[-1].black_box)
        for _ in range(40):  # far from the message before
            robot.wait(1.0)
            for each in "abc":
                robot.publish(each, 50.0 if each > name else 15.0)
        robot.files()
    kept = [path.name for path in robot.files()]
    assert kept == sorted(names[:2])
    full = "nothing is recorded: the recordings of open alerts take keep_mb (1)"
    assert faults(robot) == [f"black box folder: {full}"]
    robot.close()


def test_names_are_unique_and_harmless(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path)
    box = robot.operations.black_box
    assert box is not None
    names = [box.new_name("../r 1", "drivers[motor: left]\n" * 20) for _ in range(3)] + [box.new_name("ä", "")]
    assert len(set(names)) == 4
    for name in names:
        (tmp_path / name).write_text("")
        assert find_file(str(tmp_path), name) == str(tmp_path / name)
    assert names[0].startswith("r_1_20231114T223000.000Z_drivers_motor_left_")
    robot.close()


def test_a_camera_does_not_exceed_the_memory(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path, memory_mb=4.0, topics=("/camera/image",), before_s=10.0)
    assert robot.operations.black_box is not None
    ring = robot.operations.black_box.ring
    image = {"data": "A" * 300_000}
    for number in range(60):
        robot.wait(1.0 / 30.0)
        robot.publish("/camera/image", image, "sensor_msgs/Image")
        robot.publish("battery", 15.0 if number > 30 else 50.0)
        assert ring.used_bytes <= 4e6
    assert ring.dropped > 30
    robot.wait(30.0)  # STALE after 5 s
    (file,) = robot.files()
    assert len(recorded(file)["/camera/image"]) >= 6
    robot.close()


def test_a_message_that_does_not_fit_into_the_memory_is_named_and_costs_no_other(tmp_path: Path) -> None:
    """Half of memory_mb is for messages that wait."""
    robot = RecordedRobot(tmp_path, memory_mb=4.0, topics=("/map",))
    robot.feed(1.0, 50.0)
    robot.publish("/map", {"data": "x" * 3_000_000}, "std_msgs/String")
    robot.feed(1.0, 15.0)
    robot.wait(30.0)
    (file, *_) = robot.files()
    assert len(recorded(file)["/battery"]) >= 20
    wait_for(lambda: faults(robot))
    (fault,) = faults(robot)
    assert fault.startswith("black box memory: /map is not recorded: a message of 3")
    assert fault.endswith(" MB is too large for memory_mb 4")
    robot.close()


@pytest.mark.parametrize("delay_s", [0.0, 0.05, 0.3])
def test_after_a_kill_the_next_start_completes_the_file_or_removes_it(tmp_path: Path, delay_s: float) -> None:
    program = KILLED.format(folder=str(tmp_path))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"alert\n"
    threading.Event().wait(delay_s)
    process.kill()
    process.wait()
    process.stdout.close()
    robot = RecordedRobot(tmp_path)
    wait_for(lambda: not list(tmp_path.glob("*.part")))
    for file in robot.files():
        assert recorded(file)
    assert faults(robot) == []
    name = alert(robot)
    assert name in [file.name for file in robot.files()]
    robot.close()


def test_the_time_that_a_close_may_take_is_below_two_seconds() -> None:
    assert black_box._CLOSE_TIMEOUT_S + 0.2 < 2.0


def test_a_folder_that_vanishes_is_created_anew_for_the_next_alert(tmp_path: Path) -> None:
    box = tmp_path / "box"
    robot = RecordedRobot(box)
    name = alert(robot)
    assert [file.name for file in robot.files()] == [name]
    box.rename(tmp_path / "gone")  # at once: the thread may still be looking into it
    name = alert(robot)
    assert [file.name for file in robot.files()] == [name]
    assert faults(robot) == []
    robot.close()


def test_a_folder_that_is_replaced_by_a_link_to_that_of_another_monitor_is_left_alone(tmp_path: Path) -> None:
    other = RecordedRobot(tmp_path / "other", name="other")
    robot = RecordedRobot(tmp_path / "box", name="r1")
    alert(robot)
    robot.files()
    (tmp_path / "box").rename(tmp_path / "gone")
    (tmp_path / "box").symlink_to(tmp_path / "other")
    alert(robot)
    robot.files()
    assert list((tmp_path / "other").glob("*.mcap*")) == []
    assert faults(robot) == [f"black box: {tmp_path / 'box'}: another monitor writes into this folder"]
    for each in (robot, other):
        each.close()


def test_a_file_of_the_folder_that_is_removed_does_not_cost_the_recording_that_is_being_written(tmp_path: Path) -> None:
    """systemd-tmpfiles removes what is old; hidden files are a monitor's own or nobody's."""
    (tmp_path / ".lock").write_text("")
    robot = RecordedRobot(tmp_path)
    robot.feed(1.0, 50.0)
    robot.feed(1.0, 15.0)
    wait_for(lambda: list(tmp_path.glob("*.part")))
    for file in tmp_path.glob(".*"):
        file.unlink()
    robot.feed(15.0, 50.0)
    assert [file.name for file in robot.files()] == [robot.transitions[0].black_box]
    assert faults(robot) == []
    robot.close()


def test_an_old_recording_that_cannot_be_deleted_is_a_fault_and_others_are_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = RecordedRobot(tmp_path, keep_days=1.0)
    kept = alert(robot)
    (first,) = robot.files()
    os.utime(first, (1.6e9, 1.6e9))  # years ago
    unlink = os.unlink

    def refuse(path: Any) -> None:
        if path == str(first):
            raise OSError(errno.EPERM, "Operation not permitted", path)
        unlink(path)

    monkeypatch.setattr(os, "unlink", refuse)
    name = alert(robot)
    assert [file.name for file in robot.files()] == [kept, name]
    wait_for(lambda: faults(robot))
    assert faults(robot) == [f"black box folder: an old recording cannot be deleted: {first}: Operation not permitted"]
    robot.close()


@pytest.mark.newest_python
def test_the_names_that_are_kept_in_memory_are_bounded(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path)
    box = robot.operations.black_box
    assert box is not None
    names = {box.new_name("r1", "battery") for _ in range(1000)}
    assert len(names) == 1000
    robot.wait(1.0)
    assert box.new_name("r1", "battery") not in names
    assert len(box._names) == 1000
    robot.close()
