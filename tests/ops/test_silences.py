"""Silences: which alerts they match, how long they last, and what the running monitor sees of them."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, Callable, Iterator, List, Optional

import pytest
from harness.waiting import wait_for

from robot_health_monitor.core import Level
from robot_health_monitor.core.errors import ConfigError, ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Status, Transition
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.history.history import History
from robot_health_monitor.ops.history.reader import HistoryReader
from robot_health_monitor.ops.matchers import Matcher, parse_matchers
from robot_health_monitor.ops.silences import (
    Silence,
    Silences,
    add_silence,
    expire_silence,
    open_alerts,
    parse_duration_s,
    read_silences,
    silenced_transitions,
)

NOON_S = 1_763_812_800.0
"""2025-11-22 12:00 UTC."""


class Clock:
    """A wall clock that can be set."""

    def __init__(self) -> None:
        self.now_s = NOON_S

    def __call__(self) -> float:
        return self.now_s


def change(robot: str, signal: str, to_level: Level, from_level: Level = Level.OK) -> Transition:
    status = Status(signal, to_level, "", robot, {})
    return Transition(
        signal=signal, from_level=from_level, to_level=to_level, value=1.0, statistic="last", bound=None, now_s=1.0,
        since_s=0.0, robot=robot, fingerprint="f", text=f"{signal} {to_level.name}", status=status,
    )  # fmt: skip


def announce(history: History, robot: str, signal: str, to_level: Level, from_level: Level = Level.OK) -> None:
    """Stores a transition as alert_system does."""
    saved = {"announced": {"level": to_level.name}}
    history.of_robot(robot, Faults()).record(change(robot, signal, to_level, from_level), saved, [])


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def history(tmp_path: Path, clock: Clock) -> Iterator[History]:
    opened = History(HistorySettings(str(tmp_path / "history.db")), wall_time_s=clock)
    yield opened
    opened.close()


@pytest.fixture
def silences(history: History, clock: Clock) -> Iterator[Silences]:
    opened = Silences(history, Faults(), wall_time_s=clock)
    yield opened
    opened.close()


def on_file(history: History, function: Callable[[sqlite3.Connection], object]) -> None:
    """Changes the file as another process does."""
    assert history.file is not None
    connection = sqlite3.connect(history.file, timeout=5.0)
    with connection:
        function(connection)
    connection.close()


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


def test_an_alert_is_silenced_until_the_time_is_over(silences: Silences, clock: Clock) -> None:
    silence = silences.add(parse_matchers("robot=r3,signal=battery*"), for_s=7200.0, reason="fan", author="ana")
    assert silences.silence_of("r3", "battery_level") == silence
    assert silences.silence_of("r3", "temperature") is None
    assert silences.silence_of("r4", "battery_level") is None
    assert silences.active() == [silence]
    clock.now_s += 7199.9
    assert silences.silence_of("r3", "battery_level") == silence
    clock.now_s += 0.1
    assert silences.silence_of("r3", "battery_level") is None
    assert silences.active() == []


def test_a_silence_ends_at_its_wall_time_when_the_clock_is_set(silences: Silences, clock: Clock) -> None:
    silence = silences.add(parse_matchers("robot=*"), for_s=60.0)
    clock.now_s -= 3600.0
    assert silences.silence_of("r3", "link") == silence
    clock.now_s += 3660.0
    assert silences.silence_of("r3", "link") is None


def test_of_several_silences_the_one_that_ends_last_is_shown(silences: Silences, clock: Clock) -> None:
    silences.add(parse_matchers("robot=r3"), for_s=60.0, reason="short")
    silences.add(parse_matchers("robot=*"), for_s=600.0, reason="long")
    silences.add(parse_matchers("signal=*"), for_s=60.0, reason="short too")
    found = silences.silence_of("r3", "link")
    assert found is not None
    assert found.reason == "long"


def test_a_silence_until_resolved_applies_to_the_alerts_that_are_open(history: History, silences: Silences) -> None:
    announce(history, "r3", "battery_level", Level.WARN)
    announce(history, "r4", "battery_level", Level.ERROR)
    announce(history, "r4", "link", Level.ERROR)
    announce(history, "r4", "link", Level.OK, Level.ERROR)
    silence = silences.add(parse_matchers("robot=*"), until_resolved=True)
    assert silence.alerts == {("r3", "battery_level"), ("r4", "battery_level")}
    assert silences.silence_of("r3", "battery_level") == silence
    assert silences.silence_of("r4", "link") is None
    announce(history, "r3", "temperature", Level.WARN)
    assert silences.silence_of("r3", "temperature") is None  # it was not open


def test_a_silence_until_resolved_ends_with_its_last_alert(history: History, silences: Silences) -> None:
    announce(history, "r3", "battery_level", Level.WARN)
    announce(history, "r3", "temperature", Level.WARN)
    silence = silences.add(parse_matchers("robot=r3"), until_resolved=True)
    announce(history, "r3", "battery_level", Level.ERROR, Level.WARN)
    assert silences.silence_of("r3", "battery_level") is not None  # a change of level is the same alert
    announce(history, "r3", "battery_level", Level.OK, Level.ERROR)
    announce(history, "r3", "battery_level", Level.WARN)
    assert silences.silence_of("r3", "battery_level") is None  # a new alert
    assert silences.silence_of("r3", "temperature") is not None
    announce(history, "r3", "temperature", Level.OK, Level.WARN)
    assert silences.active() == []
    (stored,) = history.read(read_silences)
    assert (stored.id, stored.ended_s) == (silence.id, NOON_S)


def test_a_silence_until_resolved_needs_an_open_alert(history: History, silences: Silences) -> None:
    announce(history, "r4", "battery_level", Level.WARN)
    with pytest.raises(ConfigError, match=r"^no open alert matches robot=r3,signal=battery\*$"):
        silences.add(parse_matchers("robot=r3,signal=battery*"), until_resolved=True)


def test_with_a_duration_too_a_silence_until_resolved_ends_with_what_comes_first(
    history: History, silences: Silences, clock: Clock
) -> None:
    announce(history, "r3", "battery_level", Level.WARN)
    silences.add(parse_matchers("robot=r3"), for_s=60.0, until_resolved=True)
    clock.now_s += 60.0
    assert silences.silence_of("r3", "battery_level") is None


def test_one_silence_is_expired_by_its_id(silences: Silences) -> None:
    first = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    second = silences.add(parse_matchers("robot=r4"), for_s=60.0)
    silences.expire(first.id)
    assert silences.active() == [second]
    assert silences.silence_of("r3", "link") is None
    with pytest.raises(ConfigError, match=r"^silence 1 has ended already, at "):
        silences.expire(first.id)
    with pytest.raises(ConfigError, match=r"^there is no silence 77$"):
        silences.expire(77)


def test_what_another_process_writes_is_in_force_soon(history: History, silences: Silences, clock: Clock) -> None:
    on_file(history, lambda connection: add_silence(connection, parse_matchers("robot=r3"), clock.now_s, for_s=60.0))
    wait_for(lambda: silences.silence_of("r3", "link") is not None)
    on_file(history, lambda connection: expire_silence(connection, 1, clock.now_s))
    wait_for(lambda: silences.silence_of("r3", "link") is None)


def test_silences_survive_a_restart(tmp_path: Path, clock: Clock) -> None:
    settings = HistorySettings(str(tmp_path / "history.db"))
    first = History(settings, wall_time_s=clock)
    silence = Silences(first, wall_time_s=clock).add(parse_matchers("robot=r3"), for_s=60.0, reason="fan")
    first.close()
    second = History(settings, wall_time_s=clock)
    assert Silences(second, wall_time_s=clock).silence_of("r3", "link") == silence
    second.close()


def test_silences_work_without_a_file(clock: Clock) -> None:
    history = History(None, wall_time_s=clock)
    silences = Silences(history, wall_time_s=clock)
    silence = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    assert silences.silence_of("r3", "link") == silence
    history.close()


class UnreadableHistory:
    """A history whose file cannot be read while `problem` is set."""

    def __init__(self, history: History) -> None:
        self.file = history.file
        self.run = history.run
        self.on_record = history.on_record
        self.problem = ""
        self._history = history

    def read(self, function: Callable[[sqlite3.Connection], Any], timeout_s: float = 5.0) -> Any:
        if self.problem:
            raise ServiceError(self.problem)
        return self._history.read(function, timeout_s)


def test_while_the_file_cannot_be_read_the_last_known_silences_stay_in_force(history: History, clock: Clock) -> None:
    unreadable, faults = UnreadableHistory(history), Faults()
    silences = Silences(unreadable, faults, wall_time_s=clock)
    silence = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    unreadable.problem = "history: no answer within 2 s"
    wait_for(lambda: "silence list" in faults.current())
    assert faults.current()["silence list"].text == (
        "cannot be read, the last known ones stay in force: history: no answer within 2 s"
    )
    assert silences.silence_of("r3", "link") == silence
    unreadable.problem = ""
    wait_for(lambda: not faults.current())
    silences.close()


def test_the_text_gives_reason_and_end(monkeypatch: pytest.MonkeyPatch) -> None:
    matchers = parse_matchers("robot=r3")
    until_s = NOON_S + 3600.0
    timed = Silence(1, matchers, "fan is being replaced", "ana", NOON_S, until_s, None, None)
    assert timed.text.startswith("fan is being replaced (until 2025-11-22 ")
    acknowledged = Silence(1, matchers, "", "", NOON_S, None, frozenset({("r3", "link")}), None)
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
    silences: Silences, for_s: Optional[float], until_resolved: bool, reason: str, problem: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        silences.add(parse_matchers("robot=r3"), for_s=for_s, until_resolved=until_resolved, reason=reason)
    assert str(caught.value) == problem
    assert silences.active() == []


@pytest.mark.parametrize("pattern", ['a "quoted" name', "two\nlines", "\ud800", ""])
def test_a_silence_that_could_not_be_read_again_is_refused(silences: Silences, pattern: str) -> None:
    with pytest.raises(ConfigError, match="expected"):
        silences.add([Matcher("robot", True, pattern)], for_s=60.0)


def test_any_other_pattern_is_stored(silences: Silences) -> None:
    for number, pattern in enumerate(["~r3", "r3, left", "=r3", " r3", "روبوت", "🤖", "[r]"]):
        silences.add([Matcher("robot", True, pattern)], for_s=60.0)
        assert silences.active()[number].matchers == (Matcher("robot", True, pattern),)


def test_the_number_of_active_silences_is_limited(history: History, clock: Clock) -> None:
    def add_many(connection: sqlite3.Connection) -> None:
        for _ in range(1000):
            connection.execute(
                "INSERT INTO silences (matchers, reason, author, created_s, until_s, until_resolved) "
                "VALUES ('robot=r3', '', '', ?, ?, 0)",
                (NOON_S, NOON_S + 60.0),
            )

    history.run(add_many)
    silences = Silences(history, wall_time_s=clock)
    with pytest.raises(ConfigError, match=r"^there are 1000 active silences, the largest number; expire some first$"):
        silences.add(parse_matchers("robot=r3"), for_s=60.0)
    clock.now_s += 60.0
    assert silences.add(parse_matchers("robot=r3"), for_s=60.0).id == 1001
    silences.close()


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
            "INSERT INTO silences (matchers, reason, author, created_s, until_s, until_resolved) "
            "VALUES ('colour=red', '', '', 0, ?, 0)",
            (NOON_S + 60.0,),
        ),
    )
    assert history.read(read_silences) == [good]


def test_open_alerts_come_from_the_states_of_the_signals(history: History) -> None:
    announce(history, "r3", "link", Level.STALE)
    robot = history.of_robot("r4", Faults())
    robot.save({"a": {"announced": {"level": "OK"}}, "b": {}, "c": {"announced": {"level": "WARN"}}})
    robot.save({"d": {"announced": {"level": "PURPLE"}}, "e": {"announced": 3}})
    assert history.run(open_alerts) == {("r3", "link"): Level.STALE, ("r4", "c"): Level.WARN}


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
    with HistoryReader(history.file) as reader:
        assert silenced_transitions(reader.connection, silence, clock.now_s) == 2


def test_many_silences_and_robots_cost_little(silences: Silences) -> None:
    numbers: List[int] = [silences.add(parse_matchers(f"robot=r{number}"), for_s=60.0).id for number in range(100)]
    found = [silences.silence_of(f"r{number}", "link") for _ in range(50) for number in range(200)]
    assert [silence.id for silence in found[:100] if silence is not None] == numbers
    assert found[100:200] == [None] * 100
