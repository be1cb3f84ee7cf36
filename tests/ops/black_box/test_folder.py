"""The folder of a black box: its names, its limits, one monitor at a time."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import List

import pytest

pytest.importorskip("mcap")

from robot_health_monitor.ops.black_box import recording_file
from robot_health_monitor.ops.black_box.folder import Folder, FolderInUseError, is_file_name
from robot_health_monitor.ops.configuration import BlackBoxSettings

NOW_S = 1.7e9
DAY_S = 86_400.0


def folder_of(path: Path, keep_mb: float = 1000.0, keep_days: float = 30.0, now_s: float = NOW_S) -> Folder:
    return Folder(BlackBoxSettings(str(path), keep_mb=keep_mb, keep_days=keep_days), lambda: now_s)


def put(path: Path, name: str, size: int, age_s: float) -> None:
    (path / name).write_bytes(bytes(size))
    os.utime(path / name, (NOW_S - age_s, NOW_S - age_s))


def names(path: Path) -> List[str]:
    return sorted(name for name in os.listdir(path) if not name.startswith("."))


def test_the_folder_is_created_and_used_by_one_monitor(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b"
    folder = folder_of(path)
    with pytest.raises(FolderInUseError, match="b: another monitor writes into this folder"):
        folder_of(path)
    folder.close()
    folder_of(path).close()


def test_the_oldest_files_go_first_but_never_that_of_an_open_alert(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, keep_mb=1.0)
    for number in range(4):
        put(tmp_path, f"{number}.mcap", 400_000, 100.0 - number)
    assert folder.make_room({"0.mcap"})
    assert names(tmp_path) == ["0.mcap", "3.mcap"]
    assert not folder.make_room({"0.mcap", "3.mcap"}, 300_000)
    assert folder.make_room({"0.mcap"}, 300_000)
    assert names(tmp_path) == ["0.mcap"]
    folder.close()


def test_files_that_are_too_old_are_deleted(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, keep_days=2.0)
    put(tmp_path, "old.mcap", 10, 2.1 * DAY_S)
    put(tmp_path, "open.mcap", 10, 2.1 * DAY_S)
    put(tmp_path, "new.mcap", 10, 1.9 * DAY_S)
    put(tmp_path, "notes.txt", 10, 99 * DAY_S)
    folder.make_room({"open.mcap"})
    assert names(tmp_path) == ["new.mcap", "notes.txt", "open.mcap"]
    folder.close()


def test_a_wall_clock_that_jumps_ahead_deletes_nothing(tmp_path: Path) -> None:
    now = [NOW_S]
    folder = Folder(BlackBoxSettings(str(tmp_path)), lambda: now[0])
    put(tmp_path, "a.mcap", 10, 10.0)
    now[0] += 10_000 * DAY_S
    folder.make_room(())
    assert names(tmp_path) == ["a.mcap"]
    folder.close()


def test_what_a_killed_process_left_is_removed_if_nothing_can_be_read(tmp_path: Path) -> None:
    for name in ("a.mcap.part", "a.mcap.completed.part", "b.mcap.part"):
        (tmp_path / name).write_bytes(b"")
    folder = folder_of(tmp_path)
    assert folder.complete_files() == []
    assert names(tmp_path) == []
    folder.close()


@pytest.mark.parametrize(
    "name",
    ["", "a", ".mcap", "../a.mcap", "a/b.mcap", ".lock", "a..mcap", "a.mcap.part", "a\0.mcap", "ä.mcap", "a.mcap\n"],
)
def test_other_names_are_no_names_of_files(name: str) -> None:
    assert not is_file_name(name)


def test_a_usual_name_is_a_name() -> None:
    assert is_file_name("husky1_20261123T014559.123Z_battery_level.mcap")


def test_a_file_that_cannot_be_completed_is_named_and_the_others_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full for the first one."""
    for name in ("a.mcap.part", "b.mcap.part"):
        (tmp_path / name).write_bytes(b"")
    folder = folder_of(tmp_path)
    complete = recording_file.complete

    def fail(path: str) -> bool:
        if path.endswith("a.mcap"):
            raise OSError(errno.ENOSPC, "No space left on device", path)
        return complete(path)

    monkeypatch.setattr(recording_file, "complete", fail)
    assert [error.filename for error in folder.complete_files()] == [str(tmp_path / "a.mcap")]
    assert names(tmp_path) == ["a.mcap.part"]
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
