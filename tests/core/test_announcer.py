"""Which levels are announced, and when again."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core import Level
from robot_health_monitor.core.announcer import Announcer
from robot_health_monitor.core.signal_config import read_signal
from robot_health_monitor.core.signal_monitor import SignalMonitor

OK, WARN, ERROR, STALE = Level.OK, Level.WARN, Level.ERROR, Level.STALE


def announcer(**settings: Any) -> Announcer:
    return Announcer(read_signal("battery", {"flap_detection": True, **settings}), 0.0)


def announce(under_test: Announcer, level: Level, now_s: float = 1.0) -> Any:
    judgement = SignalMonitor(read_signal("battery", {}), "atlas", 0.0).judgement(now_s)
    return under_test.announce(judgement._replace(level=level, flapping=under_test.flaps.flapping))


def flapping(announced: Level) -> Announcer:
    """An announcer whose signal flaps, with `announced` as the transition that reached the limit."""
    under_test = announcer()
    for number in range(21):
        under_test.flaps.add(WARN if number % 2 else OK)
    assert under_test.flaps.flapping
    announce(under_test, announced)
    return under_test


def test_only_a_change_is_due() -> None:
    assert not announcer().is_due(OK, is_invalid=False)
    assert announcer().is_due(WARN, is_invalid=False)


@pytest.mark.parametrize(
    ("announced", "level", "is_invalid", "due"),
    [
        (WARN, OK, False, False),
        (WARN, ERROR, False, True),
        (WARN, STALE, False, True),
        (WARN, ERROR, True, True),
        (STALE, WARN, False, False),
        (STALE, ERROR, False, True),
        (ERROR, STALE, False, True),
        (OK, WARN, False, True),
    ],
)
def test_flapping_withholds_what_is_not_worse_but_never_stale_or_invalid(
    announced: Level, level: Level, is_invalid: bool, due: bool
) -> None:
    assert flapping(announced).is_due(level, is_invalid=is_invalid) is due


def test_a_worse_level_is_news_only_once() -> None:
    under_test = flapping(WARN)
    announce(under_test, ERROR)
    assert not under_test.is_due(WARN, is_invalid=False)
    announce(under_test, STALE)
    assert not under_test.is_due(ERROR, is_invalid=False)


def test_transitions_chain() -> None:
    under_test = announcer()
    first, second = announce(under_test, WARN, 3.0), announce(under_test, ERROR, 5.0)
    assert (first.from_level, first.to_level, second.from_level, second.to_level) == (OK, WARN, WARN, ERROR)
    assert (first.since_s, second.since_s) == (3.0, 3.0)  # it was never known to be OK


def test_time_in_which_the_level_was_unknown_does_not_count_as_ok() -> None:
    under_test = announcer()  # at 0 s
    under_test.note_known(4.0)
    under_test.note_unknown(6.0)
    under_test.note_unknown(7.0)
    first = announce(under_test, WARN, 10.0)
    assert (first.since_s, first.text[-16:]) == (8.0, "(was OK for 2 s)")


def test_a_level_that_is_not_ok_is_repeated_every_repeat_s() -> None:
    under_test = announcer(repeat_s=10.0)
    assert not under_test.is_repeat_due(100.0)
    announce(under_test, WARN, 100.0)
    assert not under_test.is_repeat_due(109.0)
    assert under_test.is_repeat_due(110.0)
    assert announce(under_test, WARN, 110.0).repeat
    assert not under_test.is_repeat_due(119.0)
