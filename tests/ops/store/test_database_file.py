"""The lock, the log, the name and the errors of a history file."""

from __future__ import annotations

import os
import resource
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from harness.waiting import WAIT_S, wait_for

from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.database_file import (
    DatabaseFile,
    is_damage,
    is_file_error,
    lock_path,
    reading,
    set_aside,
)


def test_the_lock_of_a_killed_process_is_released(tmp_path: Path) -> None:
    file = str(tmp_path / "history.db")
    code = (
        "import sys, time\n"
        "from robot_health_monitor.ops.store.database_file import DatabaseFile\n"
        "held = DatabaseFile(sys.argv[1])\n"
        "print('open', flush=True)\n"
        "time.sleep(600)\n"
    )
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-c", code, file], stdout=subprocess.PIPE, env=variables) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"open\n"
        with pytest.raises(schema.UnusableFileError, match="in use by another monitor"):
            DatabaseFile(file)
        holder.kill()
        holder.wait()
    DatabaseFile(file).close()


def test_a_file_can_be_opened_again_after_it_was_closed(tmp_path: Path) -> None:
    file = DatabaseFile(str(tmp_path / "history.db"))
    file.close()
    file.close()
    DatabaseFile(str(tmp_path / "history.db")).close()


def test_the_lock_is_released_if_sqlite_cannot_open_the_file(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    lowest = os.open(os.devnull, os.O_RDONLY)
    os.close(lowest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest + 1, limits[1]))  # enough for the lock alone
    try:
        with pytest.raises(sqlite3.OperationalError, match="unable to open database file"):
            DatabaseFile(str(tmp_path / "history.db"))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    DatabaseFile(str(tmp_path / "history.db")).close()


def test_a_commit_survives_a_copy_of_what_the_kernel_has(tmp_path: Path) -> None:
    file = DatabaseFile(str(tmp_path / "history.db"))
    file.connection.execute("INSERT INTO resets (wall_s, robot) VALUES (1.0, 'r1')")
    for suffix in ("", "-wal"):
        (tmp_path / f"copy.db{suffix}").write_bytes((tmp_path / f"history.db{suffix}").read_bytes())
    copy = sqlite3.connect(tmp_path / "copy.db")
    assert copy.execute("SELECT robot FROM resets").fetchall() == [("r1",)]
    copy.close()
    file.close()


def test_the_log_is_copied_into_the_file_when_it_has_grown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.store.database_file.SYNC_PERIOD_S", 0.01)
    path = tmp_path / "history.db"
    file = DatabaseFile(str(path), 100_000)
    add = "INSERT INTO configurations VALUES (?, ?)"
    file.connection.executemany(add, [(str(number), "x" * 4000) for number in range(100)])
    wait_for(lambda: path.stat().st_size > 300_000 and (tmp_path / "history.db-wal").stat().st_size < 100_000)
    assert file.problem == ""
    file.close()


def test_the_log_begins_anew_although_the_writer_never_pauses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.store.database_file.SYNC_PERIOD_S", 0.01)
    log = tmp_path / "history.db-wal"
    file = DatabaseFile(str(tmp_path / "history.db"), 100_000)
    size = anew = 0
    deadline_s = time.monotonic() + WAIT_S
    while anew < 5:
        assert time.monotonic() < deadline_s
        file.connection.execute("INSERT INTO resets (wall_s, robot) VALUES (1.0, 'r1')")
        before, size = size, log.stat().st_size
        anew += size < before
    assert file.problem == ""
    file.close()


def test_a_reader_keeps_the_log_from_being_emptied_until_it_ends(tmp_path: Path) -> None:
    log = tmp_path / "history.db-wal"
    file = DatabaseFile(str(tmp_path / "history.db"))
    file.connection.execute("INSERT INTO resets (wall_s, robot) VALUES (1.0, 'r1')")
    reader = sqlite3.connect(str(tmp_path / "history.db"), isolation_level=None)
    reader.execute("BEGIN")
    assert reader.execute("SELECT robot FROM resets").fetchall() == [("r1",)]
    file.connection.execute("INSERT INTO resets (wall_s, robot) VALUES (2.0, 'r1')")
    file.copy_log()
    assert log.stat().st_size > 0
    reader.execute("COMMIT")
    file.copy_log()
    assert log.stat().st_size == 0
    assert reader.execute("SELECT count(*) FROM resets").fetchall() == [(2,)]
    reader.close()
    file.close()


def test_a_replaced_file_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    file = DatabaseFile(str(path))
    assert file.is_in_place()
    path.rename(tmp_path / "moved.db")
    assert not file.is_in_place()
    path.write_bytes(b"")
    assert not file.is_in_place()
    file.close()


