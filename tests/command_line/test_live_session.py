"""A session runs monitors and shows them, and ends cleanly whatever fails; the choice of the output."""

from __future__ import annotations

import asyncio
import io
import sys
from contextlib import asynccontextmanager
from typing import Any, AsyncIterator, Awaitable, Callable, List, Optional

import pytest
from harness.transitions import transition

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.live_session import choose_output, run_session
from robot_health_monitor.output.events import Events
from robot_health_monitor.output.lines import JsonLines, OutputError, PlainLines
from robot_health_monitor.reloading import Reloads


class Watched:
    robots = ()
    alert_systems = ()
    system_health = None

    def __init__(self) -> None:
        self.faults = Faults()
        self.closed = False
        self.reloads = 0

    async def reload(self) -> str:
        self.reloads += 1
        return ""

    def close(self) -> None:
        self.closed = True


class Output:
    def __init__(self) -> None:
        self.calls: List[str] = []
        self.reader_is_gone = False
        self.problem = ""
        self.on_show: Callable[[], object] = lambda: None

    def start(self) -> None:
        self.calls.append("start")

    def put(self, entry: object) -> None:
        self.calls.append("put")

    def show(self, shown: object) -> None:
        self.calls.append("show")
        self.on_show()

    def close(self) -> None:
        self.calls.append("close")


class Interrupts:
    """SIGINT and SIGHUP, as calls."""

    def __init__(self) -> None:
        self.interrupt: Callable[[], object] = lambda: None
        self.hang_up: Callable[[], object] = lambda: None

    def on_interrupt(self, callback: Callable[[], object]) -> None:
        self.interrupt = callback

    def on_hangup(self, callback: Callable[[], object]) -> None:
        self.hang_up = callback


class Session:
    """One session, with what it was given."""

    def __init__(self) -> None:
        self.watched, self.output, self.interrupts = Watched(), Output(), Interrupts()
        self.events = Events(self.output.put)
        self.left = False

    def run(self, work: Callable[[], Awaitable[Any]], duration_s: Optional[float] = None) -> bool:
        @asynccontextmanager
        async def entered() -> AsyncIterator[Awaitable[Any]]:
            try:
                yield work()
            finally:
                self.left = True

        reloads = Reloads(lambda severity, text: None)
        reloads.add(self.watched.reload)
        return run_session(self.watched, entered(), self.events, self.output, self.interrupts, reloads, duration_s)

    def assert_closed(self) -> None:
        assert self.left and self.watched.closed
        assert self.output.calls[-1] == "close"


async def endless() -> None:
    await asyncio.Event().wait()


@pytest.mark.parametrize("alerts", [True, False])
def test_a_duration_ends_it_with_whether_there_were_alerts(alerts: bool) -> None:
    session = Session()

    async def work() -> None:
        if alerts:
            session.events.on_transition(transition())
        await endless()

    assert session.run(work, 0.05) is alerts
    session.assert_closed()


def test_an_interrupt_ends_it_without_a_judgement() -> None:
    session = Session()

    async def work() -> None:
        session.events.on_transition(transition())
        session.interrupts.interrupt()
        await endless()

    assert session.run(work, 1000.0) is False
    session.assert_closed()


def test_a_hangup_reloads_the_configuration() -> None:
    session = Session()

    async def work() -> None:
        session.interrupts.hang_up()
        while not session.watched.reloads:
            await asyncio.sleep(0)
        session.interrupts.interrupt()
        await endless()

    assert session.run(work, 1000.0) is False
    assert session.watched.reloads == 1


def test_a_reader_that_is_gone_ends_it() -> None:
    session = Session()
    session.output.on_show = lambda: setattr(session.output, "reader_is_gone", True)
    assert session.run(endless) is False
    session.assert_closed()


def test_an_error_of_the_work_closes_everything_and_comes_out() -> None:
    session = Session()

    async def work() -> None:
        raise KeyError("bug")

    with pytest.raises(KeyError):
        session.run(work)
    session.assert_closed()


def test_an_error_at_the_start_comes_before_any_output() -> None:
    session = Session()

    @asynccontextmanager
    async def fails() -> AsyncIterator[Awaitable[Any]]:
        raise ValueError("port in use")
        yield endless()

    with pytest.raises(ValueError):
        run_session(
            session.watched, fails(), session.events, session.output, session.interrupts, Reloads(lambda *line: None)
        )
    assert session.output.calls == ["close"] and session.watched.closed


def test_an_output_that_cannot_be_written_is_a_fault_until_it_can() -> None:
    session = Session()
    faults = session.watched.faults
    assert faults is not None
    seen: List[List[str]] = []
    problems = iter(["", "the output cannot be written: full", "the output cannot be written: full", "", ""])

    def on_show() -> None:
        seen.append([f"{part}: {fault.text}" for part, fault in faults.current().items()])
        try:
            session.output.problem = next(problems)
        except StopIteration:
            session.output.reader_is_gone = True

    session.output.on_show = on_show
    session.run(endless)
    full = ["output: the output cannot be written: full"]
    assert seen == [[], [], full, full, [], []]


def test_a_judgement_without_its_output_is_an_error() -> None:
    session = Session()
    session.output.problem = "the output cannot be written: full"
    with pytest.raises(OutputError, match="full"):
        session.run(endless, 0.05)
    session.assert_closed()


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
