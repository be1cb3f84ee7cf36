"""Events are stamped with wall time, filtered and counted on their way to the output."""

from __future__ import annotations

import logging

from harness.transitions import transition

from robot_health_monitor.cli.output.events import Entry, Events
from robot_health_monitor.core import Level
from robot_health_monitor.core.nodes.outlets import Notice
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity


def test_only_transitions_away_from_ok_count_as_alerts() -> None:
    events = Events(lambda entry: None)
    for level in (Level.WARN, Level.ERROR, Level.STALE, Level.OK):
        events.on_transition(transition(to_level=level))
    assert events.alerts == 3


def test_quiet_log_lines_are_left_out_and_transitions_never() -> None:
    entries: list[Entry] = []
    events = Events(entries.append, Severity.ERROR, wall_time_s=lambda: 5.0)
    loud = LogLine(1.0, "/battery_sensor", Severity.ERROR, "no battery")
    events.on_log(loud)
    events.on_log(LogLine(2.0, "/battery_sensor", Severity.WARN, "slow"))
    outlet = events.outlet("alert_system")
    outlet(Notice(2.0, Severity.INFO, "time went back by 3 s"))
    outlet(transition(to_level=Level.OK))
    assert entries == [Entry(5.0, loud), Entry(5.0, transition(to_level=Level.OK))]


def test_entries_have_the_silence_of_their_signal() -> None:
    entries: list[Entry] = []
    silences = {("r3", "temperature"): "fan"}
    events = Events(entries.append, silence_of=lambda *of: silences.get(of), wall_time_s=lambda: 5.0)
    events.on_transition(transition(robot="r3", signal="temperature"))
    events.on_transition(transition(robot="r4", signal="temperature"))
    assert [entry.silenced for entry in entries] == ["fan", None]


def test_a_notice_becomes_a_log_line_of_its_node() -> None:
    entries: list[Entry] = []
    Events(entries.append, wall_time_s=lambda: 5.0).outlet("husky")(Notice(2.0, Severity.WARN, "server: off"))
    assert entries == [Entry(5.0, LogLine(2.0, "husky", Severity.WARN, "server: off"))]


def test_each_entry_has_the_wall_time_of_its_moment_even_after_the_clock_was_set() -> None:
    times = iter([100.0, 1_700_000_000.0])  # the second after NTP has set the clock
    entries: list[Entry] = []
    events = Events(entries.append, wall_time_s=lambda: next(times))
    events.on_transition(transition(now_s=7.0))
    events.on_transition(transition(now_s=8.0))
    assert [entry.wall_s for entry in entries] == [100.0, 1_700_000_000.0]


def test_what_a_library_logs_is_one_line_without_a_traceback() -> None:
    entries: list[Entry] = []
    handler = Events(entries.append)
    try:
        raise ValueError("bad frame")
    except ValueError:
        record = logging.getLogger("asyncio").makeRecord(
            "asyncio", logging.ERROR, "file", 1, "task failed\nin %s", ("loop",), __import__("sys").exc_info()
        )
    handler.emit(record)
    line = entries[0].event
    assert isinstance(line, LogLine)
    assert (line.node, line.severity, line.text) == ("asyncio", Severity.ERROR, "task failed: ValueError: bad frame")