def test_damaged_files_are_renamed_with_their_logs_and_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    names = []
    for content in (b"one", b"two"):
        path.write_bytes(content)
        (tmp_path / "history.db-wal").write_bytes(content + b" log")
        names.append(set_aside(str(path), 1_000_000_000.0))
    assert names == [f"{path}.damaged-20010909T014640Z", f"{path}.damaged-20010909T014640Z-2"]
    assert [Path(name).read_bytes() for name in names] == [b"one", b"two"]
    assert [Path(f"{name}-wal").read_bytes() for name in names] == [b"one log", b"two log"]
    assert not path.exists()


def test_a_named_pipe_is_refused_and_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="not a regular file"):
        DatabaseFile(str(tmp_path / "pipe"))


def test_the_lock_of_a_symbolic_link_is_that_of_its_target(tmp_path: Path) -> None:
    (tmp_path / "link.db").symlink_to(tmp_path / "history.db")
    file = DatabaseFile(str(tmp_path / "link.db"))
    assert Path(lock_path(str(tmp_path / "history.db"))).exists()
    file.close()


def test_a_text_file_is_left_alone_although_a_lock_is_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("äöü " * 5000, encoding="utf-8")
    Path(lock_path(str(path))).touch()
    with pytest.raises(schema.UnusableFileError):
        DatabaseFile(str(path))


def test_a_symbolic_link_that_leads_elsewhere_is_noticed(tmp_path: Path) -> None:
    link = tmp_path / "link.db"
    link.symlink_to(tmp_path / "history.db")
    file = DatabaseFile(str(link))
    assert file.is_in_place()
    link.unlink()
    assert not file.is_in_place()
    link.symlink_to(tmp_path / "other.db")
    assert not file.is_in_place()
    file.close()


def error_of(connection: sqlite3.Connection, statement: str) -> sqlite3.Error:
    """Returns the error of a statement."""
    with pytest.raises(sqlite3.Error) as caught:
        connection.execute(statement).fetchall()
    return caught.value


def test_garbage_is_damage(tmp_path: Path) -> None:
    file = tmp_path / "file.db"
    file.write_bytes(b"garbage " * 1000)
    error = error_of(sqlite3.connect(file), "SELECT * FROM sqlite_master")
    assert is_damage(error) and is_file_error(error)


def test_overwritten_pages_are_damage(tmp_path: Path) -> None:
    file = tmp_path / "file.db"
    connection = sqlite3.connect(file)
    connection.execute("CREATE TABLE samples (x)")
    connection.executemany("INSERT INTO samples VALUES (?)", [("x" * 1000,)] * 100)
    connection.commit()
    connection.close()
    with file.open("r+b") as damaged:
        damaged.seek(4096)
        damaged.write(b"\xa5" * 4096)
    error = error_of(sqlite3.connect(file), "SELECT * FROM samples")
    assert is_damage(error) and is_file_error(error)


def test_a_full_disk_is_an_error_of_the_file_but_no_damage() -> None:
    connection = sqlite3.connect(":memory:")
    connection.execute("PRAGMA max_page_count = 1")
    error = error_of(connection, "CREATE TABLE samples (x)")
    assert is_file_error(error) and not is_damage(error)


def test_a_read_only_file_is_an_error_of_the_file(tmp_path: Path) -> None:
    sqlite3.connect(tmp_path / "file.db").execute("CREATE TABLE samples (x)")
    connection = sqlite3.connect(f"file:{tmp_path}/file.db?mode=ro", uri=True)
    error = error_of(connection, "INSERT INTO samples VALUES (1)")
    assert is_file_error(error) and not is_damage(error)


def test_a_locked_file_is_an_error_of_the_file(tmp_path: Path) -> None:
    holder = sqlite3.connect(tmp_path / "file.db", isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    error = error_of(sqlite3.connect(tmp_path / "file.db", timeout=0.0, isolation_level=None), "BEGIN IMMEDIATE")
    assert is_file_error(error) and not is_damage(error)


def test_a_folder_that_does_not_exist_is_an_error_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(sqlite3.Error) as caught:
        sqlite3.connect(tmp_path / "none" / "file.db")
    assert is_file_error(caught.value) and not is_damage(caught.value)


def test_a_mistake_in_a_statement_is_no_error_of_the_file() -> None:
    assert not is_file_error(error_of(sqlite3.connect(":memory:"), "SELECT * FROM missing"))


def test_a_missing_file_is_one_line_and_is_not_created(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.db: No such file or directory"), reading(tmp_path / "none.db"):
        pass
    assert not (tmp_path / "none.db").exists()
