"""The silences of a running monitor: what it sees of them, and when."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness.silences import NOON_S, Clock, announce, on_file
from harness.waiting import wait_for

from robot_health_monitor.core import Level
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.recurrence import parse_recurrence
from robot_health_monitor.ops.store.silences import add_silence, expire_silence, read_silences


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


def test_a_silence_ends_at_its_wall_time_after_the_clock_was_wrong_for_a_while(
    silences: Silences, clock: Clock
) -> None:
    silence = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    for now_s, is_in_force in (
        (NOON_S - 3600.0, True), (NOON_S - 3601.0, False), (NOON_S + 59.9, True), (NOON_S + 60.0, False),
    ):  # fmt: skip
        clock.now_s = now_s
        assert silences.silence_of("r3", "link") == (silence if is_in_force else None)


def test_a_silence_that_was_made_in_the_future_is_not_in_force(silences: Silences, clock: Clock) -> None:
    clock.now_s = NOON_S + 300 * 86_400.0
    silence = silences.add(parse_matchers("robot=r3"), for_s=600.0)
    clock.now_s = NOON_S
    assert silences.silence_of("r3", "link") is None
    assert silences.active() == [silence]
    assert not silence.in_force(NOON_S)


def test_what_another_process_writes_is_in_force_for_whoever_looks(history: History, clock: Clock) -> None:
    silences = Silences(history)
    history.run(silences.look)
    on_file(history, lambda file: add_silence(file, parse_matchers("robot=r3"), clock.now_s, for_s=60.0))
    assert silences.silence_of("r3", "link") is None
    history.run(silences.look)
    assert silences.silence_of("r3", "link") is not None
    on_file(history, lambda file: expire_silence(file, 1, clock.now_s))
    history.run(silences.look)
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
    silence = Silences(first).add(parse_matchers("robot=r3"), for_s=60.0, reason="fan")
    first.close()
    second = History(settings, wall_time_s=clock)
    assert Silences(second).silence_of("r3", "link") == silence
    second.close()


def test_silences_work_without_a_file(clock: Clock) -> None:
    history = History(None, wall_time_s=clock)
    silences = Silences(history)
    silence = silences.add(parse_matchers("robot=r3"), for_s=60.0)
    assert silences.silence_of("r3", "link") == silence
    history.close()


@pytest.mark.parametrize("statement", ["DROP TABLE silences", "ALTER TABLE silences RENAME COLUMN every TO daily"])
def test_known_silences_stay_in_force_when_their_table_is_altered(
    history: History, clock: Clock, statement: str
) -> None:
    silences = Silences(history)
    announce(history, "r3", "link", Level.WARN)
    limited = silences.add(parse_matchers("robot=r4"), for_s=60.0)
    resolving = silences.add(parse_matchers("robot=r3"), until_resolved=True)
    on_file(history, lambda file: file.execute(statement))
    wait_for(lambda: "history file" in history.faults.current())
    assert (silences.silence_of("r4", "link"), silences.silence_of("r3", "link")) == (limited, resolving)
    assert history.read(read_silences) == [limited, resolving]


def test_a_silence_of_another_process_stays_in_force_when_its_table_is_dropped(tmp_path: Path, clock: Clock) -> None:
    history = History(HistorySettings(str(tmp_path / "history.db")), wall_time_s=clock)
    silences = Silences(history)
    on_file(history, lambda file: add_silence(file, parse_matchers("robot=r3"), clock.now_s, for_s=60.0))
    query = "SELECT matchers FROM mirrored_silences"
    wait_for(lambda: history.run(lambda connection: connection.execute(query).fetchall()) == [("robot=r3",)])
    on_file(history, lambda file: file.execute("DROP TABLE silences"))
    wait_for(lambda: "history file" in history.faults.current())
    assert silences.silence_of("r3", "link") is not None
    assert [silence.matchers for silence in history.read(read_silences)] == ["robot=r3"]
    history.close()


def test_many_silences_and_robots_cost_little(silences: Silences) -> None:
    numbers: list[int] = [silences.add(parse_matchers(f"robot=r{number}"), for_s=60.0).id for number in range(100)]
    found = [silences.silence_of(f"r{number}", "link") for _ in range(50) for number in range(200)]
    assert [silence.id for silence in found[:100] if silence is not None] == numbers
    assert found[100:200] == [None] * 100


def test_a_silence_that_recurs_is_in_force_on_its_days_and_at_its_times_only(silences: Silences, clock: Clock) -> None:
    rule = parse_recurrence("sat 13:00-14:00", "UTC")  # noon of 2025-11-22 is on a Saturday
    silence = silences.add(parse_matchers("robot=r3"), every=rule, for_s=9 * 86_400.0, reason="charging room")
    assert silence.text == "charging room (every sat 13:00-14:00 (UTC), until 2025-12-01 12:00 UTC)"
    week_s = 7 * 86_400.0
    for now_s, in_force in (
        (0.0, False), (3600.0, True), (7199.0, True), (7200.0, False), (3601.0, True), (86_400.0 + 3600.0, False),
        (week_s + 3600.0, True), (week_s + 7200.0, False), (2 * week_s + 3600.0, False),
    ):  # fmt: skip
        clock.now_s = NOON_S + now_s
        assert (silences.silence_of("r3", "link") == silence) is in_force, now_s
        assert silences.active() == ([silence] if now_s < 9 * 86_400.0 else [])


def test_the_silence_of_a_cause_covers_its_effects_as_long_as_they_have_it(silences: Silences) -> None:
    silences.note_causes("r3", {"left_wheel": "driver", "driver": "/can", "odd": "odd"})
    silence = silences.add(parse_matchers("robot=r3,signal=/can"), for_s=60.0)
    found = [silences.silence_of("r3", name) for name in ("/can", "driver", "left_wheel", "right_wheel", "odd")]
    assert found == [silence] * 3 + [None] * 2
    assert silences.silence_of("r4", "driver") is None
    silences.note_causes("r3", {})
    assert silences.silence_of("r3", "driver") is None
