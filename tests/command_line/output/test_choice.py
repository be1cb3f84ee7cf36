"""The choice of the output for stdout."""

from __future__ import annotations

import io
import sys

import pytest

from robot_health_monitor.output.choice import choose_output
from robot_health_monitor.output.json_lines import JsonLines
from robot_health_monitor.output.plain import PlainLines


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_json_on_request_also_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    assert isinstance(choose_output(as_json=True), JsonLines)


def test_plain_lines_in_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    monkeypatch.setenv("TERM", "xterm")
    assert isinstance(choose_output(as_json=False), PlainLines)


@pytest.mark.parametrize("term", ["", "dumb", "unknown", None])
def test_plain_lines_on_a_terminal_that_cannot_move_its_cursor(term: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Terminal())
    if term is None:
        monkeypatch.delenv("TERM", raising=False)
    else:
        monkeypatch.setenv("TERM", term)
    assert isinstance(choose_output(as_json=False), PlainLines)


def test_a_live_table_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    live = pytest.importorskip("robot_health_monitor.output.live", reason="rich is not installed")
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    assert isinstance(choose_output(as_json=False), live.LiveView)


def test_plain_lines_and_one_line_on_stderr_without_rich(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delitem(sys.modules, "robot_health_monitor.output.live", raising=False)
    monkeypatch.setitem(sys.modules, "rich", None)
    for name in [name for name in sys.modules if name.startswith("rich.")]:
        monkeypatch.setitem(sys.modules, name, None)
    assert isinstance(choose_output(as_json=False), PlainLines)
    written = capsys.readouterr().err
    assert "rich is not installed" in written and written.count("\n") == 1
