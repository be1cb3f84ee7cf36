"""Rows: transitions and evidence; unexpected values, which stop neither a reader nor the monitor."""

from __future__ import annotations

import math
import shutil
import sqlite3
from pathlib import Path
from typing import Any, Iterator, Sequence

import pytest
from harness.filled_history import fill_history, read_everything
from harness.histories import fault_texts, opened, texts, transition

from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.ops.store.rows import (
    CheckedConnection,
    pack_samples,
    select,
    skip,
    unpack_samples,
)


def packed_and_unpacked(samples: Sequence[tuple[float, Any]]) -> list[tuple[float, float]]:
    """Returns the samples as they are read again."""
    first_s, unpacked = unpack_samples(pack_samples(samples))
    assert first_s == unpacked[0][0]
    return unpacked


def test_samples_survive_packing() -> None:
    samples = [(1_700_000_000.25, 19.299999237060547), (1_700_000_001.25, -5.0), (1_700_000_061.75, 1e300)]
    assert packed_and_unpacked(samples) == samples


def test_no_samples_take_no_space() -> None:
    assert pack_samples([]) == b""
    assert unpack_samples(b"") == (math.inf, [])


def test_a_value_that_is_no_number_becomes_nan() -> None:
    [(_, text), (_, huge)] = packed_and_unpacked([(1.0, "fault"), (2.0, 10**400)])
    assert math.isnan(text) and math.isnan(huge)


def test_only_the_newest_300_samples_are_kept() -> None:
    assert [value for _, value in packed_and_unpacked([(float(n), n) for n in range(301)])] == list(range(1, 301))


def test_samples_that_an_earlier_transition_has_are_left_out() -> None:
    samples = [(10.0, 1.0), (11.0, 2.0), (12.0, 3.0)]
    assert unpack_samples(pack_samples(samples, 11.0)) == (10.0, [(12.0, 3.0)])
    assert unpack_samples(pack_samples(samples, 12.0)) == (10.0, [])
    assert len(pack_samples(samples, 12.0)) == 8


def test_all_samples_are_stored_after_the_wall_clock_was_set_back() -> None:
    assert packed_and_unpacked([(10.0, 1.0), (11.0, 2.0)]) == [(10.0, 1.0), (11.0, 2.0)]
    assert unpack_samples(pack_samples([(10.0, 1.0), (11.0, 2.0)], 500.0)) == (10.0, [(10.0, 1.0), (11.0, 2.0)])


@pytest.mark.parametrize("packed", [None, "text", 5, 2.5, b"odd", b"1" * 9])
def test_what_is_not_packed_samples_has_none(packed: Any) -> None:
    assert unpack_samples(packed) == (math.inf, [])


ODD = ("'text'", "9e999", "9223372036854775807", "x'ff00'", "CAST(x'ff' AS TEXT)")
"""SQL values."""
_WITHOUT_ROWID = ("configurations",)


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a history with rows in every table."""
    path = tmp_path_factory.mktemp("filled") / "history.db"
    fill_history(path)
    return path


@pytest.fixture
def file(filled: Path, tmp_path: Path) -> Path:
    """Returns a history with rows in every table, for one test."""
    return Path(shutil.copy(filled, tmp_path))


def columns() -> Iterator[tuple[str, str]]:
    """Yields every column of every table."""
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    for table in schema.tables(connection):
        for row in connection.execute(f"PRAGMA table_info({table})"):
            yield table, row[1]


@pytest.mark.newest_python
@pytest.mark.parametrize(("table", "column"), list(columns()), ids=lambda name: str(name))
def test_an_odd_value_anywhere_stops_no_reader_and_no_monitor(file: Path, table: str, column: str) -> None:
    for odd in ODD:
        connection = sqlite3.connect(str(file), isolation_level=None)
        connection.execute("BEGIN")
        where = "1" if table in _WITHOUT_ROWID else f"rowid = (SELECT min(rowid) FROM {table})"
        try:
            connection.execute(f"UPDATE {table} SET {column} = {odd} WHERE {where}")
        except sqlite3.Error:  # the key is an integer
            connection.execute("ROLLBACK")
            continue
        finally:
            if connection.in_transaction:
                connection.execute("COMMIT")
            connection.close()
        with reading(file) as connection:
            assert len(read_everything(connection)) >= 4
        faults = Faults()
        history = opened(file, faults, keep_days=30_000.0)
        robot = history.of_robot("r9")
        silences = Silences(history)
        robot.restore()
        robot.watched_until_s()
        robot.record(transition(77, robot="r9"), {"level": 1}, [])
        assert "battery_level WARN: number 77" in texts(history)
        silences.silence_of("r9", "battery_level")
        history.close(60.0)
        assert not [text for part, text in fault_texts(faults) if part not in ("history rows", "silence list")]


def database() -> CheckedConnection:
    return CheckedConnection(":memory:")


def test_the_first_row_that_is_skipped_is_noted_in_one_line() -> None:
    connection = database()
    assert connection.skipped_text == ""
    query = "SELECT column1 AS id, column2 AS wall_s FROM (VALUES (1, 1.0), (2, 'x'), (3, 9e999), (4, 4.0), (5, 1e12))"
    for _ in range(2):
        assert select(connection, "resets", (int, float), query) == [(1, 1.0), (4, 4.0)]
        assert connection.skipped_text == "a row has unexpected values and is skipped (resets 2)"


def test_the_note_of_a_row_is_bounded() -> None:
    connection = database()
    skip(connection, "resets", "x" * 5000)
    assert len(connection.skipped_text) < 150


def test_text_that_is_not_utf_8_is_read() -> None:
    assert database().execute("SELECT CAST(x'41ff' AS TEXT)").fetchone() == ("A\ufffd",)
