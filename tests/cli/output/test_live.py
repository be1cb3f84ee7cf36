"""`robot-health run` on a terminal: the live table, and what it leaves behind."""

from __future__ import annotations

import io
import os
import re
import signal
from pathlib import Path
from typing import Any, Callable

import pytest

Start = Callable[..., Any]


@pytest.fixture(autouse=True)
def _needs_rich() -> None:
    pytest.importorskip("rich", reason="rich, which draws the table, is not installed")


def test_the_table_shows_value_unit_level_and_statistics_of_every_signal(on_terminal: Start, calm: Path) -> None:
    terminal = on_terminal("run", "--thresholds", calm, columns=120)
    terminal.wait_until(lambda text: re.search(r"cpu_usage +OK +[\d.]+ % +[\d.]+ ", text) is not None)
    table = terminal.rows[-5:]
    assert re.match(r"atlas is OK ", table[0])
    assert table[1].split() == ["signal", "level", "value", "bounds", "mean", "min", "max"]
    assert re.match(r"battery_level  OK +[\d.]+ % +WARN below 20 % +[\d.]+ +[\d.]+ +100", table[2])
    assert re.match(r"temperature +OK +[\d.]+ °C +[\d.]+ +[\d.]+ +[\d.]+", table[3])


@pytest.mark.newest_python
def test_alerts_scroll_by_above_one_single_table(on_terminal: Start, restless: Path) -> None:
    terminal = on_terminal("run", "--thresholds", restless, "--log-level", "ERROR")
    # A frame arrives in pieces; the table's last line is the end of it.
    terminal.wait_until(
        lambda text: text.count("battery_level ERROR: ") >= 2 and terminal.rows[-1].startswith("battery_level ")
    )
    assert re.match(r"\d\d:\d\d:\d\d battery_level WARN: [\d.]+ % is below 80 % \(was OK for ", terminal.rows[0])
    assert terminal.text.count("signal ") == 1


def word_colours(terminal: Any, row: int) -> dict[str, str]:
    """Returns the words of a row that are coloured, with their colour."""
    cells = [terminal.screen.buffer[row][column] for column in range(80)]
    colours = [cell.bg if cell.bg != "default" else cell.fg for cell in cells]
    words = {}
    for colour in set(colours) - {"default"}:
        words["".join(cell.data for cell, found in zip(cells, colours) if found == colour)] = colour
    return words


def test_only_the_word_of_the_level_is_coloured(on_terminal: Start, restless: Path) -> None:
    terminal = on_terminal("run", "--thresholds", restless)
    terminal.wait_until(lambda text: "battery_level ERROR: " in text)
    row = next(number for number, text in enumerate(terminal.screen.display) if "battery_level WARN: " in text)
    assert word_colours(terminal, row) == {"WARN": "brightbrown"}  # the background; brown is what pyte calls yellow
    row = next(number for number, text in enumerate(terminal.screen.display) if "battery_level ERROR: " in text)
    assert word_colours(terminal, row) == {"ERROR": "red"}


@pytest.mark.newest_python
def test_no_color_is_respected(on_terminal: Start, restless: Path) -> None:
    terminal = on_terminal("run", "--thresholds", restless, NO_COLOR="1")
    terminal.wait_until(lambda text: "battery_level ERROR: " in text)
    assert {cell.fg for line in terminal.screen.buffer.values() for cell in line.values()} == {"default"}


@pytest.mark.parametrize("end", ["\x03", signal.SIGTERM, signal.SIGINT])
def test_the_end_leaves_the_last_table_and_the_cursor_below_it(on_terminal: Start, calm: Path, end: Any) -> None:
    terminal = on_terminal("run", "--thresholds", calm, columns=110)
    terminal.wait_until(lambda text: re.search(r"cpu_usage +OK +[\d.]+ %", text) is not None)
    terminal.type(end) if isinstance(end, str) else terminal.signal(end)
    assert terminal.wait() == 0
    assert not terminal.screen.cursor.hidden
    assert terminal.screen.cursor.x == 0
    assert terminal.screen.display[terminal.screen.cursor.y].strip() == ""
    assert terminal.rows[-1].startswith("cpu_usage ")
    assert "Traceback" not in terminal.text


def test_a_duration_leaves_the_terminal_as_cleanly(on_terminal: Start, restless: Path) -> None:
    terminal = on_terminal("run", "--thresholds", restless, "--duration", "1.5")
    assert terminal.wait() == 1
    assert not terminal.screen.cursor.hidden


