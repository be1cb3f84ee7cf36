"""The folder of a black box: which files are its own, their limits, one monitor at a time."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")

from mcap.writer import Writer

from robot_health_monitor.ops.black_box import recording_file
from robot_health_monitor.ops.black_box.folder import Folder, find_file
from robot_health_monitor.ops.configuration import BlackBoxSettings

NOW_S = 1.7e9
DAY_S = 86_400.0
BEGIN = "r1_20261123T014559.123Z_"


def folder_of(path: Path, keep_mb: float = 1000.0, keep_days: float = 30.0, now_s: float = NOW_S) -> Folder:
    return Folder(BlackBoxSettings(str(path), keep_mb=keep_mb, keep_days=keep_days), lambda: now_s)


def put(file: Path, size: int = 1000, age_s: float = 0.0, library: str = "robot-health 0.1.0") -> None:
    """Writes a file that begins as an MCAP file of a program does."""
    with file.open("wb") as stream:
        Writer(stream).start("ros1", library)
        stream.write(bytes(size - stream.tell()))
    os.utime(file, (NOW_S - age_s, NOW_S - age_s))


def recording(path: Path, signal: str, size: int = 1000, age_s: float = 0.0) -> str:
    """Puts a recording there; returns its name."""
    put(path / f"{BEGIN}{signal}.mcap", size, age_s)
    return f"{BEGIN}{signal}.mcap"


def names(path: Path) -> list[str]:
    """Returns the names of the files, of recordings only their signal."""
    return sorted(name.replace(BEGIN, "").replace(".mcap", "") for name in os.listdir(path))


def test_the_folder_is_created_and_used_by_one_monitor(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b"
    folder = folder_of(path)
    with pytest.raises(BlockingIOError, match=f"another monitor writes into this folder: '{path}'"):
        folder_of(path)
    folder.close()
    folder_of(path).close()


def test_the_oldest_files_go_first_but_never_that_of_an_open_alert(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, keep_mb=1.0)
    first, _, _, last = (recording(tmp_path, str(number), 400_000, 100.0 - number) for number in range(4))
    assert folder.make_room({first})
    assert names(tmp_path) == ["0", "3"]
    assert not folder.make_room({first, last}, 300_000)
    assert folder.make_room({first}, 300_000)
    assert names(tmp_path) == ["0"]
    folder.close()


def test_files_that_are_too_old_are_deleted(tmp_path: Path) -> None:
    recording(tmp_path, "old", 1000, 2.1 * DAY_S)
    is_open = recording(tmp_path, "open", 1000, 2.1 * DAY_S)
    recording(tmp_path, "new", 1000, 1.9 * DAY_S)
    recording(tmp_path, "newest")
    folder = folder_of(tmp_path, keep_days=2.0)
    folder.make_room({is_open})
    assert names(tmp_path) == ["new", "newest", "open"]
    folder.close()


def test_files_that_no_black_box_has_written_are_left_alone_and_do_not_count(tmp_path: Path) -> None:
    """By name and content: a bag of the user, another program's file under our name, what is downloaded, a folder."""
    put(tmp_path / "drive.mcap", 2_000_000, 99 * DAY_S, "rosbag2")
    put(tmp_path / "drive.mcap.part", 1000, 99 * DAY_S, "rosbag2")
    put(tmp_path / "ours.mcap", 2_000_000, 99 * DAY_S)
    put(tmp_path / f"{BEGIN}theirs.mcap", 2_000_000, 99 * DAY_S, "rosbag2")
    put(tmp_path / f"{BEGIN}theirs.mcap.part", 1000, 99 * DAY_S, "rosbag2")
    (tmp_path / f"{BEGIN}text.mcap").write_text("robot-health")
    (tmp_path / "movie.part").write_bytes(b"")
    (tmp_path / f"{BEGIN}folder.mcap").mkdir()
    (tmp_path / f"{BEGIN}link.mcap").symlink_to(tmp_path / "ours.mcap")
    os.mkfifo(tmp_path / f"{BEGIN}pipe.mcap.part")
    before = sorted(os.listdir(tmp_path))
    new, _ = recording(tmp_path, "new", 500_000), recording(tmp_path, "old", 600_000, 10.0)
    folder = folder_of(tmp_path, keep_mb=1.0, keep_days=2.0)
    assert list(folder.complete_files()) == []
    assert folder.make_room((), 400_000)
    assert sorted(os.listdir(tmp_path)) == sorted([*before, new])
    folder.close()


