"""A process without ROS: it runs and shows monitors, reloads, and ends cleanly whatever fails."""

from __future__ import annotations

import asyncio
import io
import json
import sys
from pathlib import Path
from typing import Any, Awaitable, Callable

import pytest
from harness.transitions import transition
from harness.virtual_loop import run_in_virtual_time

from robot_health_monitor.cli.exit_codes import ExitCode
from robot_health_monitor.cli.monitor_process import MonitorProcess, Reload, choose_output, reload_all
from robot_health_monitor.cli.output import lines
from robot_health_monitor.cli.output.lines import JsonLines, OutputError
from robot_health_monitor.cli.serving import ServerSettings
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.configuration import ServerOptions


async def endless() -> None:
    await asyncio.Event().wait()


class Watched:
    """Monitors that do what a test says."""

    alert_systems = ()

    def __init__(self) -> None:
        bus = LocalBus(on_log=lambda line: self.lines.append(f"{line.severity.name} {line.text}"))
        self.node = bus.node("monitor")
        self.closed = False
        self.reloads = 0
        self.work: Callable[[], Awaitable[Any]] = endless
        self.lines: list[str] = []

    async def run(self) -> None:
        await self.work()

    async def reload(self) -> str:
        self.reloads += 1
        return "nothing changed"

    def close(self) -> None:
        self.closed = True


class Output:
    def __init__(self) -> None:
        self.calls: list[str] = []
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
    """SIGINT and SIGHUP, as they are noticed."""

    def __init__(self) -> None:
        self.came = False
        self.hung_up = False

    def defer(self) -> None:
        """Does nothing: no signal comes."""


class Session:
    """One process, with what it was given."""

    def __init__(self, ops_file: str = "") -> None:
        self.watched, self.output, self.interrupts = Watched(), Output(), Interrupts()
        stubs: Any = self.output, self.interrupts
        self.process = MonitorProcess(
            *stubs, ops_file=ops_file, name="test", server=ServerOptions(port=0), serves=False
        )

    def run(self, work: Callable[[], Awaitable[Any]] = endless, duration_s: float | None = None) -> ExitCode:
        self.watched.work = work
        watched: Any = self.watched
        with self.process:
            return self.process.run(watched, duration_s)

    def assert_closed(self) -> None:
        assert self.watched.closed
        assert self.output.calls[-1] == "close"


@pytest.mark.parametrize("alerts", [True, False])
def test_a_duration_ends_it_with_whether_there_were_alerts(alerts: bool) -> None:
    session = Session()

    async def work() -> None:
        if alerts:
            session.process.events.on_transition(transition())
        await endless()

    assert session.run(work, 0.05) is (ExitCode.ALERTS if alerts else ExitCode.SUCCESS)
    session.assert_closed()


def test_an_interrupt_ends_it_without_a_judgement() -> None:
    session = Session()

    async def work() -> None:
        session.process.events.on_transition(transition())
        session.interrupts.came = True
        await endless()

    assert session.run(work, 1000.0) is ExitCode.SUCCESS
    session.assert_closed()


def test_a_hangup_reloads_the_configuration() -> None:
    session = Session()

    async def work() -> None:
        session.interrupts.hung_up = True
        while not session.watched.reloads:
            await asyncio.sleep(0)
        session.interrupts.came = True
        await endless()

    assert session.run(work, 1000.0) is ExitCode.SUCCESS
    assert session.watched.reloads == 1


def test_a_reader_that_is_gone_ends_it() -> None:
    session = Session()
    session.output.on_show = lambda: setattr(session.output, "reader_is_gone", True)
    assert session.run() is ExitCode.SUCCESS
    session.assert_closed()


def test_an_error_of_the_work_closes_everything_and_comes_out() -> None:
    session = Session()

    async def work() -> None:
        raise KeyError("bug")

    with pytest.raises(KeyError):
        session.run(work)
    session.assert_closed()


