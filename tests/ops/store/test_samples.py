"""Stored samples: joined, merged after two days, deleted, read."""

from __future__ import annotations

import random
import sqlite3

import pytest

from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.rows import CheckedConnection
from robot_health_monitor.ops.store.samples import SampleUpkeep, StoredSamples, read, read_coarse, read_levels, store

OK, WARN, ERROR, STALE = Level
DAY_S = 86_400.0


@pytest.fixture
def connection() -> sqlite3.Connection:
    connection = CheckedConnection(":memory:")
    schema.prepare(connection)
    return connection


def part(
    start_s: float,
    value: float | None = 1.0,
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
    while upkeep.merge_old(before_s, fine_before_s + 2.0 * DAY_S):
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

    def found(**options: object) -> list[tuple[str, str, float]]:
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
    raw: dict[float, list[float]] = {}
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
    store(connection, [part(10.0 * number, signal=f"s{signal}") for number in range(400) for signal in range(15)])
    upkeep = SampleUpkeep(connection)
    before = connection.total_changes
    assert upkeep.merge_old(-1.0, 4_000.0 + 2.0 * DAY_S)
    assert connection.total_changes - before < 1_500
    steps = []
    upkeep = SampleUpkeep(connection)
    while upkeep.make_room(4_000.0):
        steps.append(connection.total_changes - before - sum(steps))
    assert max(steps) < 6_000


@pytest.mark.newest_python
def test_when_space_is_short_periods_are_merged_earlier_and_then_the_oldest_go(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number, number % 7, signal=signal) for number in range(9_000) for signal in "ab"])
    upkeep, fine, oldest = SampleUpkeep(connection), [], []
    while upkeep.make_room(90_000.0):
        stored = list(read(connection, signal="b"))
        fine.append(sum(each.seconds == 10.0 for each in stored))
        if stored:
            oldest.append(stored[0].start_s)
    ages_h = (24.0, 12.0, 6.0, 3.0, 1.5, 1.0)
    assert {hours * 360 for hours in ages_h} <= set(fine)
    assert oldest == sorted(oldest)
    assert all(start_s == 0.0 for start_s, count in zip(oldest, fine) if count > 360)
    assert list(read(connection)) == []


def test_odd_rows_are_skipped_and_noted(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number) for number in range(2_100)])
    for number, (column, value) in enumerate([("least", "'x'"), ("level", "7"), ("good", "NULL"), ("mean", "9e999")]):
        if value != "NULL":
            connection.execute(f"UPDATE samples SET {column} = {value} WHERE start_s = {10.0 * number}")
    connection.execute("INSERT INTO samples VALUES (x'00', 1, 'x', 10.0, 1, 1, 1, 1, 1, 0, 0)")
    assert len(list(read(connection))) == 2_097
    assert isinstance(connection, CheckedConnection)
    assert connection.skipped_text
    store(connection, [part(0.0, 5.0)])
    assert next(read(connection)).most == 5.0
    merge(connection, -1.0, 30_000.0)
    assert all(each.seconds == 300.0 for each in read(connection))


def test_coarse_samples_are_those_of_the_periods_that_begin_in_them(connection: sqlite3.Connection) -> None:
    random.seed(7)
    stored = [
        part(10.0 * number, random.choice([None, random.uniform(-5.0, 5.0)]), good=random.randrange(5),
             bad=random.randrange(3), level=random.choice([OK, WARN, ERROR, STALE]))
        for number in random.sample(range(1000), 400)
    ]  # fmt: skip
    store(connection, [*stored, part(50.0, 99.0, signal="b"), part(50.0, 99.0, robot="r2")])
    severity = [OK, WARN, STALE, ERROR]
    for since_s, until_s, seconds in ((0.0, 1e9, 60.0), (1234.0, 5678.0, 900.0), (-100.0, 300.0, 7.0)):
        found = read_coarse(connection, "r1", "a", since_s, until_s, seconds)
        expected = []
        for number in range(-20, 2000):
            inside = sorted(
                each for each in stored
                if number == int(each.start_s / seconds) and since_s - seconds < each.start_s < until_s
            )  # fmt: skip
            values = [each for each in inside if each.last is not None]
            weight = sum(each.good for each in values)
            if inside:
                mean = sum(each.mean * each.good for each in values) / weight if weight else None
                expected.append((
                    number * seconds, min((each.least for each in values), default=None),
                    max((each.most for each in values), default=None), mean, values[-1].last if values else None,
                    sum(each.good for each in inside), sum(each.bad for each in inside),
                    max((each.level for each in inside), key=severity.index),
                ))  # fmt: skip
        assert [(each.start_s, each.least, each.most, pytest.approx(each.mean), each.last, each.good, each.bad,
                 each.level) for each in found] == expected  # fmt: skip