@pytest.mark.parametrize("starts_ahead", [False, True])
def test_a_wall_clock_that_is_ahead_deletes_nothing(tmp_path: Path, starts_ahead: bool) -> None:
    now = [NOW_S + 60 * DAY_S if starts_ahead else NOW_S]
    recording(tmp_path, "a")
    folder = Folder(BlackBoxSettings(str(tmp_path)), lambda: now[0])
    now[0] = NOW_S + 60 * DAY_S
    assert folder.make_room(())
    assert names(tmp_path) == ["a"]
    folder.close()


def test_a_file_that_cannot_be_deleted_does_not_keep_others_from_making_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one that an administrator has made immutable."""
    old = str(tmp_path / recording(tmp_path, "kept", 400_000, 100.0))
    recording(tmp_path, "middle", 400_000, 50.0)
    recording(tmp_path, "new", 400_000)
    folder = folder_of(tmp_path, keep_mb=1.0)
    unlink = os.unlink

    def refuse(path: Any) -> None:
        if path == old:
            raise OSError(errno.EPERM, "Operation not permitted", path)
        unlink(path)

    monkeypatch.setattr(os, "unlink", refuse)
    assert folder.make_room(())
    assert names(tmp_path) == ["kept", "new"]
    assert folder.problem is not None and folder.problem.filename == old
    monkeypatch.undo()
    assert folder.make_room((), 400_000)
    assert (names(tmp_path), folder.problem) == (["new"], None)
    folder.close()


def test_what_a_killed_process_left_is_removed_if_nothing_can_be_read(tmp_path: Path) -> None:
    for name in ("a.mcap.part", "b.mcap.part"):
        (tmp_path / f"{BEGIN}{name}").write_bytes(b"")
    folder = folder_of(tmp_path)
    assert list(folder.complete_files()) == []
    assert names(tmp_path) == []
    folder.close()


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".mcap",
        f"../{BEGIN}a.mcap",
        f"a/{BEGIN}a.mcap",
        f"{BEGIN}../a.mcap",
        f"{BEGIN}a..mcap",
        f"{BEGIN}a.mcap.part",
        f"{BEGIN}a\0.mcap",
        f"{BEGIN}ä.mcap",
        f"{BEGIN}a.mcap\n",
        f'{BEGIN}a"\r\nSet-Cookie: a=b.mcap',
        f"{BEGIN}%2e%2e%2fa.mcap",
        f"{BEGIN}{'a' * 300}.mcap",
        f".{BEGIN}a.mcap",
        f"C:\\{BEGIN}a.mcap",
    ],
)
def test_other_names_are_no_names_of_files_and_lead_nowhere(tmp_path: Path, name: str) -> None:
    (tmp_path / "box").mkdir()
    for file in (tmp_path / "a.mcap", tmp_path / "box" / "a.mcap", tmp_path / f"{BEGIN}a.mcap"):
        put(file)
    assert find_file(str(tmp_path / "box"), name) is None


def test_a_usual_name_is_a_name(tmp_path: Path) -> None:
    name = recording(tmp_path, "battery_level")
    assert find_file(str(tmp_path), name) == str(tmp_path / name)


def test_a_file_that_cannot_be_completed_is_named_and_the_others_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full for the first one."""
    for name in ("a.mcap.part", "b.mcap.part"):
        (tmp_path / f"{BEGIN}{name}").write_bytes(b"")
    folder = folder_of(tmp_path)
    complete = recording_file.complete

    def fail(path: str) -> bool:
        if path.endswith("a.mcap"):
            raise OSError(errno.ENOSPC, "No space left on device", path)
        return complete(path)

    monkeypatch.setattr(recording_file, "complete", fail)
    assert [error.filename for error in folder.complete_files()] == [str(tmp_path / f"{BEGIN}a.mcap")]
    assert os.listdir(tmp_path) == [f"{BEGIN}a.mcap.part"]
    folder.close()


def test_a_folder_is_there_until_it_is_removed_or_replaced(tmp_path: Path) -> None:
    box = tmp_path / "box"
    folder = folder_of(box)
    assert folder.is_there()
    box.rename(tmp_path / "moved")
    assert not folder.is_there()
    other = folder_of(box)
    assert (folder.is_there(), other.is_there()) == (False, True)
    for each in (folder, other):
        each.close()
