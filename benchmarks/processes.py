"""Processes that are measured from outside, and the middlewares of this machine, each isolated.

What `make test` runs its tests with is measured here: the same interpreters and the same environments.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Awaitable, Callable, Iterator, Mapping, Sequence

import yaml
from harness.reserved import free_port

from benchmarks.table import ROOT


class Process:
    """A process that is measured from outside; it ends with the block `with`."""

    def __init__(
        self, command: Sequence[object], variables: Mapping[str, str] | None = None, *, answers: bool = False
    ) -> None:
        """Starts it. Its output goes to a file, except the `stdout` of one that answers lines."""
        self._log = tempfile.TemporaryFile("w+")
        self._process = subprocess.Popen(
            [str(word) for word in command],
            env={**os.environ, "PYTHONPATH": str(ROOT)} if variables is None else variables,
            cwd=tempfile.gettempdir(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE if answers else self._log,
            stderr=self._log,
            text=True,
            start_new_session=True,
        )

    def ask(self, line: object) -> str:
        """Writes a line to its stdin and returns the line that it replies."""
        assert self._process.stdin is not None
        print(line, file=self._process.stdin, flush=True)
        return self.reply()

    def reply(self) -> str:
        """Returns the next line of its stdout; raises RuntimeError if it has ended."""
        assert self._process.stdout is not None
        reply = self._process.stdout.readline().strip()
        if not reply:
            self._process.wait(10.0)
            self.require_running()
        return reply

    def cpu_s(self) -> float:
        """Returns the CPU time of all its threads since it started, in s; raises RuntimeError if it has ended.

        The clock is that of clock_getcpuclockid(3) on Linux: psutil's times have a resolution of 10 ms, which is too
        coarse for a slice.
        """
        self.require_running()
        return time.clock_gettime(~self._process.pid << 3 | 2)

    def own_mb(self) -> float:
        """Returns its private memory, in MB of 10^6 bytes: the pages that no other process uses and no file holds.

        Private pages that a file holds (the rest of USS) are left out: the kernel may drop them, and which ones are
        private depends on what else runs.
        """
        lines = Path(f"/proc/{self._process.pid}/smaps_rollup").read_text("ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("Private_Dirty:")) * 1024 / 1e6

    def require_running(self) -> None:
        """Raises RuntimeError with the last line of its output if it has ended."""
        if self._process.poll() is not None:
            self._log.seek(0)
            lines = self._log.read().strip().splitlines()
            raise RuntimeError(f"ended with {self._process.returncode}: {lines[-1] if lines else 'no output'}")

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        """Ends it with SIGINT; kills it after 10 s."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
        self._log.close()


def peer(*role: object) -> Process:
    """Starts `python -m benchmarks.peers ROLE`, which answers lines."""
    return Process([sys.executable, "-m", "benchmarks.peers", *role], answers=True)


async def answer(first: object, reply: Callable[..., Awaitable[object]]) -> None:
    """Writes a line that says that a peer is ready, then the reply to the words of each line that it is asked."""
    print(first, flush=True)
    lines = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while words := (await lines.readline()).decode().split():
        print(await reply(*words), flush=True)


@dataclass(frozen=True)
class Target:
    """One middleware, ready to run nodes."""

    name: str
    python: str
    variables: dict[str, str]
    package: str
    """`ros1` or `ros2`."""

    def node(
        self, executable: str, namespace: str, remap: str = "", parameters: Path | None = None, first: str = ""
    ) -> Process:
        """Starts one of this project's executables, with a `remap` (`old:=new`) and the file of its configuration.

        `first` is code that runs before it.
        """
        module = f"robot_health_monitor.cli.{self.package}_executables"
        code = f"{first}import sys; from {module} import {executable} as main; sys.exit(main())"
        arguments = [word for word in (f"__ns:=/{namespace}", remap) if word]
        if self.package == "ros2":
            arguments = ["--ros-args", *(word for argument in arguments for word in ("-r", argument))]
            if parameters is not None:
                arguments += ["--params-file", str(parameters)]
        elif parameters is not None:
            load = ["rosparam", "load", str(parameters), f"/{namespace}"]
            subprocess.run(load, env=self.variables, check=True, stdout=subprocess.DEVNULL)
        return Process([self.python, "-c", code, *arguments], self.variables)

    def peer(self, role: str, topics: int = 1) -> Process:
        """Starts one of the peers with a number of topics."""
        command = [self.python, "-m", "benchmarks.ros_peers", role, topics]
        variables = {**self.variables, "BENCHMARK_ROS": self.package}
        return Process(command, variables, answers=role.endswith("publisher"))


@contextlib.contextmanager
def target(package: str, python: str, variables: dict[str, str]) -> Iterator[Target]:
    """Prepares ROS 1 with a master on a free port, or ROS 2 in a random domain, on this machine only."""
    compile_source(python)
    path = os.pathsep.join(filter(None, [str(ROOT), variables.get("PYTHONPATH", "")]))
    variables = {**variables, "PYTHONPATH": path}
    if package == "ros2":
        domain = str(random.SystemRandom().randrange(10, 100))
        own = {"ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        yield Target("ROS 2", python, {**variables, **own}, package)
        return
    port = free_port()
    variables.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1")
    with Process(["roscore", "-p", port], variables) as core:
        while socket.socket().connect_ex(("127.0.0.1", port)):
            core.require_running()
            time.sleep(0.1)
        yield Target("ROS 1", python, variables, package)


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
    folders: Any = [folder for folder in ROOT.iterdir() if folder.is_dir() and not folder.name.startswith(".")]
    subprocess.run([python, "-m", "compileall", "-q", *folders], check=True)
