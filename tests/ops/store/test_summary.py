"""Shares of time, alerts and outages, calculated by hand."""

from __future__ import annotations

import sqlite3

import pytest
from harness.histories import transition

from robot_health_monitor.core import Level
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.rows import INSERT_TRANSITION, transition_row
from robot_health_monitor.ops.store.summary import SignalSummary, summarize

OK, WARN, ERROR, STALE = Level.OK, Level.WARN, Level.ERROR, Level.STALE


@pytest.fixture
def connection() -> sqlite3.Connection:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    return connection


def run(connection: sqlite3.Connection, started_s: float, alive_s: float, stopped_s: float | None) -> None:
    """Adds a run that watched the robot r1."""
    insert = "INSERT INTO runs (started_s, alive_s, stopped_s, version) VALUES (?, ?, ?, '1')"
    number = connection.execute(insert, (started_s, alive_s, stopped_s)).lastrowid
    connection.execute("INSERT INTO watches (run_id, robot, started_s) VALUES (?, 'r1', ?)", (number, started_s))


def change(
    connection: sqlite3.Connection,
    wall_s: float,
    before: Level,
    after: Level,
    signal: str = "battery_level",
    lasted_s: float = 1e6,
) -> None:
    """Adds a transition; the level before had been known for `lasted_s`."""
    times = {"now_s": 0.0, "since_s": -lasted_s}
    added = transition(0, after, from_level=before, signal=signal, repeat=before is after, **times)
    connection.execute(INSERT_TRANSITION, transition_row(added, wall_s))


def only(summaries: list[SignalSummary]) -> SignalSummary:
    """Returns the one summary."""
    [summary] = summaries
    return summary


def test_shares_of_one_run(connection: sqlite3.Connection) -> None:
    # 0 to 100: OK 0-40 and 90-100, WARN 40-60, ERROR 60-80, STALE 80-90. Not OK from 40 to 90.
    run(connection, 0.0, 100.0, None)
    for wall_s, before, after in ((40.0, OK, WARN), (60.0, WARN, ERROR), (80.0, ERROR, STALE), (90.0, STALE, OK)):
        change(connection, wall_s, before, after)
    summary = only(summarize(connection, 100.0))
    assert (summary.robot, summary.signal, summary.duration_s) == ("r1", "battery_level", 100.0)
    assert summary.shares == pytest.approx({OK: 0.5, WARN: 0.2, ERROR: 0.2, STALE: 0.1})
    assert (summary.unknown, summary.alerts, summary.longest_outage_s) == (0.0, 1, 50.0)
    assert summary.availability == pytest.approx(0.5)
    assert summary.mean_time_to_recover_s == 50.0
    assert summary.levels == [(0.0, OK), (40.0, WARN), (60.0, ERROR), (80.0, STALE), (90.0, OK)]


def test_gaps_are_unknown_and_neither_end_an_outage_nor_count(connection: sqlite3.Connection) -> None:
    # Runs 0-40 (killed) and 60-100, WARN from 30 to 70: 10 s before and 10 s after the gap of 20 s.
    run(connection, 0.0, 40.0, None)
    run(connection, 60.0, 100.0, 100.0)
    change(connection, 30.0, OK, WARN)
    change(connection, 70.0, WARN, OK)
    summary = only(summarize(connection, 100.0))
    assert summary.shares == pytest.approx({OK: 0.6, WARN: 0.2})
    assert summary.unknown == pytest.approx(0.2)
    assert (summary.alerts, summary.longest_outage_s) == (1, 20.0)
    assert summary.availability == pytest.approx(60.0 / 80.0)
    assert summary.mean_time_to_recover_s == 20.0
    assert summary.levels == [(0.0, OK), (30.0, WARN), (40.0, None), (60.0, WARN), (70.0, OK)]


def test_an_alert_that_is_open_counts_until_now(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 100.0, None)
    change(connection, 75.0, OK, ERROR)
    summary = only(summarize(connection, 100.0))
    assert summary.shares == pytest.approx({OK: 0.75, ERROR: 0.25})
    assert summary.longest_outage_s == 25.0
    assert summary.mean_time_to_recover_s is None  # it has not recovered
    assert summary.levels == [(0.0, OK), (75.0, ERROR)]


def test_time_after_the_last_sign_of_life_is_unknown(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 50.0, None)
    change(connection, 25.0, OK, WARN)
    summary = only(summarize(connection, 100.0))
    assert summary.shares == pytest.approx({OK: 0.25, WARN: 0.25})
    assert summary.unknown == pytest.approx(0.5)
    assert summary.availability == pytest.approx(0.5)
    assert summary.levels == [(0.0, OK), (25.0, WARN), (50.0, None)]


