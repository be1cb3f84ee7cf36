"""Time from a sample to its alert, with a history and five targets of which four hang, with a black box, and without.

Three `robot-health run` take the same samples in turn from a rosbridge client. Each sample crosses the bound, so each
is an alert. The time is that from sending the sample until both the message on `alerts` has reached the client and the
line has reached the reader of stdout.

Measured in the same round, on the same disk: one write, which is the rows of one transition committed by SQLite alone.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import re
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import AsyncExitStack, closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Awaitable, Callable, Dict, Iterator, List, Mapping

import aiohttp

from benchmarks.table import Row
from benchmarks.targets import ROOT

TRANSITIONS = 1_000
PAUSE_S = 0.005
"""Pause before each measurement, in s: four contestants, so an alert_system alerts 40 times a second at most."""

REQUIRED_RATIO = 1.5
DEADLINE_S = 30.0

_BATTERY: Mapping[str, Any] = {"warn_below": 20.0, "stale_after_s": 0.0, "window_samples": 60}
_SIGNALS = tuple(f"battery_{number}" for number in range(40))
"""A signal that announced more than 60 transitions within the last 60 s would flap."""


class _Target(BaseHTTPRequestHandler):
    """Responds, or hangs where the path says so."""

    hangs_until = threading.Event()

    def do_POST(self) -> None:
        """Receives a notification."""
        self.rfile.read(int(self.headers["Content-Length"]))
        if self.path == "/hang":
            self.hangs_until.wait()
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *arguments: object) -> None:
        """Writes nothing."""


class _Process:
    """`robot-health run`, measured from outside."""

    def __init__(self, folder: Path, *options: str) -> None:
        """Starts it; `connect` waits until it serves."""
        folder.mkdir()
        thresholds = folder / "thresholds.yaml"
        parameters = {"robot_name": "r3", "signals": dict.fromkeys(_SIGNALS, _BATTERY)}
        thresholds.write_text(json.dumps({"alert_system": {"ros__parameters": parameters}}))  # JSON is YAML
        command = ["run", "--thresholds", str(thresholds), "--source", "none", "--json", "--port", "0"]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "robot_health_monitor", *command, "--allow-publish", "*", *options],
            cwd=str(folder),
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._line_s = 0.0
        self._has_line = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()
        self._values = dict.fromkeys(_SIGNALS, 30.0)
        self._turns = itertools.cycle(_SIGNALS)

    async def connect(self, session: aiohttp.ClientSession) -> None:
        """Connects a client that publishes samples and receives alerts."""
        assert self._process.stderr is not None
        port = 0
        while not port:
            line = await asyncio.get_running_loop().run_in_executor(None, self._process.stderr.readline)
            assert line, "robot-health run has ended"
            found = re.search(r"ws://127\.0\.0\.1:(\d+)", line)
            port = int(found[1]) if found else 0
        threading.Thread(target=self._process.stderr.read, daemon=True).start()
        self._socket = await session.ws_connect(f"ws://127.0.0.1:{port}")
        for signal in _SIGNALS:
            await self._send({"op": "advertise", "topic": f"/{signal}", "type": "std_msgs/Float32"})
        await self._send({"op": "subscribe", "topic": "/alerts", "type": "diagnostic_msgs/DiagnosticStatus"})
        await asyncio.sleep(1.0)

    async def measure_s(self) -> float:
        """Sends a sample that changes the level; returns the time until message and line have come, in s."""
        signal = next(self._turns)
        self._values[signal] = 40.0 - self._values[signal]
        self._has_line.clear()
        began_s = time.perf_counter()
        await self._send({"op": "publish", "topic": f"/{signal}", "msg": {"data": self._values[signal]}})
        await asyncio.wait_for(self._socket.receive_str(), DEADLINE_S)
        alert_s = time.perf_counter()
        assert await asyncio.get_running_loop().run_in_executor(None, self._has_line.wait, DEADLINE_S)
        return max(self._line_s, alert_s) - began_s

    async def close(self) -> None:
        """Ends it."""
        await self._socket.close()
        self._process.terminate()
        self._process.wait(DEADLINE_S)

    async def _send(self, message: Mapping[str, Any]) -> None:
        await self._socket.send_str(json.dumps(message))

    def _read(self) -> None:
        assert self._process.stdout is not None
        for _ in self._process.stdout:
            self._line_s = time.perf_counter()
            self._has_line.set()


class _Disk:
    """SQLite alone: commits as many bytes as the rows of a transition have, without a thread."""

    def __init__(self, file: Path) -> None:
        self._connection = sqlite3.connect(str(file), isolation_level=None)
        for statement in ("PRAGMA journal_mode = WAL", "PRAGMA synchronous = NORMAL", "CREATE TABLE kept (row BLOB)"):
            self._connection.execute(statement)
        self.close = self._connection.close

    async def measure_s(self) -> float:
        """Commits a transition, its evidence of 60 samples, a state and a notification; returns the time in s."""
        began_s = time.perf_counter()
        self._connection.execute("BEGIN IMMEDIATE")
        for size in (300, 728, 400, 1000):
            self._connection.execute("INSERT INTO kept VALUES (?)", (bytes(size),))
        self._connection.execute("COMMIT")
        return time.perf_counter() - began_s


async def measure(count: int, folder: Path) -> Dict[str, List[float]]:
    """Returns the times in s, by contestant."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Target)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()
    url = f"http://127.0.0.1:{server.server_address[1]}"
    urls = {**{f"stuck{number}": f"{url}/hang" for number in range(4)}, "chat": url}
    ops = folder / "ops.yaml"
    notify = {name: {"type": "webhook", "url": url} for name, url in urls.items()}
    ops.write_text(json.dumps({"history": {"file": "run.db"}, "notify": notify}))
    recording = folder / "recording.yaml"
    recording.write_text(json.dumps({"history": {"file": "recorded.db"}, "black_box": {"folder": "black_box"}}))
    async with AsyncExitStack() as stack:
        session = await stack.enter_async_context(aiohttp.ClientSession())
        stack.callback(_Target.hangs_until.set)
        processes = {
            "run": _Process(folder / "without"),
            "run with": _Process(folder / "with", "--ops", str(ops)),
            "run recording": _Process(folder / "recording", "--ops", str(recording)),
        }
        for process in processes.values():
            await process.connect(session)
            stack.push_async_callback(process.close)
        measurements: Dict[str, Callable[[], Awaitable[float]]] = {
            **{name: process.measure_s for name, process in processes.items()},
            "disk": stack.enter_context(closing(_Disk(folder / "disk.db"))).measure_s,
        }
        found: Dict[str, List[float]] = {name: [] for name in measurements}
        for _ in range(count):
            for name, measure_s in measurements.items():
                await asyncio.sleep(PAUSE_S)
                found[name].append(await measure_s())
    server.shutdown()
    return found


def rows(count: int = TRANSITIONS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with tempfile.TemporaryDirectory() as folder:
        found = asyncio.run(measure(count, Path(folder)))
    median = {name: statistics.median(times) for name, times in found.items()}

    def figure(name: str) -> str:
        return f"{median[name] * 1e6:.0f} us, worst {max(found[name]) * 1e3:.1f} ms"

    what, remark = f"sample to alert at a client and on stdout, {count:,} alerts", "to without, after one disk write"
    yield Row("one disk write", "SQLite, the bytes of a transition", figure("disk"))
    yield Row(what, "without history", figure("run"))
    for name, contestant in (
        ("run with", "history, five targets, four hang"),
        ("run recording", "history, samples, black box"),
    ):
        ratio = (median[name] - median["disk"]) / median["run"]
        yield Row(what, contestant, figure(name), ratio, REQUIRED_RATIO, remark)
