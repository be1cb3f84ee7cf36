"""rosbag2's SQLite files, written by rosbags, of every schema, and cut off anywhere."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from harness.recorded import nanoseconds, read, values, write_folder
from harness.seeds import every

from robot_health_monitor.recordings.recording import RecordingError
from robot_health_monitor.recordings.sqlite_file import SqliteFile

MESSAGES = sorted([*values("/battery_level", range(300)), *values("/temperature", range(300), start_s=0.25)])


def database(folder: Path) -> Path:
    """Writes a recording and returns its file."""
    (found,) = Path(write_folder(folder, MESSAGES)).glob("*.db3")
    return found


def test_all_messages_are_read(tmp_path: Path) -> None:
    found = read(str(database(tmp_path / "bag")))
    assert found.messages == MESSAGES
    assert found.problems == []


def test_the_schema_before_definitions_is_read_with_the_standard_types(tmp_path: Path) -> None:
    path = database(tmp_path / "bag")
    connection = sqlite3.connect(path)
    connection.executescript(
        "DROP TABLE IF EXISTS message_definitions; DROP TABLE IF EXISTS schema; DROP TABLE IF EXISTS metadata;"
        "CREATE TABLE t(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
        "INSERT INTO t SELECT id, name, type, serialization_format FROM topics;"
        "DROP TABLE topics; ALTER TABLE t RENAME TO topics;"
    )
    connection.close()
    assert read(str(path)).messages == MESSAGES


def test_messages_of_another_serialization_are_left_out(tmp_path: Path) -> None:
    path = database(tmp_path / "bag")
    connection = sqlite3.connect(path)
    connection.execute("UPDATE topics SET serialization_format = 'protobuf' WHERE name = '/temperature'")
    connection.commit()
    connection.close()
    assert {message.topic for message in read(str(path)).messages} == {"/battery_level"}


def test_the_journal_of_a_recorder_that_was_killed_is_applied(tmp_path: Path) -> None:
    path = database(tmp_path / "bag")
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("DELETE FROM messages WHERE id > 10")
    connection.commit()
    copy = tmp_path / "copy.db3"
    for ending in ("", "-wal"):
        Path(f"{copy}{ending}").write_bytes(Path(f"{path}{ending}").read_bytes())
    connection.close()
    assert len(read(str(copy)).messages) == 10


@pytest.mark.newest_python
def test_a_file_that_is_cut_off_anywhere_is_read_as_far_as_possible(tmp_path: Path) -> None:
    """At many places of a page, because SQLite fills a page that is cut off with zeros."""
    data = database(tmp_path / "bag").read_bytes()
    cut = tmp_path / "cut.db3"
    most = 0
    for size in [*range(0, len(data), 1997 * every(2)), *range(len(data) - 4300, len(data), 61 * every(2))]:
        cut.write_bytes(data[:size])
        line = f"{cut}: ends at byte {size} of {len(data)}: read as far as possible"
        try:
            found = read(str(cut))
        except RecordingError as error:
            assert str(error) in (f"{line}, but nothing can be read", f"{cut}: expected an SQLite file")  # noqa: PT017
            continue
        assert set(found.messages) <= set(MESSAGES), size
        assert found.messages == sorted(found.messages), size
        assert found.problems == [line]
        if found.messages:
            times = [nanoseconds(message.time_s) for message in found.messages]
            assert SqliteFile(str(cut)).span_ns == (times[0], times[-1]), size
        most = max(most, len(found.messages))
    assert most > len(MESSAGES) // 2


def test_half_of_a_long_file_is_read(tmp_path: Path) -> None:
    messages = values("/x", range(1, 2001))
    (path,) = Path(write_folder(tmp_path / "bag", messages)).glob("*.db3")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    found = read(str(path))
    assert 500 < len(found.messages) < 1100
    assert found.messages == messages[: len(found.messages)]


@pytest.mark.parametrize("content", [b"", b"SQLite format 2\0", b"SQLite format 3\0" + bytes(5000)])
def test_another_file_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.db3"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as raised:
        SqliteFile(str(path))
    assert str(raised.value).startswith(f"{path}: ")


def test_another_database_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE songs(title)")
    connection.commit()
    connection.close()
    with pytest.raises(RecordingError, match="cannot be read as a recording of rosbag2: no such table"):
        SqliteFile(str(path))


def test_rows_without_a_time_or_data_are_left_out_with_a_message(tmp_path: Path) -> None:
    path = database(tmp_path / "bag")
    connection = sqlite3.connect(path)
    connection.execute("UPDATE messages SET data = 'text' WHERE id = 5")
    connection.commit()
    connection.close()
    found = read(str(path))
    assert len(found.messages) == len(MESSAGES) - 1
    assert found.problems == [f"{path}: a row without a time or data is left out"]


def test_a_file_is_never_written(tmp_path: Path) -> None:
    path = database(tmp_path / "bag")
    before = path.read_bytes(), sorted(path.parent.iterdir())
    read(str(path))
    assert (path.read_bytes(), sorted(path.parent.iterdir())) == before
