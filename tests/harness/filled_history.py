"""A history file with rows in every table, and everything that reads one."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from harness.histories import opened, transition
from robot_health_monitor.core import Level
from robot_health_monitor.ops.store import queries
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.silences import open_alerts, read_silences, silence_events, silenced_transitions
from robot_health_monitor.ops.store.summary import summarize

NOW_S = 1_700_000_000.0


def fill_history(path: Path) -> None:
    """Writes the file."""
    history = opened(path, keep_days=30_000.0)
    for number in range(4):
        robot = history.of_robot(f"r{number % 2}")
        level = (Level.WARN, Level.OK)[number // 2]
        state = {"announced": {"level": level.name}}
        robot.record(transition(number, level, robot=f"r{number % 2}"), state, [(NOW_S, 1.0)])
        robot.record_reset()
        robot.record_configuration({"a": {"number": number}})
    silences = Silences(history)
    history.of_robot("r5").record(transition(9, robot="r5"), {"announced": {"level": "WARN"}}, [(NOW_S, 1.0)])
    silences.add(parse_matchers("robot=r5"), until_resolved=True)
    silences.add(parse_matchers("robot=r1"), for_s=60.0)
    history.close()
    opened(path).close()  # a second run


def read_everything(connection: sqlite3.Connection) -> list[str]:
    """Calls every reader; returns the texts of the transitions."""
    found = [*queries.transitions(connection), *queries.transitions(connection, since_s=NOW_S, newest=1000)]
    for each in found:
        queries.transition(connection, each.id)
        queries.evidence(connection, each.id)
    queries.gaps(connection)
    queries.monitor_events(connection)
    summarize(connection, NOW_S * 2.0)
    open_alerts(connection)
    silence_events(connection, NOW_S, robot="r*")
    for silence in read_silences(connection):
        assert silence.text
        silenced_transitions(connection, silence, NOW_S)
    return [each.text for each in queries.transitions(connection)]
