"""Transitions that one configuration announced and another did not."""

from __future__ import annotations

from typing import List, Tuple

from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Level, Status, Transition
from robot_health_monitor.core.outlets import Notice
from robot_health_monitor.recordings.differences import Differences
from robot_health_monitor.recordings.judging import JudgedEvent


def judged(wall_s: float, file: str, level: Level, signal: str = "battery", text: str = "") -> JudgedEvent:
    """Returns a transition from OK, or to OK from WARN."""
    before = Level.WARN if level is Level.OK else Level.OK
    status = Status(signal, level, text, "robot", {})
    transition = Transition(
        signal, before, level, 1.0, "last", None, wall_s, 0.0, "robot", "0123456789abcdef", text, status
    )
    return JudgedEvent(wall_s, file, transition)


def differences(*events: JudgedEvent) -> List[Tuple[float, str]]:
    """Returns time and configuration of the transitions in which a.yaml and b.yaml differ."""
    found: List[Tuple[float, str]] = []
    compared = Differences(["a.yaml", "b.yaml"], lambda event: found.append((event.wall_s, event.file)))
    for event in events:
        compared.add(event)
    compared.flush()
    return found


def test_the_same_transition_of_both_is_no_difference() -> None:
    assert differences(judged(1.0, "a.yaml", Level.WARN), judged(1.0, "b.yaml", Level.WARN)) == []


def test_a_transition_of_one_is_a_difference() -> None:
    assert differences(judged(1.0, "a.yaml", Level.WARN)) == [(1.0, "a.yaml")]


def test_the_same_transition_at_another_time_is_two_differences() -> None:
    found = differences(judged(1.0, "b.yaml", Level.WARN), judged(2.0, "a.yaml", Level.WARN))
    assert found == [(1.0, "b.yaml"), (2.0, "a.yaml")]


def test_another_level_and_another_signal_are_differences() -> None:
    assert len(differences(judged(1.0, "a.yaml", Level.WARN), judged(1.0, "b.yaml", Level.ERROR))) == 2
    assert len(differences(judged(1.0, "a.yaml", Level.WARN), judged(1.0, "b.yaml", Level.WARN, "other"))) == 2


def test_another_text_is_no_difference() -> None:
    first = judged(1.0, "a.yaml", Level.WARN, text="5 % is below 20 %")
    second = judged(1.0, "b.yaml", Level.WARN, text="5 % is below 25 %")
    assert differences(first, second) == []


def test_the_order_of_several_signals_at_one_instant_does_not_matter() -> None:
    events = [
        judged(1.0, "a.yaml", Level.WARN, "one"),
        judged(1.0, "a.yaml", Level.WARN, "two"),
        judged(1.0, "b.yaml", Level.WARN, "two"),
        judged(1.0, "b.yaml", Level.WARN, "one"),
    ]
    assert differences(*events) == []


def test_what_one_announced_twice_and_the_other_once_is_one_difference() -> None:
    once, twice = judged(1.0, "a.yaml", Level.WARN), judged(1.0, "b.yaml", Level.WARN)
    assert differences(once, twice, twice) == [(1.0, "b.yaml")]


def test_notices_are_not_compared() -> None:
    assert differences(JudgedEvent(1.0, "a.yaml", Notice(1.0, Severity.INFO, "time went back"))) == []
