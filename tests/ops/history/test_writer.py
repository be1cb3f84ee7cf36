"""The thread that writes the history."""

from __future__ import annotations

import sqlite3
import threading
import time
from typing import Iterator, List

import pytest

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.ops.history.storage import Storage
from robot_health_monitor.ops.history.writer import MAX_WAITING, Job, Writer


@pytest.fixture
def writer() -> Iterator[Writer]:
    opened = Writer(Storage(None, 90.0, 100.0, Faults(), time.time))
    yield opened
    opened.close(5.0)


@pytest.fixture
def hang(writer: Writer) -> Iterator[threading.Event]:
    """Makes the writer hang, as a disk does, until the event is set."""
    proceed, has_begun = threading.Event(), threading.Event()

    def wait(connection: sqlite3.Connection) -> None:
        has_begun.set()
        proceed.wait(60.0)

    writer.put(Job(wait))
    has_begun.wait(60.0)
    yield proceed
    proceed.set()


def test_a_function_runs_in_a_transaction(writer: Writer) -> None:
    assert writer.run(lambda connection: connection.in_transaction, 5.0) is True


def test_a_function_that_fails_in_the_database_changes_nothing(writer: Writer) -> None:
    def create_then_fail(connection: sqlite3.Connection) -> None:
        connection.execute("CREATE TABLE made (x)")
        connection.execute("INSERT INTO missing VALUES (1)")

    with pytest.raises(ServiceError, match="history: no such table: missing"):
        writer.run(create_then_fail, 5.0)
    query = "SELECT count(*) FROM sqlite_master WHERE name = 'made'"
    assert writer.run(lambda connection: connection.execute(query).fetchone(), 5.0) == (0,)


def test_the_error_of_a_function_reaches_its_caller(writer: Writer) -> None:
    with pytest.raises(ZeroDivisionError):
        writer.run(lambda connection: 1 / 0, 5.0)


def test_only_the_first_caller_waits_while_the_disk_hangs(
    writer: Writer, hang: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(timeout_s: float) -> bool:
        raise AssertionError("it waited")

    done: List[int] = []
    jobs = [Job(lambda connection, n=n: done.append(n)) for n in range(3)]  # type: ignore[misc]
    for job in jobs:
        assert writer.put(job)
    writer.wait(jobs[0], 0.01)
    while writer.busy_s < 0.01:
        pass
    monkeypatch.setattr(jobs[1].done, "wait", refuse)
    writer.wait(jobs[1], 0.01)
    assert done == []
    assert writer.busy_s > 0.0
    hang.set()
    assert jobs[2].done.wait(60.0)
    assert done == [0, 1, 2]


def test_callers_wait_again_once_the_disk_responds(writer: Writer, hang: threading.Event) -> None:
    hang.set()
    writer.run(lambda connection: None, 60.0)
    job = Job(lambda connection: None)
    writer.put(job)
    writer.wait(job, 60.0)
    assert job.done.is_set()


def test_a_function_that_was_given_up_does_not_run_later(writer: Writer, hang: threading.Event) -> None:
    ran: List[bool] = []
    with pytest.raises(ServiceError, match=r"history: no answer within 0\.01 s"):
        writer.run(lambda connection: ran.append(True), 0.01)
    hang.set()
    writer.run(lambda connection: None, 60.0)
    assert ran == []


def test_the_number_of_waiting_jobs_is_bounded(writer: Writer, hang: threading.Event) -> None:
    accepted = sum(writer.put(Job(lambda connection: None)) for _ in range(MAX_WAITING + 10))
    assert accepted == MAX_WAITING
    with pytest.raises(ServiceError, match="too many requests"):
        writer.run(lambda connection: None, 60.0)
    assert writer.put(Job(lambda connection: None), is_urgent=True)


def test_closing_runs_what_waits(writer: Writer) -> None:
    done: List[int] = []
    for number in range(100):
        writer.put(Job(lambda connection, n=number: done.append(n)))  # type: ignore[misc]
    assert writer.close(60.0)
    assert done == list(range(100))
    assert not writer.put(Job(lambda connection: None))
