"""Stored samples: joined, merged after two days, deleted, read."""

from __future__ import annotations

import random
import sqlite3
from typing import Dict, List, Optional, Tuple

import pytest

from robot_health_monitor.core.model import Level
from robot_health_monitor.ops.history import schema
from robot_health_monitor.ops.history.rows import CheckedConnection
from robot_health_monitor.ops.history.samples import SampleUpkeep, StoredSamples, read, store

OK, WARN, ERROR, STALE = Level
DAY_S = 86_400.0


@pytest.fixture
def connection() -> sqlite3.Connection:
    connection = sqlite3.connect(":memory:", isolation_level=None, factory=CheckedConnection)
    schema.prepare(connection)
    return connection


def part(
    start_s: float,
    value: Optional[float] = 1.0,
    *,
    good: int = 1,
    bad: int = 0,
    level: Level = OK,
    robot: str = "r1",
    signal: str = "a",
) -> StoredSamples:
    """Returns samples of one value."""
    return StoredSamples(robot, signal, start_s, 10.0, value, value, value, value, good, bad, level)


def merge(connection: sqlite3.Connection, before_s: float, fine_before_s: float) -> None:
    """Does all that is due."""
    upkeep = SampleUpkeep(connection)
    steps = 0
    while upkeep.merge_old(before_s, fine_before_s):
        steps += 1
        assert steps < 10_000


def test_parts_of_a_period_are_joined(connection: sqlite3.Connection) -> None:
    store(connection, [part(20.0, 4.0, good=3, level=ERROR), part(20.0, None, good=0, bad=2, level=STALE)])
    store(connection, [part(20.0, 8.0, good=1, level=WARN)])
    assert list(read(connection)) == [StoredSamples("r1", "a", 20.0, 10.0, 4.0, 8.0, 5.0, 8.0, 4, 2, ERROR)]


def test_values_that_were_never_defined_stay_none(connection: sqlite3.Connection) -> None:
    store(connection, [part(20.0, None, level=STALE), part(20.0, None, level=OK)])
    (found,) = read(connection)
    assert (found.least, found.most, found.mean, found.last, found.level) == (None, None, None, None, STALE)


def test_samples_are_read_by_robot_signal_and_time(connection: sqlite3.Connection) -> None:
    for robot, signal in (("r1", "a"), ("r1", "b"), ("r2", "a[1]")):
        store(connection, [part(start_s, robot=robot, signal=signal) for start_s in (10.0, 20.0, 30.0)])

    def found(**options: object) -> List[Tuple[str, str, float]]:
        return [each[:3] for each in read(connection, **options)]  # type: ignore[arg-type]

    assert found(robot="r1", signal="b") == [("r1", "b", start_s) for start_s in (10.0, 20.0, 30.0)]
    assert found(signal="a*", since_s=25.0, until_s=30.0) == [("r1", "a", 20.0), ("r2", "a[1]", 20.0)]
    assert found(robot="r?", since_s=40.0) == []
    assert found(robot="r9", signal="a") == []


def test_more_than_a_page_is_read(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number) for number in range(4_500)])
    assert [each.start_s for each in read(connection)] == [10.0 * number for number in range(4_500)]


def test_old_periods_are_merged_into_five_minutes_and_keep_their_extremes(connection: sqlite3.Connection) -> None:
    """The expected values are computed from the raw values, hour by hour."""
    seeded = random.Random(22)
    raw: Dict[float, List[float]] = {}
    for number in range(1_000):
        values = [seeded.gauss(50.0, 10.0) for _ in range(seeded.randrange(1, 4))]
        raw[10.0 * number] = values
        for value in values:
            store(connection, [part(10.0 * number, value)])
    merge(connection, -1.0, 9_000.0)
    found = list(read(connection))
    assert [(each.start_s, each.seconds) for each in found] == [
        *((300.0 * number, 300.0) for number in range(30)),
        *((10.0 * number, 10.0) for number in range(900, 1_000)),
    ]
    for each in found:
        values = [v for start_s, vs in raw.items() if each.start_s <= start_s < each.start_s + each.seconds for v in vs]
        assert (each.least, each.most, each.last, each.good) == (min(values), max(values), values[-1], len(values))
        assert each.mean == pytest.approx(sum(values) / len(values))


def test_merging_again_changes_nothing_and_late_parts_are_joined(connection: sqlite3.Connection) -> None:
    store(connection, [part(0.0, 1.0), part(10.0, 3.0)])
    merge(connection, -1.0, 300.0)
    store(connection, [part(20.0, 9.0)])  # the wall clock was set back
    merge(connection, -1.0, 300.0)
    merge(connection, -1.0, 300.0)
    (found,) = read(connection)
    assert (found.seconds, found.least, found.most, found.good) == (300.0, 1.0, 9.0, 3)


def test_what_is_too_old_is_deleted(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number, signal=signal) for number in range(1_000) for signal in "ab"])
    merge(connection, 8_000.0, 0.0)
    assert [each.start_s for each in read(connection, signal="b")] == [10.0 * number for number in range(800, 1_000)]


def test_each_step_is_short(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number, signal=f"s{signal}") for number in range(400) for signal in range(5)])
    upkeep = SampleUpkeep(connection)
    before = connection.total_changes
    assert upkeep.merge_old(-1.0, 4_000.0)
    assert connection.total_changes - before < 700


def test_the_oldest_go_first_when_space_is_short(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number, signal="old") for number in range(360)])
    store(connection, [part(7_200.0 + 10.0 * number, signal="new") for number in range(360)])
    upkeep = SampleUpkeep(connection)
    signals = []
    while upkeep.delete_oldest():
        signals.append(sorted({each.signal for each in read(connection)}))
    assert signals.index(["new"]) < signals.index([])
    assert not upkeep.delete_oldest()


def test_odd_rows_are_skipped_and_noted(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number) for number in range(2_100)])
    for number, (column, value) in enumerate([("least", "'x'"), ("level", "7"), ("good", "NULL"), ("mean", "9e999")]):
        if value != "NULL":
            connection.execute(f"UPDATE samples SET {column} = {value} WHERE start_s = {10.0 * number}")
    connection.execute("INSERT INTO samples VALUES (x'00', 1, 'x', 10.0, 1, 1, 1, 1, 1, 0, 0)")
    assert len(list(read(connection))) == 2_097
    assert isinstance(connection, CheckedConnection)
    assert len(connection.skipped) >= 1
    store(connection, [part(0.0, 5.0)])
    assert next(read(connection)).most == 5.0
    merge(connection, -1.0, 30_000.0)
    assert all(each.seconds == 300.0 for each in read(connection))
