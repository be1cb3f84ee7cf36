"""Starts the real `robot-health`, in a pipe or on a terminal."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from harness import reserved
from harness.line_process import Line, LineProcess, start_process
from harness.warm_python import start_fork

from robot_health_monitor.ops.store import history as store_history

ROOT = Path(__file__).resolve().parents[2]

CALM = """
alert_system:
  ros__parameters:
    robot_name: atlas
    rosbridge_port: PORT
    signals:
      battery_level: {unit: "%", warn_below: 20.0}
      temperature: {unit: degC}
      cpu_usage: {unit: "%"}
battery_sensor:
  ros__parameters:
    seed: 1
    publish_rate: 20.0
    temperature: {spike: 0.0}
"""

RESTLESS = """
alert_system:
  ros__parameters:
    robot_name: atlas
    rosbridge_port: PORT
    signals:
      battery_level: {unit: "%", valid_min: 0.0, valid_max: 100.0, warn_below: 80.0, error_below: 30.0}
battery_sensor:
  ros__parameters:
    publish_rate: 20.0
    battery_level: {discharge_rate: 100.0, charge_rate: 200.0}
    temperature: {source: none}
    cpu_usage: {source: none}
"""
"""A battery that is empty after a second and full again half a second later."""


@pytest.fixture(autouse=True)
def _every_commit_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine must not look like a disk that hangs: `record` returns when the transition is committed."""
    monkeypatch.setattr(store_history, "COMMIT_TIMEOUT_S", 60.0)


@pytest.fixture
def command() -> list[str]:
    """Returns what starts `robot-health`."""
    return [sys.executable, "-m", "robot_health_monitor"]


@pytest.fixture
def environment() -> dict[str, str]:
    """Returns the variables for the program: none that steer its output or Python's."""
    kept = ("HOME", "LANG", "LC_ALL", "PATH", "LD_LIBRARY_PATH", "VIRTUAL_ENV")
    variables = {name: os.environ[name] for name in kept if name in os.environ}
    variables["SSL_CERT_FILE"] = os.devnull  # no test needs a public authority; aiohttp would read all at each start
    return {**variables, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8", "TERM": "xterm-256color"}


@pytest.fixture
def robot_health_process(command: list[str], environment: dict[str, str]) -> Iterator[Callable[..., LineProcess]]:
    """Returns a function that starts `robot-health` in a new Python, with its output in pipes."""
    yield from starting(command, environment, start_process)


@pytest.fixture
def robot_health(command: list[str], environment: dict[str, str]) -> Iterator[Callable[..., LineProcess]]:
    """As `robot_health_process`, in a Python that has imported all; unless a module defines it otherwise."""
    yield from starting(command, environment, start_fork)


def starting(
    command: list[str], environment: dict[str, str], start: Callable[..., Any]
) -> Iterator[Callable[..., LineProcess]]:
    """Yields a function that starts a program, and ends what it has started."""
    started: list[LineProcess] = []

    def start_program(*arguments: object, **variables: str) -> LineProcess:
        words = [*command, *(str(argument) for argument in arguments)]
        started.append(LineProcess(words, {**environment, **variables}, start=start))
        return started[-1]

    yield start_program
    for process in started:
        process.end()


class FinishedCommand:
    """A command that has ended in this process; as a `LineProcess` that has ended."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self._code = code
        self.lines = [Line("out", text) for text in out.splitlines()] + [Line("err", text) for text in err.splitlines()]

    def wait(self, deadline_s: float = 0.0) -> int:
        return self._code

    @property
    def text(self) -> str:
        return "\n".join(f"{line.stream}: {line.text}" for line in self.lines)

    @property
    def errors(self) -> list[str]:
        return [line.text for line in self.lines if line.stream == "err"]


@pytest.fixture
def robot_health_here(capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> Callable[..., FinishedCommand]:
    """Returns what `robot_health` does, for commands that end by themselves: in this process, without Python's start.

    A module whose tests are about what such a command writes defines its `robot_health` with it.
    """
    from robot_health_monitor.__main__ import main

    def run(*arguments: object, **variables: str) -> FinishedCommand:
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        output = capsys.readouterr()
        return FinishedCommand(code, output.out, output.err)

    return run


@pytest.fixture
def on_terminal(command: list[str], environment: dict[str, str]) -> Iterator[Callable[..., Any]]:
    """Returns a function that starts `robot-health` on a terminal.

    Its arguments: those of the program; `columns`, `lines` and `full` of the terminal; `stdout`, a file that gets the
    output instead; and variables.
    """
    pytest.importorskip("pyte", reason="pyte, which keeps the screen, is not installed")
    from harness import terminal_process

    started: list[Any] = []

    def start(
        *arguments: object,
        columns: int = 80,
        lines: int = 24,
        full: bool = False,
        stdout: Path | None = None,
        **variables: str,
    ) -> Any:
        words = [*command, *(str(argument) for argument in arguments)]
        if stdout is not None:
            words = ["sh", "-c", 'exec "$@" > "$0"', str(stdout), *words]
        options: Any = {"columns": columns, "lines": lines, "full": full}
        started.append(terminal_process.TerminalProcess(words, {**environment, **variables}, **options))
        return started[-1]

    yield start
    for process in started:
        process.end()


@pytest.fixture
def free_port() -> int:
    """Returns a port that no process listens on."""
    return reserved.free_port()


@pytest.fixture
def calm(tmp_path: Path, free_port: int) -> Path:
    """Returns a configuration that gives no alert within a minute."""
    file = tmp_path / "calm.yaml"
    file.write_text(CALM.replace("PORT", str(free_port)))
    return file


@pytest.fixture
def restless(tmp_path: Path, free_port: int) -> Path:
    """Returns a configuration that gives several alerts in every second."""
    file = tmp_path / "restless.yaml"
    file.write_text(RESTLESS.replace("PORT", str(free_port)))
    return file


@pytest.fixture
def utc(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Sets the local time zone to UTC."""
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()
