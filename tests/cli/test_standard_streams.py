"""stdout and stderr never block and never fail, however they are read. Real processes with real pipes and files."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """
import os, sys, threading
from robot_health_monitor.cli import standard_streams
from robot_health_monitor.cli.standard_streams import StandardStreams
result = open(sys.argv[1], "w", buffering=1)
problems = threading.Event()
with StandardStreams() as streams:
    def on_change(name, problem):
        result.write(f"{name}: {problem}\\n")
        problems.set()
    streams.on_change(on_change)
"""


def run(tmp_path: Path, body: str, **options: Any) -> subprocess.Popen:
    lines = "".join(f"    {line}\n" for line in body.strip().splitlines())
    command = [sys.executable, "-c", f"{PROGRAM}{lines}", str(tmp_path / "result")]
    return subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, **options)


def result(tmp_path: Path) -> list[str]:
    return (tmp_path / "result").read_text(encoding="utf-8").splitlines()


def test_lines_arrive_complete_and_in_order(tmp_path: Path) -> None:
    body = """
for number in range(2000): print("line", number)
os.write(2, b"from C\\n")
"""
    process = run(tmp_path, body, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, errors = process.communicate(timeout=60)
    assert out.decode().splitlines() == [f"line {number}" for number in range(2000)]
    assert errors == b"from C\n"
    assert process.returncode == 0


def test_the_end_waits_for_lines_that_are_being_read(tmp_path: Path) -> None:
    body = """
standard_streams._DRAIN_S = 0.0
standard_streams._CHUNK_BYTES = 1  # slow
for number in range(2000): print("line", number)
"""
    process = run(tmp_path, body, stdout=subprocess.PIPE)
    assert process.communicate(timeout=60)[0].decode().splitlines() == [f"line {number}" for number in range(2000)]


def test_a_reader_that_is_gone_is_a_problem_that_is_reported(tmp_path: Path) -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    body = """
print("lost")
problems.wait(30)
for number in range(100_000): print("lost too")
"""
    process = run(tmp_path, body, stdout=write_end)
    os.close(write_end)
    assert process.wait(60) == 0
    assert result(tmp_path) == ["stdout: cannot be written (Broken pipe): lines may be lost"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_disk_is_reported_once_and_tried_again_without_losing_a_line(tmp_path: Path) -> None:
    body = """
standard_streams._RETRY_S = 0.01
print("one")
problems.wait(30)
print("two")
problems.clear()
os.dup2(os.open(sys.argv[1] + ".space", os.O_CREAT | os.O_WRONLY), streams.stdout.original)  # there is space again
problems.wait(30)
"""
    with open("/dev/full", "w", encoding="utf-8") as full:
        process = run(tmp_path, body, stdout=full)
    assert process.wait(60) == 0
    assert result(tmp_path) == ["stdout: cannot be written (No space left on device): lines may be lost", "stdout: "]
    assert (tmp_path / "result.space").read_text() == "one\ntwo\n"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_the_end_does_not_wait_for_a_full_disk(tmp_path: Path) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        process = run(tmp_path, 'print("lost")\nproblems.wait(30)', stdout=full)
    assert process.wait(60) == 0
    assert result(tmp_path) == ["stdout: cannot be written (No space left on device): lines may be lost"]


def test_a_reader_that_hangs_stops_nothing(tmp_path: Path) -> None:
    """A pipe holds 64 KB; so much is written that a blocking write would wait forever."""
    body = """
standard_streams._SILENT_READER_S = 0.1
for number in range(50_000): print("x" * 100)
problems.wait(30)
"""
    process = run(tmp_path, body, stdout=subprocess.PIPE)
    assert process.wait(60) == 0
    assert result(tmp_path) == ["stdout: is not being read: lines may be lost"]
    assert process.stdout is not None
    process.stdout.close()


def test_a_child_that_still_runs_does_not_keep_the_process(tmp_path: Path) -> None:
    """Such as a command of `notify`, whose stderr is that of the process."""
    body = """
import subprocess
standard_streams._BUSY_S = 1000.0
child = subprocess.Popen(["sleep", "1000"])
print(child.pid, file=result)
print("last")
"""
    process = run(tmp_path, body, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.wait(60) == 0
    (pid,) = result(tmp_path)
    os.kill(int(pid), signal.SIGKILL)
    assert process.communicate(timeout=60) == (b"last\n", b"")


def test_a_closed_stdout_is_no_problem(tmp_path: Path) -> None:
    process = run(tmp_path, 'print("unwanted")', preexec_fn=lambda: os.close(1))
    assert process.wait(60) == 0
    assert result(tmp_path) == []


def test_a_terminal_stays_a_terminal_for_the_program(tmp_path: Path) -> None:
    main, terminal = os.openpty()
    process = run(tmp_path, "print(sys.stdout.isatty(), file=result)", stdout=terminal, stderr=subprocess.DEVNULL)
    os.close(terminal)
    assert process.wait(60) == 0
    os.close(main)
    assert result(tmp_path) == ["True"]


def test_an_exception_is_printed_after_the_streams_are_restored(tmp_path: Path) -> None:
    process = run(tmp_path, 'print("before")\nraise ValueError("seen")', stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, errors = process.communicate(timeout=60)
    assert out == b"before\n"
    assert errors.decode().splitlines()[-1] == "ValueError: seen"
