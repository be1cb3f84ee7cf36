"""What happens to the file must not happen to the monitor."""

from __future__ import annotations

import os
import sqlite3
import threading
import time
from pathlib import Path
from typing import Iterator

import pytest
from harness.histories import fault_texts, opened, stored_texts, texts, transition
from harness.waiting import wait_for

from robot_health_monitor.core import Level
from robot_health_monitor.core.judge.sample_summary import SampleSummary
from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store import database, samples
from robot_health_monitor.ops.store.database import MAX_WAITING, Database, Job
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.ops.store.history import History


@pytest.fixture(autouse=True)
def _quick_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "_FIRST_RETRY_S", 0.1)
    monkeypatch.setattr(database, "_LAST_RETRY_S", 0.1)
    monkeypatch.setattr(database, "_PERIOD_S", 0.05)


def numbers(found: list[str]) -> list[int]:
    """Returns the numbers in the texts of transitions."""
    return [int(text.rpartition(" ")[2]) for text in found]


def record(history: History, *wanted: int) -> None:
    """Records transitions of the robot r1 with these numbers; the state after each is its number."""
    robot = history.of_robot("r1")
    for number in wanted:
        robot.record(transition(number), {"number": number}, [(1.0, 2.0)] * 300)
    history.run(lambda connection: None, 60.0)  # all of it is stored


class NotedFaults(Faults):
    """Faults that also keeps every report: a fault may end before a test looks at it."""

    def __init__(self) -> None:
        super().__init__()
        self.reported: list[tuple[str, str]] = []

    def report(self, part: str, text: str, level: Level = Level.ERROR) -> None:
        self.reported.append((part, text))
        super().report(part, text, level)


def restored(file: Path) -> object:
    """Returns the state that a restarted monitor finds."""
    history = opened(file)
    state = history.of_robot("r1").restore()
    history.close()
    return state


