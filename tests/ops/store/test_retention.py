"""What is deleted, and what stays."""

from __future__ import annotations

import sqlite3

import pytest
from harness.histories import transition

from robot_health_monitor.core import Level
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.notes import add_note, notes_of
from robot_health_monitor.ops.store.retention import AgeClock, Retention, used_bytes
from robot_health_monitor.ops.store.rows import INSERT_TRANSITION, transition_row
from robot_health_monitor.ops.store.samples import StoredSamples, read, store

RUN = 3
WARN, OK = Level.WARN, Level.OK


@pytest.fixture
def connection() -> sqlite3.Connection:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
    schema.prepare(connection)
    return connection


def add(
    connection: sqlite3.Connection,
    wall_s: float,
    level: Level,
    *,
    robot: str = "r1",
    signal: str = "a",
    repeat: bool = False,
) -> None:
    """Adds a transition with 1 kB of evidence."""
    row = transition_row(transition(0, level, robot=robot, signal=signal, repeat=repeat), wall_s)
    number = connection.execute(INSERT_TRANSITION, row).lastrowid
    connection.execute("INSERT INTO evidence VALUES (?, ?)", (number, b"x" * 1000))
    if not repeat:
        connection.execute("DELETE FROM open_alerts WHERE robot = ? AND signal = ?", (robot, signal))
    if not repeat and level is not OK:
        opened = (robot, signal, number, number, int(level), wall_s, wall_s, "", "")
        columns = "robot, signal, alert_id, transition_id, level, begun_s, at_s, fingerprint, transition_json"
        connection.execute(f"INSERT INTO open_alerts ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", opened)


def times(connection: sqlite3.Connection, table: str = "transitions", column: str = "wall_s") -> list[float]:
    """Returns the times of the rows that are left."""
    return [time_s for (time_s,) in connection.execute(f"SELECT {column} FROM {table} ORDER BY id")]


def delete_all(connection: sqlite3.Connection, before_s: float, max_bytes: float = 1e9, run_id: int = RUN) -> int:
    """Deletes until nothing is left to delete; returns how many steps that took."""
    retention = Retention(connection, max_bytes)
    steps = 0
    while retention.delete_old(run_id, before_s, 0.0) or (
        retention.is_due() and retention.delete_surplus(run_id, before_s)
    ):
        steps += 1
        assert steps < 1000
    return steps


HOUR_S, DAY_S, YEAR_S = 3600.0, 86_400.0, 31_557_600.0


class Ages:
    """An age clock that begins at 1000 s since 1970."""

    def __init__(self) -> None:
        self._boot_s = 0.0
        self._clock = AgeClock(1000.0, lambda: self._boot_s)

    def at(self, boot_s: float, wall_s: float) -> float:
        """Returns the time for ages, so many seconds later by the monotonic clock."""
        self._boot_s = boot_s
        return self._clock.now_s(wall_s)


def test_ages_follow_the_wall_clock() -> None:
    clock = Ages()
    assert clock.at(60.0, 1060.0) == 1060.0
    assert clock.at(120.0, 1060.0 + HOUR_S) == 1060.0 + HOUR_S  # summer time, set by hand
    assert clock.at(180.0, 500.0) == 500.0  # set back


def test_a_clock_that_is_ahead_by_years_counts_only_after_a_day() -> None:
    clock = Ages()
    assert clock.at(60.0, 1060.0 + YEAR_S) == 1060.0
    assert clock.at(120.0, 1120.0) == 1120.0  # corrected
    assert clock.at(180.0, 1180.0 + YEAR_S) == 1180.0
    assert clock.at(180.0 + DAY_S - 1.0, 1180.0 + YEAR_S + DAY_S - 1.0) == 1180.0 + DAY_S - 1.0
    assert clock.at(180.0 + DAY_S, 1180.0 + YEAR_S + DAY_S) == 1180.0 + YEAR_S + DAY_S
    assert clock.at(240.0 + DAY_S, 1240.0 + YEAR_S + DAY_S) == 1240.0 + YEAR_S + DAY_S


def test_old_transitions_are_deleted_with_their_evidence(connection: sqlite3.Connection) -> None:
    for wall_s, level in ((100.0, WARN), (199.0, OK), (200.0, WARN), (300.0, OK)):
        add(connection, wall_s, level)
    delete_all(connection, before_s=200.0)
    assert times(connection) == [200.0, 300.0]
    assert connection.execute("SELECT transition_id FROM evidence").fetchall() == [(3,), (4,)]