def test_with_since_the_level_from_before_counts(connection: sqlite3.Connection) -> None:
    # WARN since 10: from 50 to 100 it is WARN until 75. The alert began before.
    run(connection, 0.0, 100.0, None)
    change(connection, 10.0, OK, WARN)
    change(connection, 75.0, WARN, OK)
    summary = only(summarize(connection, 100.0, since_s=50.0))
    assert summary.duration_s == 50.0
    assert summary.shares == pytest.approx({OK: 0.5, WARN: 0.5})
    assert (summary.alerts, summary.longest_outage_s) == (0, 25.0)
    assert summary.mean_time_to_recover_s is None  # the outage began before
    assert summary.levels == [(50.0, WARN), (75.0, OK)]


def test_while_the_link_is_down_only_the_link_is_known(connection: sqlite3.Connection) -> None:
    # Link down 20-60. battery_level: OK 0-20, unknown 20-60, WARN 60-70, OK 70-100.
    run(connection, 0.0, 100.0, None)
    connection.execute("INSERT INTO signal_states VALUES ('r1', 'battery_level', '{}')")
    change(connection, 20.0, OK, ERROR, "link")
    change(connection, 60.0, ERROR, OK, "link")
    change(connection, 60.0, OK, WARN)
    change(connection, 70.0, WARN, OK)
    battery, link = summarize(connection, 100.0)
    assert battery.shares == pytest.approx({OK: 0.5, WARN: 0.1})
    assert battery.unknown == pytest.approx(0.4)
    assert link.shares == pytest.approx({OK: 0.6, ERROR: 0.4})
    assert (link.unknown, link.longest_outage_s) == (0.0, 40.0)
    assert battery.availability == pytest.approx(50.0 / 60.0)
    assert battery.levels == [(0.0, OK), (20.0, None), (60.0, WARN), (70.0, OK)]
    assert link.levels == [(0.0, OK), (20.0, ERROR), (60.0, OK)]


def test_time_that_was_unknown_does_not_count_as_ok(connection: sqlite3.Connection) -> None:
    # never known until it is STALE at 20; OK again from 30 to 80, but unknown from 40 to 60, for example a restart
    run(connection, 0.0, 100.0, None)
    change(connection, 20.0, OK, STALE, lasted_s=0.0)
    change(connection, 30.0, STALE, OK, lasted_s=10.0)
    change(connection, 80.0, OK, WARN, lasted_s=30.0)
    summary = only(summarize(connection, 100.0))
    assert summary.shares == pytest.approx({OK: 0.3, WARN: 0.2, STALE: 0.1})
    assert summary.unknown == pytest.approx(0.4)
    assert summary.availability == pytest.approx(0.5)
    assert summary.levels == [(0.0, None), (20.0, STALE), (30.0, None), (50.0, OK), (80.0, WARN)]


def test_unknown_time_is_taken_from_the_begin_of_an_ok_that_gaps_interrupt(connection: sqlite3.Connection) -> None:
    # Watched 0-20, 40-60, 80-120. OK until WARN at 100; 45 of the 60 s before were known: unknown for the first 15 s.
    for started_s, stopped_s in ((0.0, 20.0), (40.0, 60.0), (80.0, 120.0)):
        run(connection, started_s, stopped_s, stopped_s)
    change(connection, 100.0, OK, WARN, lasted_s=45.0)
    summary = only(summarize(connection, 120.0))
    assert summary.levels == [
        (0.0, None), (15.0, OK), (20.0, None), (40.0, OK), (60.0, None), (80.0, OK), (100.0, WARN),
    ]  # fmt: skip
    assert summary.shares == pytest.approx({OK: 45.0 / 120.0, WARN: 20.0 / 120.0})
    # With 15 s known, all of the first two runs is unknown, and 5 s of the third.
    connection.execute("UPDATE transitions SET since_s = -15.0")
    summary = only(summarize(connection, 120.0))
    assert summary.levels == [(0.0, None), (85.0, OK), (100.0, WARN)]


def test_the_mean_time_to_recover_is_that_of_the_outages_that_ended(connection: sqlite3.Connection) -> None:
    # Outages of 10 s (WARN), 30 s (WARN, ERROR, WARN), and one that is still open: (10 + 30) / 2.
    run(connection, 0.0, 1000.0, None)
    for wall_s, before, after in (
        (100.0, OK, WARN), (110.0, WARN, OK),
        (200.0, OK, WARN), (210.0, WARN, ERROR), (220.0, ERROR, WARN), (230.0, WARN, OK),
        (900.0, OK, STALE),
    ):  # fmt: skip
        change(connection, wall_s, before, after)
    summary = only(summarize(connection, 1000.0))
    assert summary.mean_time_to_recover_s == 20.0
    assert summary.availability == pytest.approx(860.0 / 1000.0)
    assert summary.longest_outage_s == 100.0


