"""The configuration, ops.yaml and the server's token are read again while the process runs."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, List, Optional

import pytest
from harness.virtual_loop import run_in_virtual_time

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.operations import open_operations
from robot_health_monitor.ops.configuration import ServerOptions
from robot_health_monitor.reloading import OpsReload, Reload, Reloads
from robot_health_monitor.serving import ServerSettings


def part(text: str) -> Reload:
    async def outcome() -> str:
        return text

    return outcome


def failing(error: Exception) -> Reload:
    async def outcome() -> str:
        raise error

    return outcome


def lines_of(*parts: Reload, requests: int = 1) -> List[str]:
    """Returns the lines of reloads."""
    lines: List[str] = []

    async def run() -> None:
        reloads = Reloads(lambda severity, text: lines.append(f"{severity.name} {text}"))
        for each in parts:
            reloads.add(each)
        reloads.request()  # nothing happens before it runs
        task = asyncio.ensure_future(reloads.run())
        for _ in range(requests):
            await asyncio.sleep(100.0)
            reloads.request()
        await asyncio.sleep(100.0)
        task.cancel()

    run_in_virtual_time(run())
    return lines


@pytest.mark.parametrize(
    ("parts", "lines"),
    [
        ([part("nothing changed"), part("nothing changed")], ["INFO reloaded: nothing changed"]),
        ([part("a changed"), part("nothing changed"), part("b changed")], ["INFO reloaded: a changed; b changed"]),
        ([part("")], []),
        ([part(""), part("nothing changed")], ["INFO reloaded: nothing changed"]),
        (
            [failing(ConfigError("bad", ("x",), file="f", line=3)), part("nothing changed")],
            ["ERROR not reloaded, the old configuration stays in force: f:3: x: bad"],
        ),
        (
            [failing(ConfigError("bad", file="f")), part("b changed")],
            ["ERROR not reloaded, the old configuration stays in force: f: bad", "INFO reloaded: b changed"],
        ),
        ([failing(ValueError("\x1b[2J"))], ["ERROR not reloaded: internal error: ValueError: ?[2J"]),
        ([], []),
    ],
)
def test_each_part_is_reloaded_by_itself_and_what_changed_is_one_line(parts: Any, lines: List[str]) -> None:
    assert lines_of(*parts) == lines


def test_a_part_that_hangs_is_one_error_line_and_blocks_neither_the_others_nor_later_reloads() -> None:
    async def hang() -> str:
        await asyncio.sleep(1e6)
        return ""

    error = "ERROR not reloaded, the old configuration stays in force: a file could not be read within 15 s"
    assert lines_of(hang, part("b changed"), requests=2) == [error, "INFO reloaded: b changed"] * 2


class FakeServer:
    def __init__(self) -> None:
        self.tokens: List[str] = []

    def use_token(self, token: str) -> None:
        if not token:
            raise ConfigError("expected a token or TLS client certificates")
        self.tokens.append(token)


class Process:
    """What a command has: an ops.yaml, its operations, and a server with the token of a file."""

    def __init__(self, folder: Path, server: Optional[FakeServer]) -> None:
        self.ops, self.token, self.server = folder / "ops.yaml", folder / "token", server
        self.write("")
        self.token.write_text("first")
        self.operations = open_operations(str(self.ops))
        made: Any = server
        settings = self.settings(None)
        self._part = OpsReload(str(self.ops), self.operations, made, settings, self.settings)

    def write(self, more: str) -> None:
        self.ops.write_text(f"history: {{file: history.db}}\n{more}")

    def settings(self, options: Optional[ServerOptions]) -> ServerSettings:
        port = 1 if options is None or options.port is None else options.port
        return ServerSettings(port, token=self.token.read_text())

    def reload(self) -> str:
        return asyncio.run(self._part.reload())


def test_only_what_differs_is_applied(tmp_path: Path) -> None:
    server = FakeServer()
    process = Process(tmp_path, server)
    with process.operations:
        assert process.reload() == "nothing changed"
        process.token.write_text("second")
        assert process.reload() == "server: the token changed, every client has to present the new one"
        assert server.tokens == ["second"]
        process.write("notify: {chat: {type: webhook, url: 'http://127.0.0.1:1'}}\nserver: {port: 2}\n")
        assert process.reload() == "server: port takes effect after a restart; notify: added chat"
        assert process.reload() == "nothing changed"
        process.ops.write_text("history: {file: other.db}\nserver: {port: 2}\n")
        assert process.reload() == "notify: removed chat; history: takes effect after a restart"


@pytest.mark.parametrize("broken", ["notify: {chat: {type: carrier_pigeon}}\n", "notify: [\n"])
def test_a_broken_file_changes_nothing(tmp_path: Path, broken: str) -> None:
    server = FakeServer()
    process = Process(tmp_path, server)
    with process.operations:
        process.token.write_text("second")
        process.write(broken)
        with pytest.raises(ConfigError, match=r"ops\.yaml:[23]"):
            process.reload()
        assert server.tokens == []
        process.write("")
        process.token.write_text("")
        with pytest.raises(ConfigError, match="expected a token"):
            process.reload()
        process.token.write_text("third")
        assert process.reload() == "server: the token changed, every client has to present the new one"


def test_a_server_needs_a_restart_to_come_into_being(tmp_path: Path) -> None:
    process = Process(tmp_path, None)
    with process.operations:
        assert process.reload() == "nothing changed"
        process.token.write_text("second")
        assert process.reload() == "server: takes effect after a restart"