def test_coarse_samples_are_the_newest_ones_and_odd_rows_are_skipped(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0 * number) for number in range(2100)])
    connection.execute("UPDATE samples SET most = 'x' WHERE start_s = 20990.0")
    found = read_coarse(connection, "r1", "a", 0.0, 1e9, 10.0)
    assert (len(found), found[0].start_s, found[-1].start_s) == (1999, 1000.0, 20980.0)
    assert connection.skipped_text  # type: ignore[attr-defined]


def test_the_worst_level_of_each_robot_is_kept_for_two_days(connection: sqlite3.Connection) -> None:
    store(connection, [part(10.0, level=WARN), part(880.0, level=STALE), part(900.0, level=OK, signal="b")])
    store(connection, [part(890.0, level=WARN), part(910.0, level=OK), part(10.0, robot="r2", level=ERROR)])
    store(connection, [part(20.0, robot="r2", level=STALE)])
    expected = [("r1", 0.0, STALE), ("r1", 900.0, OK), ("r2", 0.0, ERROR)]
    assert sorted(read_levels(connection, -1.0)) == expected
    assert list(read_levels(connection, 900.0)) == [("r1", 900.0, OK)]
    merge(connection, -1.0, 900.0)
    assert [*read_levels(connection, -1.0)] == [("r1", 900.0, OK)]


def test_a_merged_period_keeps_its_length_where_shorter_ones_are_asked_for(connection: sqlite3.Connection) -> None:
    store(connection, [part(600.0)._replace(seconds=300.0), part(900.0)])
    found = read_coarse(connection, "r1", "a", 0.0, 1e9, 60.0)
    assert [(each.start_s, each.seconds) for each in found] == [(600.0, 300.0), (900.0, 60.0)]


@pytest.mark.parametrize("value", [1.7976931348623157e308, -1.7976931348623157e308, 5e-300, 0.1])
def test_the_mean_of_extreme_values_is_one_of_them(connection: CheckedConnection, value: float) -> None:
    """Issue: the sum of values near the largest double was infinite: 0 of 2 periods and a fault."""
    store(connection, [part(10.0 * number, value, good=7) for number in range(6)])
    store(connection, [part(0.0, value, good=3)])  # joined with the stored one
    found = read_coarse(connection, "r1", "a", 0.0, 1e9, 30.0)
    assert [(each.least, each.most, each.good) for each in found] == [(value, value, 24), (value, value, 21)]
    assert [each.mean for each in found] == [pytest.approx(value, rel=1e-15)] * 2
    merge(connection, 0.0, 1e9)
    assert [(each.mean, each.good) for each in read(connection)] == [(pytest.approx(value, rel=1e-15), 45)]
    assert connection.skipped_text == ""


def test_the_mean_of_opposite_extremes_is_between_them(connection: CheckedConnection) -> None:
    most = 1.7976931348623157e308
    store(connection, [part(10.0 * number, most if number % 2 else -most, good=8) for number in range(6)])
    (found,) = read_coarse(connection, "r1", "a", 0.0, 1e9, 60.0)
    assert (found.least, found.most, found.mean) == (-most, most, 0.0)
    assert connection.skipped_text == ""