def test_an_error_at_the_start_comes_before_any_output(monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session()

    def fail(*_: object) -> None:
        raise ConfigError("no token")

    monkeypatch.setattr(session.process, "read_settings", fail)
    with pytest.raises(ConfigError):
        session.run()
    assert session.output.calls == ["close"] and session.watched.closed


def test_an_output_that_cannot_be_written_is_a_fault_until_it_can() -> None:
    session = Session()
    faults = session.watched.node.faults
    seen: list[list[str]] = []
    problems = iter(["", "the output cannot be written: full", "the output cannot be written: full", "", ""])

    def on_show() -> None:
        seen.append([f"{part}: {fault.text}" for part, fault in faults.current().items()])
        try:
            session.output.problem = next(problems)
        except StopIteration:
            session.output.reader_is_gone = True

    session.output.on_show = on_show
    session.run()
    full = ["output: the output cannot be written: full"]
    assert seen == [[], [], full, full, [], []]


def test_a_judgement_without_its_output_is_an_error() -> None:
    session = Session()
    session.output.problem = "the output cannot be written: full"
    with pytest.raises(OutputError, match="full"):
        session.run(duration_s=0.05)
    session.assert_closed()


def part(text: str) -> Reload:
    async def outcome() -> str:
        return text

    return outcome


def failing(error: Exception) -> Reload:
    async def outcome() -> str:
        raise error

    return outcome


def lines_of(*parts: Reload, times: int = 1) -> list[str]:
    """Returns the lines of reloads."""
    lines: list[str] = []

    async def run() -> None:
        for _ in range(times):
            await reload_all(parts, lambda severity, text: lines.append(f"{severity.name} {text}"))

    run_in_virtual_time(run())
    return lines


@pytest.mark.parametrize(
    ("parts", "lines"),
    [
        ([part("nothing changed"), part("nothing changed")], ["INFO reloaded: nothing changed"]),
        ([part("a changed"), part("nothing changed"), part("b changed")], ["INFO reloaded: a changed; b changed"]),
        (
            [failing(ConfigError("bad", ("x",), file="f", line=3)), part("nothing changed")],
            ["ERROR not reloaded, the old configuration stays in force: f:3: x: bad"],
        ),
        (
            [failing(ConfigError("bad", file="f")), part("b changed")],
            ["ERROR not reloaded, the old configuration stays in force: f: bad", "INFO reloaded: b changed"],
        ),
        ([failing(ValueError("\x1b[2J"))], ["ERROR not reloaded: internal error: ValueError: ?[2J"]),
    ],
)
def test_each_part_is_reloaded_by_itself_and_what_changed_is_one_line(parts: Any, lines: list[str]) -> None:
    assert lines_of(*parts) == lines


def test_a_part_that_hangs_is_one_error_line_and_blocks_neither_the_others_nor_later_reloads() -> None:
    async def hang() -> str:
        await asyncio.sleep(1e6)
        return ""

    error = "ERROR not reloaded, the old configuration stays in force: a file could not be read within 15 s"
    assert lines_of(hang, part("b changed"), times=2) == [error, "INFO reloaded: b changed"] * 2


class FakeServer:
    def __init__(self) -> None:
        self.tokens: list[str] = []

    def use_token(self, token: str) -> None:
        if not token:
            raise ConfigError("expected a token")
        self.tokens.append(token)


class Reloaded:
    """A process with an ops.yaml, and a server with the token of a file."""

    def __init__(self, folder: Path, server: FakeServer | None) -> None:
        self.ops, self.token = folder / "ops.yaml", folder / "token"
        self.write("")
        self.token.write_text("first")
        self.process = Session(str(self.ops)).process
        vars(self.process)["read_settings"] = self.settings
        vars(self.process)["_token"] = "first"
        given: Any = server
        self.process.operations.server = given

    def write(self, more: str) -> None:
        self.ops.write_text(f"history: {{file: history.db}}\n{more}")

    def settings(self, monitors: object, options: ServerOptions | None) -> ServerSettings:
        port = 1 if options is None or options.port is None else options.port
        return ServerSettings(port, token=self.token.read_text())

    def reload(self) -> str:
        monitors: Any = None
        return asyncio.run(self.process.reload_ops(monitors))


def test_only_what_differs_is_applied(tmp_path: Path) -> None:
    server = FakeServer()
    reloaded = Reloaded(tmp_path, server)
    with reloaded.process:
        assert reloaded.reload() == "nothing changed"
        reloaded.token.write_text("second")
        assert reloaded.reload() == "server: the token changed, every client has to present the new one"
        assert server.tokens == ["second"]
        reloaded.write("notify: {chat: {type: webhook, url: 'http://127.0.0.1:1'}}\nserver: {port: 2}\n")
        assert reloaded.reload() == "notify: other targets; server: takes effect after a restart"
        assert reloaded.reload() == "nothing changed"
        reloaded.ops.write_text("history: {file: other.db}\nserver: {port: 2}\n")
        assert reloaded.reload() == "history: takes effect after a restart; notify: other targets"


@pytest.mark.parametrize("broken", ["notify: {chat: {type: carrier_pigeon}}\n", "notify: [\n"])
def test_a_broken_file_changes_nothing(tmp_path: Path, broken: str) -> None:
    server = FakeServer()
    reloaded = Reloaded(tmp_path, server)
    with reloaded.process:
        reloaded.token.write_text("second")
        reloaded.write(broken)
        with pytest.raises(ConfigError, match=r"ops\.yaml:[23]"):
            reloaded.reload()
        assert server.tokens == []
        reloaded.write("")
        reloaded.token.write_text("")
        with pytest.raises(ConfigError, match="expected a token"):
            reloaded.reload()
        reloaded.token.write_text("third")
        assert reloaded.reload() == "server: the token changed, every client has to present the new one"


def test_a_server_needs_a_restart_to_come_into_being(tmp_path: Path) -> None:
    reloaded = Reloaded(tmp_path, None)
    with reloaded.process:
        assert reloaded.reload() == "nothing changed"
        reloaded.write("server: {port: 2}\n")
        assert reloaded.reload() == "server: takes effect after a restart"


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
    assert type(choose_output(as_json=False)) is lines.Output


@pytest.mark.parametrize("term", ["", "dumb", "unknown", None])
def test_plain_lines_on_a_terminal_that_cannot_move_its_cursor(term: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Terminal())
    if term is None:
        monkeypatch.delenv("TERM", raising=False)
    else:
        monkeypatch.setenv("TERM", term)
    assert type(choose_output(as_json=False)) is lines.Output


def test_a_live_table_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    live = pytest.importorskip("robot_health_monitor.cli.output.live", reason="rich is not installed")
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    assert isinstance(choose_output(as_json=False), live.LiveView)


def test_plain_lines_and_one_line_on_stderr_without_rich(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdout", Terminal())
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delitem(sys.modules, "robot_health_monitor.cli.output.live", raising=False)
    monkeypatch.setitem(sys.modules, "rich", None)
    for name in [name for name in sys.modules if name.startswith("rich.")]:
        monkeypatch.setitem(sys.modules, name, None)
    assert type(choose_output(as_json=False)) is lines.Output
    written = capsys.readouterr().err
    assert "rich is not installed" in written and written.count("\n") == 1


def test_without_a_server_and_a_file_no_samples_are_collected(tmp_path: Path) -> None:
    """Nothing could show them. They would cost as much as judging."""
    files = {"": None, "server": {"port": 0}, "history": {"file": str(tmp_path / "history.db")}}
    kept = {}
    for name, section in files.items():
        (tmp_path / "ops.yaml").write_text(json.dumps({name: section} if name else {}))
        for serves in (False, True):
            output: Any = Output()
            interrupts: Any = Interrupts()
            file = str(tmp_path / "ops.yaml")
            with MonitorProcess(
                output, interrupts, ops_file=file, name="connect", server=ServerOptions(), serves=serves
            ) as process:
                assert process.operations.history is not None
                kept[name, serves] = process.operations.history.keeps_samples
    assert [key for key, is_kept in kept.items() if not is_kept] == [("", False)]
