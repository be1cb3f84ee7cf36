"""Events as plain lines, on which no robot can forge a line or control the terminal, and as JSON for programs."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import select
import sys
from pathlib import Path
from typing import Any, Iterator, TextIO

import pytest
from harness.transitions import transition
from harness.unread import fill

from robot_health_monitor.cli.output.events import Entry
from robot_health_monitor.cli.output.lines import MOST_EVENTS, JsonLines, Output, plain_line, readable
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity

DEADLINE_S = 30.0
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
def test_the_degree_sign_is_used_where_the_output_is_utf_8(
    encoding: str, unit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open(tmp_path / "out", "w", encoding=encoding) as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        output = Output()
        output.put(Entry(0.0, WARM))  # before the start
        output.start()
        output.close()
    text = (tmp_path / "out").read_text(encoding=encoding)
    assert text.endswith(f" temperature WARN: 80.5 {unit} is above 80 {unit}\n")


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


def test_transitions_and_the_log_go_to_different_streams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open(tmp_path / "stream", "w") as stream, open(tmp_path / "log", "w") as log:
        monkeypatch.setattr(sys, "stdout", stream)
        monkeypatch.setattr(sys, "stderr", log)
        output = JsonLines()
        output.start()
        output.put(Entry(0.0, transition()))
        output.put(Entry(0.0, LogLine(1.0, "alert_system", Severity.WARN, "disk slow")))
        output.close()
    assert json.loads((tmp_path / "stream").read_text())["signal"] == "battery_level"
    logged = (tmp_path / "log").read_text()
    assert "disk slow" in logged and "battery_level" not in logged


@pytest.fixture
def pipe() -> Iterator[tuple[int, TextIO]]:
    """The reading end, and the writing end as a stream."""
    reader, writer = os.pipe()
    with open(writer, "w", encoding="utf-8") as stream:
        yield reader, stream
        with contextlib.suppress(OSError):  # closed by the test
            os.close(reader)


def read_until(file: int, text: str) -> str:
    """Reads until `text` has come."""
    data = b""
    while text.encode() not in data:
        assert select.select([file], [], [], DEADLINE_S)[0], f"{text!r} did not come, but {data!r}"
        data += os.read(file, 65536)
    return data.decode()


def started_output(stream: TextIO, monkeypatch: pytest.MonkeyPatch) -> Output:
    """Returns an output on a stream. Only the test itself can replace pytest's stdout, not a fixture."""
    monkeypatch.setattr(sys, "stdout", stream)
    output = Output()
    output.start()
    return output


def log_line(text: str) -> Entry:
    return Entry(0.0, LogLine(0.0, "node", Severity.INFO, text))


def test_a_reader_that_does_not_read_costs_the_oldest_events_and_no_time(
    pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, stream = pipe
    fill(stream.fileno())
    output = started_output(stream, monkeypatch)
    number = 0
    while not output._events.dropped:
        output.put(log_line(f"line {number} {'x' * 1000}"))
        number += 1
    last = f"line {number} last."
    output.put(log_line(last))  # another one is dropped
    monitors: Any = None
    text = ""
    while last not in text:
        output.show(monitors)
        assert select.select([reader], [], [], DEADLINE_S)[0]
        text += os.read(reader, 65536).decode()
    numbers = [int(each) for each in re.findall(r"line (\d+) ", text)]
    assert "[WARN] output: 2 events dropped: the output was not read\n" in text
    assert numbers[-MOST_EVENTS:] == list(range(number + 1 - MOST_EVENTS, number + 1))
    written = number + 1 - MOST_EVENTS - 2  # into the pipe, before it was full
    assert numbers[:written] == list(range(written)) and len(numbers) == written + MOST_EVENTS
    output.close()


def test_the_end_does_not_wait_for_a_reader_that_does_not_read(
    pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, stream = pipe
    fill(stream.fileno())
    output = started_output(stream, monkeypatch)
    output.put(log_line("lost"))
    output.close()
    assert output.problem == "stdout is not being read: lines may be lost"


def test_a_reader_that_has_left_is_noticed_without_a_write(
    pipe: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, stream = pipe
    output = started_output(stream, monkeypatch)
    assert not output.reader_is_gone
    os.close(reader)
    assert output.reader_is_gone
    output.close()
    assert output.problem == ""
