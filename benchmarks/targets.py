"""The middlewares of this machine, each isolated: its own master or domain, Python and variables.

What `make test` runs its tests with is measured here: the same interpreters and the same environments.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import signal
import socket
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Optional

import psutil

ROOT = Path(__file__).resolve().parent.parent

_LIBC = ctypes.CDLL(None)


class Process:
    """A process that is measured from outside."""

    def __init__(self, command: List[str], variables: Dict[str, str]) -> None:
        """Starts it. Its output goes to a file, except the `stdout` of a publisher."""
        self._log = tempfile.TemporaryFile("w+")
        self._process = subprocess.Popen(
            command,
            env=variables,
            cwd=tempfile.gettempdir(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE if any(word.endswith("publisher") for word in command) else self._log,
            stderr=self._log,
            text=True,
            start_new_session=True,
        )
        self._measured = psutil.Process(self._process.pid)
        # psutil's CPU times have a resolution of 10 ms, which is too coarse for a slice.
        clock = ctypes.c_int()
        _LIBC.clock_getcpuclockid(self._process.pid, ctypes.byref(clock))
        self._cpu_clock = clock.value

    def order(self, line: str) -> int:
        """Writes a line to its stdin and returns the number that it replies."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def cpu_s(self) -> float:
        """Returns the CPU time of all its threads since it started, in seconds.

        Raises:
            RuntimeError: it has ended.
        """
        self.require_running()
        return time.clock_gettime(self._cpu_clock)

    def resident_mb(self) -> float:
        """Returns its resident memory, in MB of 10^6 bytes."""
        return float(self._measured.memory_info().rss) / 1e6

    def own_mb(self) -> float:
        """Returns its private memory, in MB of 10^6 bytes: the pages that no other process uses and no file holds.

        Private pages that a file holds (the rest of USS) are left out: the kernel may drop them, and which ones are
        private depends on what else runs.
        """
        rollup = Path(f"/proc/{self._measured.pid}/smaps_rollup").read_text("ascii")
        dirty_kb = next(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Private_Dirty:"))
        return dirty_kb * 1024 / 1e6

    def require_running(self) -> None:
        """Raises RuntimeError with the last line of its output if it has ended."""
        if self._process.poll() is not None:
            self._log.seek(0)
            lines = self._log.read().strip().splitlines()
            raise RuntimeError(f"ended with {self._process.returncode}: {lines[-1] if lines else 'no output'}")

    def end(self) -> None:
        """Ends it with SIGINT; kills it after 10 s."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._log):
            if pipe is not None:
                pipe.close()


@dataclass(frozen=True)
class Target:
    """One middleware, ready to run nodes."""

    name: str
    python: str
    variables: Dict[str, str]
    package: str
    """`ros1` or `ros2`."""

    def node(
        self, executable: str, namespace: str, remap: str = "", parameters: Optional[Path] = None, first: str = ""
    ) -> Process:
        """Starts one of this project's executables.

        Args:
            executable: its name.
            namespace: its namespace.
            remap: a name that it is to use in place of another, `old:=new`; empty: none.
            parameters: a file with its configuration.
            first: code that runs before it.
        """
        module = f"robot_health_monitor.cli.{self.package}_executables"
        code = f"{first}import sys; from {module} import {executable} as main; sys.exit(main())"
        arguments = [f"__ns:=/{namespace}", remap]
        if self.package == "ros2":
            arguments = [word for argument in arguments if argument for word in ("-r", argument)]
            arguments.insert(0, "--ros-args")
            if parameters is not None:
                arguments += ["--params-file", str(parameters)]
        elif parameters is not None:
            load = ["rosparam", "load", str(parameters), f"/{namespace}"]
            subprocess.run(load, env=self.variables, check=True, stdout=subprocess.DEVNULL)
        return Process([self.python, "-c", code, *filter(None, arguments)], self.variables)

    def peer(self, role: str, topics: int = 1) -> Process:
        """Starts one of the peers with a number of topics."""
        variables = {**self.variables, "BENCHMARK_ROS": self.package}
        return Process([self.python, "-m", "benchmarks.ros_peers", role, str(topics)], variables)

    def tool(self, *command: str) -> Process:
        """Starts a tool of the middleware."""
        return Process(list(command), self.variables)


@contextlib.contextmanager
def ros1(python: str, variables: Dict[str, str]) -> Iterator[Target]:
    """Starts a separate master on a free port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    variables = {**_with_source(python, variables), "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
    core = Process(["roscore", "-p", str(port)], variables)
    try:
        while socket.socket().connect_ex(("127.0.0.1", port)):
            core.require_running()
            time.sleep(0.1)
        yield Target("ROS 1", python, variables, "ros1")
    finally:
        core.end()


@contextlib.contextmanager
def ros2(python: str, variables: Dict[str, str]) -> Iterator[Target]:
    """Uses a random domain, on this machine only."""
    domain = str(random.SystemRandom().randrange(10, 100))
    variables = {
        **_with_source(python, variables),
        "ROS_DOMAIN_ID": domain,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    yield Target("ROS 2", python, variables, "ros2")


def compile_source(python: str) -> None:
    """Writes the bytecode of this tree, as every installed package has it.

    Else each process would compile it at its start, which takes time and memory.
    """
    folders = [str(folder) for folder in ROOT.iterdir() if folder.is_dir() and not folder.name.startswith(".")]
    subprocess.run([python, "-m", "compileall", "-q", *folders], check=True)


def _with_source(python: str, variables: Dict[str, str]) -> Dict[str, str]:
    compile_source(python)
    path = os.pathsep.join(filter(None, [str(ROOT), variables.get("PYTHONPATH", "")]))
    return {**variables, "PYTHONPATH": path}