def test_nothing_known_has_no_availability(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 100.0, None)
    state = '{"since": {"announced": 0.0, "unknown": 0.0}, "announced": {"level": "OK", "never_known": true}}'
    connection.execute("INSERT INTO signal_states VALUES ('r1', 'a', ?)", (state,))
    summary = only(summarize(connection, 100.0))
    assert (summary.availability, summary.mean_time_to_recover_s) == (None, None)
    assert summary.levels == [(0.0, None)]


def test_a_signal_that_changes_all_the_time_has_a_bounded_course(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 20_000.0, None)
    for number in range(3_000):
        change(connection, 2.0 * number, OK, WARN)
        change(connection, 2.0 * number + 1.0, WARN, OK)
    summary = only(summarize(connection, 20_000.0))
    assert len(summary.levels) == 5_001
    assert summary.levels[-1][1] is None
    assert summary.alerts == 3_000


def test_the_saved_state_says_since_when_a_signal_without_transitions_is_known(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 100.0, None)
    states = {
        "a": '{"since": {"announced": 4.0}, "announced": {"level": "OK"}}',
        "b": '{"since": {"announced": 0.0, "unknown": 0.0}, "announced": {"level": "OK", "never_known": true}}',
        "c": '{"since": {"announced": 10.0, "unknown": 70.0}, "announced": {"level": "OK"}}',
        "d": "[no JSON",
        "e": '{"since": "yesterday"}',
    }
    connection.executemany("INSERT INTO signal_states VALUES ('r1', ?, ?)", states.items())
    found = {summary.signal: (summary.shares.get(OK, 0.0), summary.unknown) for summary in summarize(connection, 100.0)}
    assert found == {name: pytest.approx(each) for name, each in {
        "a": (0.96, 0.04), "b": (0.0, 1.0), "c": (0.6, 0.4), "d": (1.0, 0.0), "e": (1.0, 0.0),
    }.items()}  # fmt: skip


def test_a_signal_that_was_always_ok_is_listed(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 100.0, None)
    connection.execute("INSERT INTO signal_states VALUES ('r1', 'temperature', '{}')")
    summary = only(summarize(connection, 100.0))
    assert (summary.signal, summary.shares, summary.alerts) == ("temperature", {OK: 1.0}, 0)


def test_repetitions_are_no_alerts(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 100.0, None)
    change(connection, 50.0, OK, WARN)
    change(connection, 60.0, WARN, WARN)
    summary = only(summarize(connection, 100.0))
    assert summary.alerts == 1
    assert summary.longest_outage_s == 50.0


def test_a_clock_that_is_set_back_never_makes_a_time_negative(connection: sqlite3.Connection) -> None:
    # OK until 60; the transition at 40 comes after it: WARN from 60 to 80.
    run(connection, 0.0, 100.0, None)
    change(connection, 60.0, OK, ERROR)
    change(connection, 40.0, ERROR, WARN)
    change(connection, 80.0, WARN, OK)
    summary = only(summarize(connection, 100.0))
    assert summary.shares == pytest.approx({OK: 0.8, WARN: 0.2})


def test_robots_and_signals_can_be_chosen(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 100.0, None)
    connection.execute("INSERT INTO watches (run_id, robot, started_s) VALUES (1, 'r2', 50.0)")
    states = [("r1", "a"), ("r1", "b1"), ("r2", "b2"), ("gone", "b3")]
    connection.executemany("INSERT INTO signal_states VALUES (?, ?, '{}')", states)
    assert [(each.robot, each.signal) for each in summarize(connection, 100.0)] == [
        ("r1", "a"), ("r1", "b1"), ("r2", "b2"),
    ]  # fmt: skip
    assert [each.signal for each in summarize(connection, 100.0, signal="b*")] == ["b1", "b2"]
    assert [(each.signal, each.duration_s) for each in summarize(connection, 100.0, robot="r2")] == [("b2", 50.0)]


def test_a_topic_is_listed_only_if_it_was_silent(connection: sqlite3.Connection) -> None:
    run(connection, 0.0, 100.0, None)
    insert = "INSERT INTO signal_states VALUES ('r1', ?, '{}')"
    connection.executemany(insert, [(name,) for name in ("/imu", "/scan", "left", "low")])
    change(connection, 40.0, OK, STALE, "/scan")
    effects = "SELECT 'left' AS name UNION SELECT 'low'"
    connection.execute(f"INSERT INTO effects SELECT id, name FROM transitions, ({effects})")
    change(connection, 60.0, STALE, OK, "/scan")
    change(connection, 70.0, OK, WARN, "low")
    found = summarize(connection, 100.0)
    assert [(each.signal, each.cause) for each in found] == [("/scan", ""), ("left", "/scan"), ("low", "")]
