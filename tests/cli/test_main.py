"""Exit codes and errors that every command shares."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path
from typing import Any, Iterator

import pytest

from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.commands import sources_command
from robot_health_monitor.cli.output.lines import OutputError
from robot_health_monitor.core.values.errors import LinkError, MessageError, ServiceError


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    yield
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT, signal.SIGTERM])


def fail_with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(*arguments: object) -> None:
        raise error

    monkeypatch.setattr(sources_command, "show_sources", fail)


def test_every_mistake_of_a_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text("alert_system: {ros__parameters: {signals: {\n  a: {warn_below: x},\n  b: {warn_above: y}}}}\n")
    assert main(["run", "--thresholds", str(file)]) == 2
    assert capsys.readouterr().err == (
        f"{file}:2: alert_system.ros__parameters.signals.a.warn_below: expected a number, got 'x'\n"
        f"{file}:3: alert_system.ros__parameters.signals.b.warn_above: expected a number, got 'y'\n"
    )


def test_an_error_that_belongs_to_no_file_names_the_command(capsys: pytest.CaptureFixture) -> None:
    assert main(["connect", "ws://a", "ws://a"]) == 2
    text = "two robots are named a; give them names: one=host:port two=host:port"
    assert capsys.readouterr().err == f"robot-health connect: {text}\n"


def test_a_crash_is_one_line_without_a_traceback_and_code_3(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    fail_with(monkeypatch, KeyError("x\n\x1b[2J"))
    assert main(["sources"]) == 3
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith("robot-health: internal error: test_main.py:") and "KeyError" in output.err
    assert output.err.count("\n") == 1 and "\x1b" not in output.err


@pytest.mark.parametrize("kind", [MessageError, ServiceError, LinkError, OutputError])
def test_an_error_of_the_project_is_one_line_and_code_3(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, kind: type[Exception]
) -> None:
    fail_with(monkeypatch, kind("there is no answer"))
    assert main(["sources"]) == 3
    assert capsys.readouterr().err == "robot-health: there is no answer\n"


def test_a_missing_library_is_one_line_and_code_3(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    fail_with(monkeypatch, ModuleNotFoundError("No module named 'cbor2'", name="cbor2"))
    assert main(["sources"]) == 3
    assert capsys.readouterr().err == "robot-health: cbor2 is not installed: pip install cbor2\n"


def test_an_interrupt_is_code_0(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    fail_with(monkeypatch, KeyboardInterrupt())
    assert main(["sources"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["sources"]])
def test_output_that_cannot_be_written_is_one_line_and_code_3(
    command: list[str], environment: dict[str, str], arguments: Any
) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*command, *arguments], stdout=full, stderr=subprocess.PIPE, env=environment, timeout=30.0, check=False
        )
    assert done.returncode == 3
    assert done.stderr.decode() == "robot-health: the output cannot be written: No space left on device\n"


@pytest.mark.parametrize("argument", ["--\x1b[2J", "--\nrobot-health: forged", "\u202e"])
def test_wrong_usage_is_one_printable_line(capsys: pytest.CaptureFixture, argument: str) -> None:
    assert main([argument]) == 2
    error = capsys.readouterr().err
    assert error.endswith("\n") and error[:-1].isprintable()