def test_notes_are_deleted_with_their_alert(connection: sqlite3.Connection) -> None:
    for wall_s, level in ((100.0, WARN), (199.0, OK), (200.0, WARN), (300.0, OK)):
        add(connection, wall_s, level)
    for alert in (1, 2, 3, 3):
        add_note(connection, alert, "text", "ana", float(len(notes_of(connection, alert))))
    delete_all(connection, before_s=200.0)
    assert connection.execute("SELECT transition_id FROM notes").fetchall() == [(3,), (3,)]
    delete_all(connection, before_s=200.0, max_bytes=1.0)
    assert connection.execute("SELECT count(*) FROM notes").fetchone() == (0,)


def test_an_open_alert_stays_however_old_it_is(connection: sqlite3.Connection) -> None:
    add(connection, 100.0, WARN, signal="open")
    add(connection, 110.0, WARN, signal="open", repeat=True)
    add(connection, 120.0, WARN, signal="closed")
    add(connection, 130.0, OK, signal="closed")
    delete_all(connection, before_s=1000.0)
    assert times(connection) == [100.0]
    delete_all(connection, before_s=1000.0, max_bytes=1.0)
    assert times(connection) == [100.0]


def test_a_few_are_deleted_at_a_time(connection: sqlite3.Connection) -> None:
    for number in range(1000):
        add(connection, float(number), OK)
    assert Retention(connection, 1e9).delete_old(RUN, 1e9, 0.0)
    assert len(times(connection)) == 800
    assert delete_all(connection, 1e9) == 4
    assert times(connection) == []


def test_the_oldest_are_deleted_until_the_size_is_met_and_the_space_is_given_back(
    connection: sqlite3.Connection,
) -> None:
    for number in range(2000):
        add(connection, float(number), OK)
    assert used_bytes(connection)[0] > 2_000_000
    delete_all(connection, before_s=0.0, max_bytes=500_000)
    left = times(connection)
    assert 200 <= len(left) < 500
    assert left == [float(number) for number in range(2000 - len(left), 2000)]
    [(pages,)] = connection.execute("PRAGMA page_count")
    assert pages * 4096 <= 500_000 + 256_000


def test_samples_go_before_transitions(connection: sqlite3.Connection) -> None:
    for number in range(300):
        add(connection, float(number), OK)
    samples = [StoredSamples("r1", "a", 10.0 * n, 10.0, 1.0, 2.0, 1.5, 2.0, 2, 0, OK) for n in range(20_000)]
    store(connection, samples)
    delete_all(connection, before_s=0.0, max_bytes=1_000_000)
    left = list(read(connection))
    assert 0 < len(left) < 20_000
    assert left == samples[-len(left) :]
    assert len(times(connection)) == 300
    delete_all(connection, before_s=0.0, max_bytes=300_000)
    assert list(read(connection)) == []
    assert 0 < len(times(connection)) < 300


def test_what_is_too_much_is_taken_from_the_signal_that_has_most(connection: sqlite3.Connection) -> None:
    for number in range(20):
        add(connection, float(number), OK, robot="quiet")
    for number in range(20, 1020):
        add(connection, float(number), OK, robot="noisy", signal="a")
    for number in range(1020, 1320):
        add(connection, float(number), OK, robot="noisy", signal="b")
    delete_all(connection, before_s=0.0, max_bytes=500_000)
    left = {
        name: times(connection, f"(SELECT * FROM transitions WHERE robot || signal = '{name}')")
        for name in ("quieta", "noisya", "noisyb")
    }
    assert left["quieta"] == [float(number) for number in range(20)]
    assert left["noisya"] == [float(number) for number in range(1020 - len(left["noisya"]), 1020)]
    assert left["noisyb"] == [float(number) for number in range(1320 - len(left["noisyb"]), 1320)]
    fewer, more = sorted(len(left[name]) for name in ("noisya", "noisyb"))
    assert fewer >= more / 2


def test_a_driver_that_renames_itself_displaces_no_other_signal(connection: sqlite3.Connection) -> None:
    for number in range(1500):
        if number % 50 == 0:
            add(connection, float(number), OK, robot="quiet")
        add(connection, float(number), OK, robot="noisy", signal=f"drivers[{number}]")
    retention = Retention(connection, 500_000)
    while retention.is_due() and retention.delete_surplus(RUN, 0.0):
        pass
    quiet = "(SELECT * FROM transitions WHERE robot = 'quiet')"
    assert times(connection, quiet) == [float(number) for number in range(0, 1500, 50)]
    assert set(retention._stored) == {("quiet", "a"), ("noisy", "drivers")}  # names of elements are no keys


