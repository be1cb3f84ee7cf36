"""Silences: which alerts they match, how long they last, and what is refused."""

from __future__ import annotations

import sqlite3

import pytest
from harness.silences import NOON_S, Clock, announce, on_file

from robot_health_monitor.core import Level
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.matchers import Matcher, parse_matchers
from robot_health_monitor.ops.store.silences import (
    Silence,
    open_alerts,
    parse_duration_s,
    read_silences,
    silenced_transitions,
)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("30m", 1800.0),
        ("1h30m", 5400.0),
        ("7d", 604_800.0),
        ("90s", 90.0),
        ("2w1d", 1_296_000.0),
        ("366d", 31_622_400.0),
    ],
)
def test_durations(text: str, seconds: float) -> None:
    assert parse_duration_s(text) == seconds


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "expected a duration such as 30m, 1h30m or 7d, got ''"),
        ("30", "expected a duration such as 30m, 1h30m or 7d, got '30'"),
        ("30m1h", "expected a duration such as 30m, 1h30m or 7d, got '30m1h'"),
        ("-1h", "expected a duration such as 30m, 1h30m or 7d, got '-1h'"),
        ("1.5h", "expected a duration such as 30m, 1h30m or 7d, got '1.5h'"),
        ("\u0663m", "expected a duration such as 30m, 1h30m or 7d, got '\u0663m'"),
        ("0m", "expected a duration above 0 and of at most 366 d, got 0 s"),
        ("367d", "expected a duration above 0 and of at most 366 d, got 367 d"),
    ],
)
def test_durations_of_another_form_are_refused(text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_duration_s(text)
    assert str(caught.value) == problem


def test_a_silence_until_resolved_needs_an_open_alert(history: History, silences: Silences) -> None:
    announce(history, "r4", "battery_level", Level.WARN)
    with pytest.raises(ConfigError, match=r"^no open alert matches robot=r3,signal=battery\*$"):
        silences.add(parse_matchers("robot=r3,signal=battery*"), until_resolved=True)


def test_the_text_gives_reason_and_end(monkeypatch: pytest.MonkeyPatch) -> None:
    until_s = NOON_S + 3600.0
    timed = Silence(1, "robot=r3", "fan is being replaced", "ana", NOON_S, until_s)
    assert timed.text.startswith("fan is being replaced (until 2025-11-22 ")
    acknowledged = Silence(1, "robot=r3", "", "", NOON_S, newest_alert=7)
    assert acknowledged.text == "until resolved"


@pytest.mark.parametrize(
    ("for_s", "until_resolved", "reason", "problem"),
    [
        (None, False, "", "expected a duration, or until resolved; got neither"),
        (float("nan"), False, "", "expected a duration above 0 and of at most 366 d, got nan s"),
        (1e9, False, "", "expected a duration above 0 and of at most 366 d, got 11574 d 1 h"),
        (60.0, False, "a\x1b[2J", "expected a reason of one line, at most 200 characters, got 'a\\x1b[2J'"),
        (60.0, False, "a" * 201, "expected a reason of one line, at most 200 characters, got " + "'" + "a" * 59),
    ],
)
def test_silences_that_are_refused(
    silences: Silences, for_s: float | None, until_resolved: bool, reason: str, problem: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        silences.add(parse_matchers("robot=r3"), for_s=for_s, until_resolved=until_resolved, reason=reason)
    assert str(caught.value) == problem
    assert silences.active() == []


@pytest.mark.parametrize("pattern", ["two\nlines", "\ud800", ""])
def test_a_silence_that_could_not_be_read_again_is_refused(silences: Silences, pattern: str) -> None:
    with pytest.raises(ConfigError, match="expected"):
        silences.add([Matcher("robot", True, pattern)], for_s=60.0)


def test_any_other_pattern_is_stored(silences: Silences) -> None:
    for number, pattern in enumerate(
        ["~r3", "r3, left", "=r3", " r3", "روبوت", "🤖", "[r]", 'a "quoted" name', "a\\b"]
    ):
        silences.add([Matcher("robot", True, pattern)], for_s=60.0)
        assert parse_matchers(silences.active()[number].matchers) == (Matcher("robot", True, pattern),)


def test_the_number_of_active_silences_is_limited(history: History, clock: Clock) -> None:
    def add_many(connection: sqlite3.Connection) -> None:
        for _ in range(1000):
            connection.execute(
                "INSERT INTO silences (matchers, reason, author, created_s, until_s) VALUES ('robot=r3', '', '', ?, ?)",
                (NOON_S, NOON_S + 60.0),
            )

    history.run(add_many)
    silences = Silences(history)
    with pytest.raises(ConfigError, match=r"^there are 1000 active silences, the largest number; expire some first$"):
        silences.add(parse_matchers("robot=r3"), for_s=60.0)
    clock.now_s += 60.0
    assert silences.add(parse_matchers("robot=r3"), for_s=60.0).id == 1001


def test_ended_silences_are_kept_in_a_bounded_number(history: History, silences: Silences, clock: Clock) -> None:
    announce(history, "r3", "link", Level.ERROR)
    kept = silences.add(parse_matchers("robot=r3"), until_resolved=True)
    ended = silences.add(parse_matchers("robot=r3"), for_s=1.0)
    clock.now_s += 1.0
    history.run(lambda connection: connection.execute("UPDATE sqlite_sequence SET seq = 20000 WHERE name = 'silences'"))
    newest = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    assert [silence.id for silence in history.read(read_silences)] == [kept.id, newest.id]
    assert ended.id not in (kept.id, newest.id)


def test_rows_that_cannot_be_read_are_left_out(history: History, silences: Silences, clock: Clock) -> None:
    good = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    on_file(
        history,
        lambda connection: connection.execute(
            "INSERT INTO silences (matchers, reason, author, created_s, until_s) VALUES ('colour=red', '', '', 0, ?)",
            (NOON_S + 60.0,),
        ),
    )
    assert history.read(read_silences) == [good]


def test_open_alerts_are_those_that_were_announced_and_have_not_ended(history: History) -> None:
    announce(history, "r3", "link", Level.STALE)
    announce(history, "r4", "c", Level.WARN)
    announce(history, "r4", "c", Level.ERROR, Level.WARN)
    announce(history, "r4", "d", Level.WARN)
    announce(history, "r4", "d", Level.OK, Level.WARN)
    assert history.run(open_alerts) == {("r3", "link"): 1, ("r4", "c"): 2}


def test_the_changes_that_a_silence_applied_to_are_counted(history: History, silences: Silences, clock: Clock) -> None:
    announce(history, "r3", "battery_level", Level.WARN)
    clock.now_s += 1.0
    silence = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    announce(history, "r3", "battery_level", Level.ERROR, Level.WARN)
    announce(history, "r3", "battery_level", Level.OK, Level.ERROR)
    announce(history, "r3", "link", Level.ERROR)
    announce(history, "r4", "link", Level.ERROR)
    clock.now_s += 60.0
    announce(history, "r3", "temperature", Level.WARN)
    assert history.file is not None
    with reading(history.file) as connection:
        assert silenced_transitions(connection, silence, clock.now_s) == 2