@pytest.mark.newest_python
def test_a_narrow_terminal_gets_a_narrow_table(on_terminal: Start, calm: Path) -> None:
    terminal = on_terminal("run", "--thresholds", calm, "--log-level", "ERROR", columns=40, lines=10)
    terminal.wait_until(lambda text: re.search(r"cpu_usage +OK +[\d.]+ %", text) is not None)
    assert len(terminal.rows) == 5
    assert terminal.rows[1].split() == ["signal", "level", "value"]


@pytest.mark.newest_python
def test_a_terminal_with_few_lines_shows_the_worst_signals(on_terminal: Start, tmp_path: Path) -> None:
    names = [f"signal_{number:02}" for number in range(30)]
    quiet = "".join(f"      {name}: {{startup_grace_s: 1000.0}}\n" for name in names)
    file = tmp_path / "many.yaml"
    file.write_text(
        "alert_system:\n  ros__parameters:\n    signals:\n" + quiet + "      cpu_usage: {warn_below: 101.0}\n"
        "battery_sensor:\n  ros__parameters: {publish_rate: 20.0}\n"
    )
    terminal = on_terminal("run", "--thresholds", file, "--log-level", "ERROR", lines=10)
    # of 31, six in ten lines: title, header, the line that counts the others and one for alerts
    warned = re.compile(r"^cpu_usage +WARN +[\d.]+ is below 101", re.MULTILINE)
    terminal.wait_until(lambda text: warned.search(text) is not None and terminal.rows[-1] == "and 25 more: 25 unknown")
    table = [row for row in terminal.rows if row.startswith(("cpu_usage ", "signal_"))]
    assert len(table) == 6


def test_the_table_follows_a_window_that_changes_its_size(on_terminal: Start, calm: Path) -> None:
    terminal = on_terminal("run", "--thresholds", calm, "--log-level", "ERROR")
    terminal.wait_until(lambda text: re.search(r"cpu_usage +OK +[\d.]+ %", text) is not None)
    assert "bounds" in terminal.text
    terminal.resize(40, 12)
    terminal.wait_until(lambda text: "bounds" not in text and "cpu_usage" in text)
    terminal.resize(120, 30)
    terminal.wait_until(lambda text: "mean" in text and "cpu_usage" in text)
    assert terminal.text.count("battery_level") == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_terminal_that_is_not_read_stops_neither_the_monitoring_nor_the_end(
    on_terminal: Start, robot_health: Start, restless: Path, free_port: int, number: int
) -> None:
    terminal = on_terminal("run", "--thresholds", restless, "--port", free_port, full=True)
    watcher = robot_health("connect", f"ws://127.0.0.1:{free_port}", "--thresholds", restless)
    for _ in range(2):  # two whole cycles of the battery
        watcher.wait_for_text("battery_level ERROR: ")
        watcher.wait_for_text("battery_level OK: ")
    terminal.signal(number)
    assert terminal.wait_unread() == 0


@pytest.mark.newest_python
def test_a_robot_cannot_control_the_terminal(on_terminal: Start, tmp_path: Path) -> None:
    file = tmp_path / "hostile.yaml"
    file.write_text(
        "alert_system:\n  ros__parameters:\n"
        '    signals: {cpu_usage: {unit: "[red]%[/red]", warn_below: 101.0}}\n'
        "battery_sensor:\n  ros__parameters: {publish_rate: 20.0}\n"
    )
    terminal = on_terminal("run", "--thresholds", file, columns=120)
    terminal.wait_until(
        lambda text: "WARN" in text and re.search(r"cpu_usage +WARN +[\d.]+ \[red\]%\[/red\]", text) is not None
    )


@pytest.mark.newest_python
def test_json_on_a_terminal_is_json(on_terminal: Start, restless: Path) -> None:
    terminal = on_terminal("run", "--thresholds", restless, "--json", columns=1000)
    terminal.wait_until(lambda text: '{"signal": "battery_level", "from_level": "OK", "to_level": "WARN"' in text)
    assert b"\x1b" not in terminal.bytes


@pytest.mark.newest_python
@pytest.mark.parametrize("variables", [{"TERM": "dumb"}, {"TERM": ""}])
def test_a_terminal_that_cannot_move_its_cursor_gets_plain_lines(
    on_terminal: Start, restless: Path, variables: Any
) -> None:
    terminal = on_terminal("run", "--thresholds", restless, **variables)
    terminal.wait_until(lambda text: "battery_level WARN: " in text)
    assert b"\x1b" not in terminal.bytes


