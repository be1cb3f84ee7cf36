"""A process that takes part in a benchmark and is controlled over its stdin and stdout, a line each way."""

from __future__ import annotations

import asyncio
import subprocess
import sys

from benchmarks.targets import ROOT


class Peer:
    """A process of one of the modules `*_peers.py`, as seen by the benchmark."""

    def __init__(self, module: str, *arguments: object) -> None:
        """Starts `python -m benchmarks.MODULE ARGUMENTS`, and waits for its first line."""
        self._module = module
        command = [sys.executable, "-m", f"benchmarks.{module}", *map(str, arguments)]
        self._process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.first = self._reply()

    def ask(self, line: str) -> str:
        """Writes a line and returns the reply."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return self._reply()

    def end(self) -> None:
        """Ends it."""
        self._process.kill()
        self._process.communicate()

    def _reply(self) -> str:
        assert self._process.stdout is not None
        reply = self._process.stdout.readline().strip()
        if not reply:
            raise RuntimeError(f"a process of {self._module} has ended")
        return reply


async def requests() -> asyncio.StreamReader:
    """Returns a reader of the lines that the benchmark writes; for use in the peer."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    return reader
