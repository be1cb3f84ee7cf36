"""Times that come again: expected values by hand, from a calendar of 2026 and the rules of Berlin's clocks."""

from __future__ import annotations

import os
import sys
from datetime import datetime, timezone

import pytest

from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.store.recurrence import Recurrence, machine_zone, parse_recurrence

BERLIN = "Europe/Berlin"
needs_zones = pytest.mark.skipif(sys.version_info < (3, 9), reason="Python 3.8 has no time zones")


def utc_s(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=timezone.utc).timestamp()


def times(rule: str, begin: str, hours: float, zone: str = "UTC") -> str:
    """Returns which of the hours after a time (UTC) it contains: `x`, else `.`."""
    recurrence = parse_recurrence(rule, zone)
    begin_s = utc_s(begin)
    return "".join("x" if recurrence.contains(begin_s + 3600.0 * n) else "." for n in range(int(hours)))


def changes(rule: Recurrence, begin: str, hours: int) -> list[str]:
    """Returns the times of the day (UTC) within some hours at which it changes, by looking at each second."""
    begin_s = utc_s(begin)
    moments = [begin_s + n for n in range(1, hours * 3600)]
    changed = [now_s for now_s in moments if rule.contains(now_s - 1.0) is not rule.contains(now_s)]
    return [datetime.fromtimestamp(now_s, timezone.utc).strftime("%H:%M:%S") for now_s in changed]


def test_a_time_of_some_days_contains_its_begin_and_not_its_end() -> None:
    rule = parse_recurrence("mon-fri 08:00-10:30", "UTC")
    for time, expected in (("07:59:59", False), ("08:00:00", True), ("10:29:59", True), ("10:30:00", False)):
        assert rule.contains(utc_s(f"2026-11-23 {time}")) is expected, time
    assert not rule.contains(utc_s("2026-11-22 09:00:00"))  # a Sunday


def test_an_end_before_the_begin_is_the_next_day() -> None:
    # Friday 20:00 to Saturday 08:00, and nothing from Saturday evening on.
    assert times("fri 22:00-06:00", "2026-11-27 20:00", 12) == "..xxxxxxxx.."
    assert times("fri 22:00-06:00", "2026-11-28 20:00", 12) == "." * 12


def test_days_are_lists_and_ranges_that_may_wrap() -> None:
    week = [f"2026-11-{day} 12:00" for day in range(23, 30)]  # Monday to Sunday
    for rule, expected in (
        ("11:00-13:00", "xxxxxxx"), ("fri-mon 11:00-13:00", "x...xxx"), ("mon,wed,sat-sun 11:00-13:00", "x.x..xx"),
        ("Tue 11:00-13:00", ".x....."), ("sun-sat 11:00-13:00", "xxxxxxx"), ("tue-tue 11:00-13:00", ".x....."),
    ):  # fmt: skip
        assert "".join(times(rule, noon, 1) for noon in week) == expected, rule


def test_equal_times_are_24_hours() -> None:
    assert times("sat 06:00-06:00", "2026-11-28 04:00", 28) == ".." + "x" * 24 + ".."
    assert times("06:00-06:00", "2026-11-28 04:00", 28) == "x" * 28


@needs_zones
def test_the_clock_of_the_zone_counts_in_summer_and_in_winter() -> None:
    assert times("22:00-23:00", "2026-07-01 18:00", 6, BERLIN) == "..x..."  # UTC+2
    assert times("22:00-23:00", "2026-12-01 18:00", 6, BERLIN) == "...x.."  # UTC+1


@needs_zones
def test_a_time_that_does_not_exist_is_the_next_one_that_does() -> None:
    # On 2026-03-29 the clocks go from 02:00 to 03:00 (01:00 UTC).
    rule = parse_recurrence("02:30-04:00", BERLIN)
    assert changes(rule, "2026-03-29 00:00", 3) == ["01:00:00", "02:00:00"]
    assert changes(parse_recurrence("01:00-02:30", BERLIN), "2026-03-29 00:30", 3) == ["01:00:00"]


@needs_zones
def test_an_ambiguous_time_is_the_first_one() -> None:
    # On 2026-10-25 the clocks go from 03:00 back to 02:00 (01:00 UTC): 02:30 is 00:30 and 01:30 UTC.
    rule = parse_recurrence("02:30-04:00", BERLIN)
    assert changes(rule, "2026-10-24 23:00", 5) == ["00:30:00", "03:00:00"]
    assert changes(parse_recurrence("01:00-02:30", BERLIN), "2026-10-25 00:00", 5) == ["00:30:00"]


@needs_zones
@pytest.mark.parametrize("zone", [BERLIN, "America/New_York", "Australia/Lord_Howe", "UTC"])
def test_it_changes_at_its_times_only(zone: str) -> None:
    rule = parse_recurrence("mon-fri 22:00-06:00", zone)
    begin_s = utc_s("2026-03-20 00:00")
    times_s = [begin_s + 1800.0 * n for n in range(21 * 48)]
    found = [
        (datetime.fromtimestamp(now_s, timezone.utc).astimezone(_zone(zone)).strftime("%a %H:%M"), rule.contains(now_s))
        for before_s, now_s in zip(times_s, times_s[1:])
        if rule.contains(before_s) is not rule.contains(now_s)
    ]
    days = ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat"]
    expected = [change for n in range(5) for change in ((f"{days[n]} 22:00", True), (f"{days[n + 1]} 06:00", False))]
    first = found.index(("Mon 22:00", True))
    assert found[first : first + 20] == expected * 2


def _zone(name: str) -> timezone:
    from zoneinfo import ZoneInfo

    return ZoneInfo(name)  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("rule", "zone", "problem"),
    [
        ("", "UTC", "expected days and times such as"), ("mon-fri", "UTC", "expected days and times such as"),
        ("mon 22:00", "UTC", "expected days and times such as"), ("mon 2:00-6:00", "UTC", "expected days and times"),
        ("monday 22:00-06:00", "UTC", "expected days and times such as"),
        ("mon- 22:00-06:00", "UTC", "expected days and times such as"),
        ("mon 24:00-06:00", "UTC", "expected days and times such as"),
        ("mon 22:00-06:60", "UTC", "expected days and times such as"),
        pytest.param("mon 22:00-06:00", "Mars/Base", "there is no time zone 'Mars/Base'", marks=needs_zones),
        pytest.param("mon 22:00-06:00", "../etc/passwd", "there is no time zone", marks=needs_zones),
    ],
)  # fmt: skip
def test_what_does_not_exist_is_one_clear_line(rule: str, zone: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        parse_recurrence(rule, zone)


def test_the_machine_s_zone_is_the_one_of_tz(monkeypatch: pytest.MonkeyPatch) -> None:
    for given, expected in (
        ("UTC", "UTC"),
        (":Asia/Tokyo", "Asia/Tokyo"),
        ("/usr/share/zoneinfo/Asia/Tokyo", "Asia/Tokyo"),
    ):
        monkeypatch.setenv("TZ", given)
        assert machine_zone() == expected
    monkeypatch.delenv("TZ")
    monkeypatch.setattr(os.path, "realpath", lambda path: "/usr/share/zoneinfo/Europe/Berlin")
    assert machine_zone() == BERLIN
