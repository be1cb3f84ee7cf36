"""Processes that are measured by one clock, and what is written for them."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from subprocess import PIPE, STDOUT
from typing import Any, Callable, Iterator, Mapping, Sequence

import yaml

from benchmarks.table import ROOT

SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
VARIABLES = {**os.environ, "PYTHONPATH": str(ROOT)}


class Process:
    """A process that is measured from outside; it ends with the block `with`."""

    def __init__(
        self, command: Sequence[object], variables: Mapping[str, str] = VARIABLES, *, answers: bool = False
    ) -> None:
        """Starts it. Its output goes to a file, except the `stdout` of one that answers lines."""
        log = self._log = tempfile.TemporaryFile("w+")
        words, folder, out = [str(word) for word in command], tempfile.gettempdir(), PIPE if answers else log
        self._process = subprocess.Popen(
            words, env=variables, cwd=folder, stdin=PIPE, stdout=out, stderr=log, text=True, start_new_session=True
        )
        self.stdout: Any = self._process.stdout
        """Where one that answers lines writes them."""

    def ask(self, line: object) -> str:
        """Writes a line to its stdin and returns the line that it replies."""
        print(line, file=self._process.stdin, flush=True)
        return self.reply()

    def reply(self) -> str:
        """Returns the next line of its stdout; raises RuntimeError if it has ended."""
        reply: str = self.stdout.readline().strip()
        if not reply:
            self._process.wait(10.0)
            self.require_running()
        return reply

    def send(self, line: str, receivers: int = 1) -> int:
        """Asks a publisher for messages; returns how many it has sent to all, when those in flight have arrived."""
        sent = int(self.ask(line))
        time.sleep(SETTLE_S)
        return sent * receivers

    def cpu_s(self) -> float:
        """Returns the CPU time of all its threads since it started, in s; raises RuntimeError if it has ended.

        The clock is that of clock_getcpuclockid(3) on Linux: psutil's times have a resolution of 10 ms, which is too
        coarse for a slice.
        """
        self.require_running()
        return time.clock_gettime(~self._process.pid << 3 | 2)

    def own_bytes(self) -> float:
        """Returns its private memory: the pages that no other process uses and no file holds.

        Private pages that a file holds (the rest of USS) are left out: the kernel may drop them, and which ones are
        private depends on what else runs.
        """
        return _bytes("Private_Dirty", f"/proc/{self._process.pid}/smaps_rollup")

    def require_running(self) -> None:
        """Raises RuntimeError with the last line of its output if it has ended."""
        if self._process.poll() is not None:
            self._log.seek(0)
            lines = self._log.read().strip().splitlines()
            raise RuntimeError(f"ended with {self._process.returncode}: {lines[-1] if lines else 'no output'}")

    def wait_for_port(self, port: int) -> None:
        """Waits until a port is open; raises RuntimeError if the process has ended."""
        while socket.socket().connect_ex(("127.0.0.1", port)):
            self.require_running()
            time.sleep(0.1)

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        """Ends it with SIGINT; kills it after 10 s."""
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._log.close()


def peer(*role: object, **variables: str) -> Process:
    """Starts `python -m benchmarks.peers ROLE`, which answers lines."""
    return Process([sys.executable, "-m", "benchmarks.peers", *role], {**VARIABLES, **variables}, answers=True)


def cpu_s(processes: Mapping[str, Process], act: Callable[[], float]) -> dict[str, float]:
    """Returns the CPU time that each process takes while `act` runs, per message or second: `act` returns how many."""
    begin_s = {name: process.cpu_s() for name, process in processes.items()}
    count = act()
    return {name: (process.cpu_s() - begin_s[name]) / count for name, process in processes.items()}


def pause(seconds: float) -> float:
    """Sleeps; returns for how long."""
    time.sleep(seconds)
    return seconds


def run_python(*arguments: object) -> str:
    """Runs this Python to its end and returns the last line of its output; raises RuntimeError with it if it fails."""
    done = subprocess.run([sys.executable, *map(str, arguments)], cwd=ROOT, stdout=PIPE, stderr=STDOUT, text=True)
    *_, last = ("", *done.stdout.splitlines())
    if done.returncode:
        raise RuntimeError(last)
    return last


@contextlib.contextmanager
def reported(clock: Callable[[], float]) -> Iterator[None]:
    """Prints how long the block took by a clock, in s, and the largest memory of this process so far, in bytes."""
    begin_s = clock()
    yield
    print(json.dumps([clock() - begin_s, _bytes("VmHWM", "/proc/self/status")]))  # ru_maxrss includes the parent's


def _bytes(key: str, file: str) -> float:
    """Returns a figure of memory from a file of the kernel."""
    return int(re.findall(rf"^{key}:\s+(\d+) kB", Path(file).read_text("ascii"), re.M)[0]) * 1024.0


def alert_system(signals: Mapping[str, Any], **others: object) -> dict[str, Any]:
    """Returns the tree of a thresholds.yaml."""
    return {"alert_system": {"ros__parameters": {**others, "signals": signals}}}


def write_yaml(folder: Path, **trees: object) -> None:
    """Writes each tree to NAME.yaml in a folder, in block style: rcl overlooks a node in a flow mapping."""
    for name, tree in trees.items():
        separate = json.loads(json.dumps(tree))  # a mapping that occurs twice would be written as an alias
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(separate, sort_keys=False))


def compile_source(python: str) -> None:
    """Writes the bytecode of this tree, as every installed package has it: its start is not measured."""
    folders = [str(folder) for folder in ROOT.iterdir() if folder.is_dir() and not folder.name.startswith(".")]
    subprocess.run([python, "-m", "compileall", "-q", *folders], check=True)