def test_signals_that_share_the_space_lose_their_oldest_entries_in_turn(connection: sqlite3.Connection) -> None:
    for number in range(3000):
        add(connection, float(number), OK, signal=f"signal_{number % 300}")
    delete_all(connection, before_s=0.0, max_bytes=1_000_000)
    left = times(connection)
    assert 300 <= len(left) < 1000
    counts = connection.execute("SELECT count(*) FROM transitions GROUP BY signal").fetchall()
    assert len(counts) == 300
    assert max(counts)[0] - min(counts)[0] <= 1


def test_transitions_that_are_stored_meanwhile_are_counted(connection: sqlite3.Connection) -> None:
    retention = Retention(connection, 500_000)
    for number in range(2000):
        signal = "quiet" if number % 100 == 0 else "noisy"
        add(connection, float(number), OK, signal=signal)
        retention.note_transition("r1", signal)
        while retention.is_due() and retention.delete_surplus(RUN, 0.0):
            pass
        assert used_bytes(connection)[0] <= 500_000
    quiet = "(SELECT * FROM transitions WHERE signal = 'quiet')"
    assert times(connection, quiet) == [float(number) for number in range(0, 2000, 100)]


def test_an_alert_that_opens_or_resolves_meanwhile_is_kept_or_deleted_accordingly(
    connection: sqlite3.Connection,
) -> None:
    add(connection, 1.0, WARN, signal="resolved later")
    add(connection, 2.0, OK, signal="opened later")
    retention = Retention(connection, 1e9)
    assert retention.delete_old(RUN, 2.5, 0.0)  # knows what is open from now on
    assert times(connection) == [1.0]
    for number, level, signal in ((3, OK, "resolved later"), (4, WARN, "opened later")):
        add(connection, float(number), level, signal=signal)
        retention.note_transition("r1", signal)
    add(connection, 5.0, WARN, signal="opened later", repeat=True)
    retention.note_transition("r1", "opened later")
    assert retention.delete_old(RUN, 10.0, 0.0)
    assert times(connection) == [4.0]


def test_open_alerts_that_fill_the_space_lose_their_samples_only(connection: sqlite3.Connection) -> None:
    for number in range(600):
        add(connection, float(number), WARN, signal=f"signal_{number}")
    delete_all(connection, before_s=0.0, max_bytes=500_000)
    assert times(connection) == [float(number) for number in range(600)]
    assert used_bytes(connection)[0] <= 500_000
    [(samples,)] = connection.execute("SELECT count(*) FROM evidence")
    assert samples < 400


def test_a_monitor_that_restarts_all_the_time_stays_within_the_size(connection: sqlite3.Connection) -> None:
    rows = [(float(number), float(number), "1.0") for number in range(20_000)]
    connection.executemany("INSERT INTO runs (started_s, alive_s, version) VALUES (?, ?, ?)", rows)
    add(connection, 5.0, OK)
    delete_all(connection, 0.0, 200_000, run_id=20_000)
    assert used_bytes(connection)[0] <= 200_000
    assert times(connection) == [5.0]
    assert times(connection, "runs", "started_s")[-1] == 19_999.0


def test_runs_and_resets_end_with_the_transitions_of_their_time(connection: sqlite3.Connection) -> None:
    runs = [(100.0, 150.0), (160.0, 250.0), (260.0, 300.0)]
    connection.executemany("INSERT INTO runs (started_s, alive_s, version) VALUES (?, ?, '1')", runs)
    connection.execute("INSERT INTO watches (run_id, robot, started_s) VALUES (1, 'r', 100.0), (2, 'r', 160.0)")
    connection.execute("INSERT INTO resets (wall_s, robot) VALUES (110.0, 'r'), (210.0, 'r')")
    delete_all(connection, before_s=200.0)
    assert times(connection, "runs", "started_s") == [160.0, 260.0]
    assert times(connection, "watches", "started_s") == [160.0]
    assert times(connection, "resets") == [210.0]


def test_the_present_run_stays(connection: sqlite3.Connection) -> None:
    connection.execute("INSERT INTO runs (id, started_s, alive_s, version) VALUES (3, 1.0, 1.0, '1')")
    delete_all(connection, before_s=1000.0, max_bytes=1.0)
    assert times(connection, "runs", "started_s") == [1.0]


def test_the_configuration_in_force_stays(connection: sqlite3.Connection) -> None:
    connection.execute("INSERT INTO configurations VALUES ('old', '{}'), ('new', '{}'), ('other', '{}')")
    changes = [(1.0, "r1", "old"), (2.0, "r1", "new"), (3.0, "r2", "other")]
    connection.executemany("INSERT INTO configuration_changes (wall_s, robot, hash) VALUES (?, ?, ?)", changes)
    delete_all(connection, before_s=1000.0)
    assert connection.execute("SELECT hash FROM configurations ORDER BY hash").fetchall() == [("new",), ("other",)]