def test_without_rich_there_are_plain_lines_and_a_hint(on_terminal: Start, restless: Path, tmp_path: Path) -> None:
    (tmp_path / "rich.py").write_text("raise ModuleNotFoundError(\"No module named 'rich'\", name='rich')\n")
    root = str(Path(__file__).resolve().parents[3])
    terminal = on_terminal("run", "--thresholds", restless, PYTHONPATH=os.pathsep.join([str(tmp_path), root]))
    terminal.wait_until(lambda text: "battery_level WARN: " in text)
    assert terminal.rows[0].startswith("rich is not installed: pip install rich (plain lines instead of")
    assert b"\x1b" not in terminal.bytes


@pytest.mark.newest_python
def test_an_ascii_terminal_gets_ascii(on_terminal: Start, calm: Path) -> None:
    terminal = on_terminal("run", "--thresholds", calm, PYTHONIOENCODING="ascii")
    terminal.wait_until(lambda text: re.search(r"cpu_usage +OK +[\d.]+ %", text) is not None)
    assert terminal.bytes.isascii()
    assert b"\\u" not in terminal.bytes


def draw(statuses: list[Any], width: int, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Returns the lines of one frame of a terminal of `width` columns, without colours."""
    from rich.console import Console

    from robot_health_monitor.cli.output import live

    monkeypatch.setenv("TERM", "xterm")
    stream = io.StringIO()
    console = Console(file=stream, width=width, height=40, force_terminal=True, highlight=False)
    console.print(live.drawn(live.robot_view("atlas", statuses, {}), console))
    return re.sub("\x1b\\[[0-9;?]*[A-Za-z]", "", stream.getvalue()).strip("\n").split("\n")


def status(name: str, level: int, message: str, state: str = "", **values: str) -> Any:
    from robot_health_monitor.core import Level, Status

    return Status(name, Level(level), message, "atlas", {"value": "19.5", "unit": "%", **values}, state=state)


@pytest.mark.parametrize("state", ["waiting", "unreachable"])
def test_an_unknown_level_looks_like_neither_ok_nor_an_alarm(state: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = draw([status("a", 0, "OK"), status("b", 3, "no sample yet", state=state)], 80, monkeypatch)
    assert rows[0].startswith(f"atlas is {state}")
    assert re.match(rf"b +{state}  no sample yet", rows[3])
    assert not re.search(r"\b(STALE|OK|ERROR)\b", rows[3])


def test_a_monitor_without_a_signal_is_not_ok_and_says_what_to_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for statuses in ([], [status("link", 0, "up")]):
        rows = draw(statuses, 80, monkeypatch)
        assert rows[0].startswith("atlas is not watched")
        assert rows[1:] == ["no signal is watched: run `robot-health init`"]
    assert draw([status("link", 2, "down: refused")], 80, monkeypatch)[0].startswith("atlas is ERROR")


def test_an_alarm_counts_more_than_an_unknown_level(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = draw(
        [status("a", 1, "19.5 % is below 20 %"), status("b", 3, "no sample yet", state="waiting")], 80, monkeypatch
    )
    assert rows[0].startswith("atlas is WARN")


@pytest.mark.parametrize("width", [80, 100, 140])
def test_the_reason_of_an_alarm_is_shown_in_full(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    reason = "19.5 % is below 20 %, for 3 s"
    rows = draw([status("battery_level", 1, reason), status("cpu", 0, "OK")], width, monkeypatch)
    assert rows[2].rstrip().endswith(reason)
    assert max(map(len, rows)) <= width


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_status_of_a_robot_controls_the_terminal_or_breaks_the_table(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    hostile = "x\x1b[2J\x9b2J\n\u202e[bold]"
    rows = draw([status(hostile, 2, hostile, unit=hostile, mean=hostile, state="firing")], width, monkeypatch)
    assert len(rows) == 3
    assert all(row.isprintable() for row in rows)


@pytest.mark.newest_python
@pytest.mark.parametrize("columns", [60, 80])
def test_several_robots_have_a_row_each(on_terminal: Start, calm: Path, columns: int) -> None:
    urls = [f"robot{number}=ws://127.0.0.1:{number}" for number in (1, 2)]
    terminal = on_terminal("connect", *urls, "--thresholds", calm, "--log-level", "ERROR", columns=columns, lines=14)
    terminal.wait_until(lambda text: ("2 robots, worst: robot1 ERROR" in text and "Ctrl-C" in text) or columns < 60)
    terminal.wait_until(lambda text: len(re.findall(r"^robot[12] +ERROR ", text, re.MULTILINE)) == 2)
    reason = "down: connection refused: no server listens on this port"
    assert " ".join(terminal.text.split()).count("no server listens") >= 2
    assert reason.split(":")[1] in terminal.text
    terminal.resize(120, 14)
    terminal.wait_until(lambda text: len(re.findall(rf"^robot[12] +ERROR .*{reason}", text, re.MULTILINE)) == 2)