def test_a_full_disk_loses_nothing_once_there_is_space_again(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", NotedFaults()
    history = opened(file, faults)
    record(history, *range(5))
    limit = history.run(lambda connection: connection.execute("PRAGMA page_count").fetchone()[0])
    history.run(lambda connection: connection.execute(f"PRAGMA max_page_count = {limit + 5}").fetchone())
    record(history, *range(5, 50))
    assert faults.reported == [("history", f"{file}: database or disk is full; continuing in memory")]
    # The next attempt opens the file anew, without the limit.
    wait_for(lambda: not faults.current())
    assert numbers(stored_texts(file)) == list(range(50))
    history.close()
    assert restored(file) == {"battery_level": {"number": 49}}


def test_a_full_disk_loses_no_samples_and_the_period_goes_on(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", NotedFaults()
    history = opened(file, faults)
    robot = history.of_robot("r1")

    def collect(number: int, value: float) -> None:
        start_s = 4e9 + 10.0 * number  # in the future: not merged
        robot.record_samples({"fan": [SampleSummary(start_s, value, value, value, value, 1, 0, Level.OK)]})
        history.run(lambda connection: None, 60.0)

    collect(0, 5.0)
    limit = history.run(lambda connection: connection.execute("PRAGMA page_count").fetchone()[0])
    history.run(lambda connection: connection.execute(f"PRAGMA max_page_count = {limit}").fetchone())
    collect(0, 7.0)
    for number in range(1, 300):
        collect(number, 1.0)
    assert [part for part, _ in faults.reported] == ["history"]
    wait_for(lambda: not faults.current())
    history.close()
    with reading(str(file)) as connection:
        stored = list(samples.read(connection))
    assert [(each.start_s - 4e9, each.good) for each in stored] == [(0.0, 2), *((10.0 * n, 1) for n in range(1, 300))]
    assert (stored[0].least, stored[0].most) == (5.0, 7.0)


def test_what_is_queued_in_the_database_survives_a_full_disk(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    add = "INSERT INTO silences (id, matchers, reason, author, created_s) VALUES (?, '', '', '', 0)"
    record(history, 0)
    history.run(lambda connection: connection.execute(add, (1,)))
    history.run(lambda connection: connection.execute("PRAGMA max_page_count = 1").fetchone())
    record(history, *range(1, 30))
    assert history.run(lambda connection: connection.execute("SELECT id FROM silences").fetchall()) == [(1,)]
    history.run(lambda connection: connection.execute(add, (2,)))
    wait_for(lambda: not faults.current())
    assert history.run(lambda connection: connection.execute("SELECT id FROM silences").fetchall()) == [(1,), (2,)]
    history.close()


def test_another_process_that_holds_the_database_only_delays_the_history(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.store.database_file._BUSY_S", 0.2)
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    record(history, 0)
    other = sqlite3.connect(file, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    record(history, 1, 2, 3)
    wait_for(lambda: bool(faults.current()))
    assert fault_texts(faults) == [("history", f"{file}: database is locked; continuing in memory")]
    other.execute("ROLLBACK")
    other.close()
    wait_for(lambda: not faults.current())
    assert numbers(stored_texts(file)) == [0, 1, 2, 3]
    history.close()


def test_a_reader_that_keeps_the_log_from_being_shortened_does_not_fill_the_disk(tmp_path: Path) -> None:
    file, log = tmp_path / "history.db", tmp_path / "history.db-wal"
    faults = NotedFaults()
    history = opened(file, faults, keep_mb=1.0)
    record(history, 0)
    reader = sqlite3.connect(str(file), isolation_level=None)
    reader.execute("BEGIN")
    assert reader.execute("SELECT count(*) FROM transitions").fetchone() == (1,)
    number = 0
    while "history" not in faults.current():
        number += 1
        record(history, number)
        assert file.stat().st_size + log.stat().st_size <= 1_100_000
    assert "its log is locked: another program keeps reading it" in faults.current()["history"].text
    record(history, *range(number + 1, number + 10))
    reader.close()
    wait_for(lambda: "history" not in faults.current())
    assert numbers(stored_texts(file)) == list(range(number + 10))
    history.close()


def test_a_file_that_is_damaged_while_it_is_used_is_kept_beside_a_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(database, "_PERIOD_S", 3600.0)  # a sign of life would be copied into the damaged file
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    record(history, *range(40))
    checkpoint = sqlite3.connect(file)
    while checkpoint.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]:
        pass  # the history copies its log at this moment
    checkpoint.close()
    garbage = b"\xa5" * file.stat().st_size
    with file.open("r+b") as damaged:
        damaged.write(garbage)
    record(history, *range(40, 45))
    [(part, text)] = fault_texts(faults)
    assert part == "history file"
    # Which of the two SQLite reports depends on what it has read before.
    reports = ("file is not a database", "database disk image is malformed")
    assert text.startswith(tuple(f"{file} is damaged ({report}): kept as {file}.damaged-" for report in reports))
    assert text.endswith(", a new history was begun")
    [aside] = tmp_path.glob("history.db.damaged-*Z")
    assert aside.read_bytes() == garbage
    assert numbers(stored_texts(file)) == list(range(40, 45))
    history.close()
    assert restored(file) == {"battery_level": {"number": 44}}


def test_the_state_survives_damage_even_if_nothing_changes_afterwards(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    robot = history.of_robot("r1")
    robot.save({"temperature": {"latched": True}})
    robot.record(transition(1), {}, [])
    checkpoint = sqlite3.connect(file)
    checkpoint.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    checkpoint.close()
    with file.open("r+b") as damaged:
        damaged.write(b"\xa5" * file.stat().st_size)
    robot.record(transition(2), {}, [])
    history.close()
    assert restored(file) == {"temperature": {"latched": True}}


@pytest.mark.parametrize("damage", ["garbage at its begin", "truncated"])
def test_a_damaged_file_found_at_the_start_is_kept_beside_a_new_one(tmp_path: Path, damage: str) -> None:
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    record(history, *range(40))
    history.close()
    if damage == "truncated":
        os.truncate(file, file.stat().st_size // 2)
    else:
        with file.open("r+b") as damaged:
            damaged.write(b"\xa5" * 200)
    content = file.read_bytes()
    history = opened(file, faults)
    record(history, 100)
    assert [part for part, _ in fault_texts(faults)] == ["history file"]
    [aside] = tmp_path.glob("history.db.damaged-*Z")
    assert aside.read_bytes() == content
    assert numbers(stored_texts(file)) == [100]
    history.close()


def test_a_file_that_is_deleted_while_it_is_used_is_begun_anew(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    record(history, 1)
    for path in tmp_path.glob("history.db*"):
        path.unlink()
    wait_for(lambda: bool(faults.current()))
    text = f"{file} was deleted or replaced while in use: the present state was written to a new file"
    assert fault_texts(faults) == [("history file", text)]
    record(history, 2)
    assert numbers(stored_texts(file)) == [2]
    query = "SELECT id FROM transitions"
    assert history.run(lambda connection: connection.execute(query).fetchall()) == [(2,)]  # numbers continue
    history.close()


def test_another_file_is_left_alone(tmp_path: Path) -> None:
    file, faults = tmp_path / "thresholds.yaml", Faults()
    file.write_text("signals: {}\n")
    history = opened(file, faults)
    record(history, 1)
    text = f"{file} is not used: it is not a history file; continuing without a history file"
    assert fault_texts(faults) == [("history", text)]
    assert numbers(texts(history)) == [1]
    history.close()
    assert file.read_text() == "signals: {}\n"


def test_another_database_is_left_alone(tmp_path: Path) -> None:
    file, faults = tmp_path / "songs.db", Faults()
    songs = sqlite3.connect(file)
    songs.execute("CREATE TABLE songs (title)")
    songs.close()
    content = file.read_bytes()
    history = opened(file, faults)
    record(history, 1)
    history.close()
    text = "it is an SQLite database, but not a history; continuing without a history file"
    assert fault_texts(faults) == [("history", f"{file} is not used: {text}")]
    assert file.read_bytes() == content


def test_a_history_of_a_newer_version_is_not_touched(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", Faults()
    opened(file, faults).close()
    newer = sqlite3.connect(file)
    newer.execute("PRAGMA user_version = 99")
    newer.close()
    content = file.read_bytes()
    history = opened(file, faults)
    record(history, 1)
    history.close()
    [(_, text)] = fault_texts(faults)
    assert text.startswith(f"{file} is not used: it was written by a newer version (schema 99; ")
    assert file.read_bytes() == content


def test_a_second_monitor_continues_without_the_file(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", Faults()
    first, second = opened(file), opened(tmp_path / "link.db")
    second.close()
    (tmp_path / "link.db").unlink()
    (tmp_path / "link.db").symlink_to(file)
    record(first, 1)
    second = opened(tmp_path / "link.db", faults)
    record(second, 2)
    text = "it is in use by another monitor; continuing without a history file"
    assert fault_texts(faults) == [("history", f"{tmp_path / 'link.db'} is not used: {text}")]
    assert numbers(texts(second)) == [2]
    second.close()
    assert numbers(stored_texts(file)) == [1]
    first.close()


def test_a_folder_in_place_of_the_file_is_one_fault(tmp_path: Path) -> None:
    faults = Faults()
    history = opened(tmp_path, faults)
    record(history, 1)
    assert fault_texts(faults) == [("history", f"{tmp_path}: Is a directory; continuing in memory")]
    assert numbers(texts(history)) == [1]
    history.close()


def test_missing_folders_are_created(tmp_path: Path) -> None:
    file, faults = tmp_path / "one" / "two" / "history.db", Faults()
    history = opened(file, faults)
    record(history, 1)
    assert numbers(stored_texts(file)) == [1]
    assert fault_texts(faults) == []
    history.close()


def test_a_file_that_becomes_usable_later_is_used(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", Faults()
    file.mkdir()
    history = opened(file, faults)
    record(history, 1)
    file.rmdir()
    wait_for(lambda: not faults.current())
    record(history, 2)
    history.close()
    assert numbers(stored_texts(file)) == [1, 2]


def test_what_is_in_memory_is_stored_at_the_end_if_possible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "_FIRST_RETRY_S", 3600.0)
    monkeypatch.setattr(database, "_LAST_RETRY_S", 3600.0)
    file, faults = tmp_path / "history.db", Faults()
    file.mkdir()
    history = opened(file, faults)
    record(history, 1)
    assert faults.current()
    file.rmdir()
    history.close()
    assert numbers(stored_texts(file)) == [1]


def test_numbers_of_transitions_continue_after_a_time_in_memory(tmp_path: Path) -> None:
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    record(history, 1, 2)
    history.run(lambda connection: connection.execute("PRAGMA max_page_count = 1").fetchone())
    record(history, *range(3, 30))
    wait_for(lambda: not faults.current())
    record(history, 30)
    ids = history.run(lambda connection: connection.execute("SELECT id FROM transitions ORDER BY id").fetchall())
    assert [number for (number,) in ids] == list(range(1, 31))
    history.close()


def test_a_clock_that_is_wrong_by_decades_deletes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database, "_RETENTION_PERIOD_S", 0.0)
    monkeypatch.setattr(database, "_PERIOD_S", 0.0)
    file = tmp_path / "history.db"
    right_s, wrong_s = 1.8e9, 4e9

    def run_until_wrong(*wanted: int) -> None:
        """Records transitions; after that, or from the start, the clock is wrong, and entries are deleted by age."""
        clock = [right_s if wanted else wrong_s]
        history = History(HistorySettings(str(file)), lambda: clock[0])
        record(history, *wanted)
        clock[0] = wrong_s + 1.0
        query = "SELECT max(alive_s) FROM runs WHERE stopped_s IS NULL"
        wait_for(lambda: history.run(lambda connection: connection.execute(query).fetchone()) == (wrong_s + 1.0,))
        history.run(lambda connection: None)  # deleting has ended
        clock[0] = right_s
        history.close()

    run_until_wrong(0, 1, 2)
    run_until_wrong()  # the computer starts with a wrong clock
    assert numbers(stored_texts(file)) == [0, 1, 2]


def test_the_gap_after_a_run_that_was_killed_begins_at_its_last_sign_of_life(tmp_path: Path) -> None:
    file, now_s = tmp_path / "history.db", [1000.0]
    history = History(HistorySettings(str(file)), lambda: now_s[0])
    query = "SELECT started_s, alive_s, stopped_s FROM runs"

    def run() -> tuple[object, ...]:
        [row] = history.run(lambda connection: connection.execute(query).fetchall())
        return tuple(row)

    assert run() == (1000.0, 1000.0, None)
    now_s[0] = 1050.0
    wait_for(lambda: run() == (1000.0, 1050.0, None))
    now_s[0] = 1060.0
    record(history, 1)  # a transition is a sign of life
    assert run() == (1000.0, 1060.0, None)
    history.close()


ALTERED = (
    "DROP TABLE notified", "ALTER TABLE open_alerts RENAME TO other",
    "ALTER TABLE transitions RENAME COLUMN black_box TO other",
)  # fmt: skip


@pytest.mark.parametrize("statement", ALTERED)
@pytest.mark.parametrize("at_the_start", [False, True])
def test_a_file_whose_tables_were_altered_is_kept_beside_a_new_one_with_the_present_state(
    tmp_path: Path, statement: str, at_the_start: bool
) -> None:
    file, faults = tmp_path / "history.db", Faults()
    history = opened(file, faults)
    record(history, 1)
    if at_the_start:
        history.close()
    other = sqlite3.connect(file, timeout=60.0, isolation_level=None)
    other.execute(statement)
    other.close()
    if at_the_start:
        history = opened(file, faults)
    history.run(lambda connection: connection.execute("SELECT * FROM notified").fetchall())
    record(history, 2, 3)
    table = statement.split()[2]
    [(part, text)] = fault_texts(faults)
    assert part == "history file"
    assert text.startswith(f"{file} is damaged (its table {table} was altered): kept as {file}.damaged-")
    [aside] = tmp_path.glob("history.db.damaged-*Z")
    assert len(list(tmp_path.glob("history.db.damaged-*Z"))) == 1
    assert history.of_robot("r1").restore() == {"battery_level": {"number": 3}}
    assert numbers(stored_texts(file))[-1] == 3
    history.close()
    assert sqlite3.connect(aside).execute("SELECT count(*) FROM runs").fetchone() == (1,)


def test_a_mistake_in_a_statement_of_another_module_replaces_nothing(tmp_path: Path) -> None:
    history = opened(tmp_path / "history.db", faults := Faults())
    with pytest.raises(ServiceError, match="no such table: missing"):
        history.run(lambda connection: connection.execute("SELECT * FROM missing"))
    assert fault_texts(faults) == []
    history.close()


@pytest.fixture
def writer() -> Iterator[Database]:
    opened = Database(None, time.time, None)
    yield opened
    opened.close()


@pytest.fixture
def hang(writer: Database) -> Iterator[threading.Event]:
    """Makes the writer hang, as a disk does, until the event is set."""
    proceed, has_begun = threading.Event(), threading.Event()

    def wait(connection: sqlite3.Connection) -> None:
        has_begun.set()
        proceed.wait(60.0)

    writer.submit(Job(wait))
    has_begun.wait(60.0)
    yield proceed
    proceed.set()


def test_a_function_runs_in_a_transaction(writer: Database) -> None:
    assert writer.run(lambda connection: connection.in_transaction, 5.0) is True


def test_a_function_that_fails_in_the_database_changes_nothing(writer: Database) -> None:
    def create_then_fail(connection: sqlite3.Connection) -> None:
        connection.execute("CREATE TABLE made (x)")
        connection.execute("INSERT INTO missing VALUES (1)")

    with pytest.raises(ServiceError, match="history: no such table: missing"):
        writer.run(create_then_fail, 5.0)
    query = "SELECT count(*) FROM sqlite_master WHERE name = 'made'"
    assert writer.run(lambda connection: connection.execute(query).fetchone(), 5.0) == (0,)


def test_the_error_of_a_function_reaches_its_caller(writer: Database) -> None:
    with pytest.raises(ZeroDivisionError):
        writer.run(lambda connection: 1 / 0, 5.0)


def test_the_error_of_a_function_that_nothing_waits_for_is_a_fault() -> None:
    faults = NotedFaults()
    opened = Database(None, time.time, faults)
    opened.put(lambda connection: 1 / 0)
    opened.close(60.0)
    assert faults.reported == [("history", "internal error: ZeroDivisionError")]


def test_a_wait_ends_in_time_while_the_disk_hangs_and_with_the_job_once_it_responds(
    writer: Database, hang: threading.Event
) -> None:
    jobs = [Job(lambda connection: None) for _ in range(2)]
    assert all(map(writer.submit, jobs))
    assert not writer.wait(jobs[0], 0.01)
    assert writer.busy_s > 0.0
    hang.set()
    assert writer.wait(jobs[1], 60.0)
    assert jobs[0].is_done


def test_several_threads_wait_at_the_same_time(writer: Database, hang: threading.Event) -> None:
    jobs = [Job(lambda connection: None) for _ in range(8)]
    assert all(map(writer.submit, jobs))
    results: list[bool] = []
    waiting = [threading.Thread(target=lambda job=job: results.append(writer.wait(job, 60.0))) for job in jobs]
    for thread in waiting:
        thread.start()
    hang.set()
    for thread in waiting:
        thread.join()
    assert results == [True] * 8


def test_a_function_that_was_given_up_does_not_run_later(writer: Database, hang: threading.Event) -> None:
    ran: list[bool] = []
    with pytest.raises(ServiceError, match=r"history: no answer within 0\.01 s"):
        writer.run(lambda connection: ran.append(True), 0.01)
    hang.set()
    writer.run(lambda connection: None, 60.0)
    assert ran == []


def test_the_number_of_waiting_jobs_is_bounded(writer: Database, hang: threading.Event) -> None:
    accepted = sum(writer.submit(Job(lambda connection: None)) for _ in range(MAX_WAITING + 10))
    assert accepted == MAX_WAITING
    with pytest.raises(ServiceError, match="too many requests"):
        writer.run(lambda connection: None, 60.0)
    assert writer.submit(Job(lambda connection: None), is_urgent=True)


def test_closing_runs_what_waits(writer: Database) -> None:
    done: list[int] = []
    for number in range(100):
        writer.submit(Job(lambda connection, n=number: done.append(n)))  # type: ignore[misc]
    writer.close(60.0)
    assert done == list(range(100))
    assert not writer.submit(Job(lambda connection: None))
