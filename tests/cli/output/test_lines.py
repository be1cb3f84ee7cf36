"""Events as plain lines, on which no robot can forge a line or control the terminal, and as JSON for programs."""

from __future__ import annotations

import io
import json
import tempfile
from pathlib import Path

import pytest
from harness.transitions import transition

from robot_health_monitor.cli.output.events import Entry
from robot_health_monitor.cli.output.lines import JsonLines, PlainLines, plain_line, readable
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity

WARM = transition(text="temperature WARN: 80.5 degC is above 80 degC")

HOSTILE = [
    "\x1b[2J",  # clears the screen
    "\x9b2J",  # the same as one C1 character
    "\x1b]0;title\x07",
    "\n2026-01-01 00:00:00 battery_level OK: forged",
    "\r",
    "\x08\x7f",
    "\u202e",  # right-to-left override
    "\u2066",
    "\u2028",
    "\ud800",
]


def test_a_log_line_names_severity_and_node() -> None:
    line = LogLine(0.0, "/robot1/alert_system", Severity.INFO, "watching")
    assert plain_line(Entry(0.0, line), "at") == "at [INFO] alert_system: watching"


@pytest.mark.parametrize(
    ("encoding", "unit"), [("utf-8", "°C"), ("UTF-8", "°C"), ("ascii", "degC"), ("latin-1", "degC")]
)
def test_the_degree_sign_is_used_where_the_output_is_utf_8(encoding: str, unit: str) -> None:
    with tempfile.TemporaryFile("w+", encoding=encoding) as stream:
        output = PlainLines(stream)
        output.start()
        output.put(Entry(0.0, WARM))
        output.close()
        stream.seek(0)
        assert stream.read().endswith(f" temperature WARN: 80.5 {unit} is above 80 {unit}\n")


def test_an_output_without_an_encoding_keeps_the_unit() -> None:
    assert readable("80.5 degC", io.StringIO()) == "80.5 degC"


def test_a_transition_names_its_robot_where_there_are_several() -> None:
    entry = Entry(0.0, transition(text="battery_level WARN: low", robot="husky"))
    assert plain_line(entry, "at") == "at battery_level WARN: low"
    assert plain_line(entry, "at", name_robots=True) == "at husky: battery_level WARN: low"


def test_the_hint_why_there_are_no_samples_follows_the_text() -> None:
    stale = transition(text="battery STALE: no sample for 6 s", hint="no publisher on /battery")
    assert plain_line(Entry(0.0, stale), "at") == "at battery STALE: no sample for 6 s [no publisher on /battery]"
    silenced = plain_line(Entry(0.0, stale, "repair"), "at")
    assert silenced == "at battery STALE: no sample for 6 s [no publisher on /battery] [silenced: repair]"


def test_a_silenced_transition_is_marked() -> None:
    entry = Entry(0.0, transition(text="battery_level WARN: low"), "fan is being replaced (until resolved)")
    assert plain_line(entry, "at") == "at battery_level WARN: low [silenced: fan is being replaced (until resolved)]"


@pytest.mark.parametrize("text", HOSTILE)
def test_no_text_of_a_robot_controls_the_terminal(text: str) -> None:
    entries = [
        Entry(0.0, transition(text=f"battery{text}", robot=f"husky{text}")),
        Entry(0.0, LogLine(0.0, f"/node{text}", Severity.INFO, f"hello{text}")),
    ]
    for entry in entries:
        line = plain_line(entry, name_robots=True)
        assert line.isprintable() and line.isascii()


def test_transitions_and_the_log_go_to_different_streams(tmp_path: Path) -> None:
    with open(tmp_path / "stream", "w") as stream, open(tmp_path / "log", "w") as log:
        output = JsonLines(stream, log)
        output.start()
        output.put(Entry(0.0, transition()))
        output.put(Entry(0.0, LogLine(1.0, "alert_system", Severity.WARN, "disk slow")))
        output.close()
    assert json.loads((tmp_path / "stream").read_text())["signal"] == "battery_level"
    logged = (tmp_path / "log").read_text()
    assert "disk slow" in logged and "battery_level" not in logged
