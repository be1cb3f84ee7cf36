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
import re
import sqlite3
import statistics
import sys
import tempfile
import time
from asyncio.subprocess import PIPE
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping

import aiohttp
from aiohttp import web

from benchmarks.table import ROOT, Row

TRANSITIONS = 1_000
PAUSE_S = 0.005
"""Pause before each measurement, in s: four contestants, so an alert_system alerts 40 times a second at most."""
DEADLINE_S = 30.0
_BATTERY: Mapping[str, Any] = {"warn_below": 20.0, "stale_after_s": 0.0, "window_samples": 60}
_SIGNALS = tuple(f"battery_{number}" for number in range(40))
"""A signal that announced more than 60 transitions within the last 60 s would flap."""


class _Run:
    """`robot-health run`, measured from outside."""

    async def start(self, stack: AsyncExitStack, folder: Path, ops: Any) -> None:
        """Starts it; it ends with the stack."""
        folder.mkdir()
        parameters = {"robot_name": "r3", "signals": dict.fromkeys(_SIGNALS, _BATTERY)}
        thresholds = {"alert_system": {"ros__parameters": parameters}}
        for name, tree in (("thresholds.yaml", thresholds), ("ops.yaml", ops)):
            (folder / name).write_text(json.dumps(tree))  # JSON is YAML
        command = ["run", "--thresholds", folder / "thresholds.yaml", "--source", "none", "--json", "--port", "0"]
        command += ["--allow-publish", "*", *(["--ops", folder / "ops.yaml"] if ops else [])]
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "robot_health_monitor", *map(str, command), cwd=ROOT, stdout=PIPE, stderr=PIPE
        )
        stack.push_async_callback(self._process.wait)
        stack.callback(self._process.kill)

    async def connect(self, session: aiohttp.ClientSession) -> None:
        """Connects a client that publishes samples and receives alerts."""
        assert self._process.stderr is not None
        served = None
        while served is None:
            line = (await self._process.stderr.readline()).decode()
            assert line, "robot-health run has ended"
            served = re.search(r"ws://127\.0\.0\.1:\d+", line)
        self._rest = asyncio.ensure_future(self._process.stderr.read())
        self._socket = await session.ws_connect(served[0])
        for signal in _SIGNALS:
            await self._socket.send_json({"op": "advertise", "topic": f"/{signal}", "type": "std_msgs/Float32"})
        await self._socket.send_json(
            {"op": "subscribe", "topic": "/alerts", "type": "diagnostic_msgs/DiagnosticStatus"}
        )
        await asyncio.sleep(1.0)
        self._values, self._turns = dict.fromkeys(_SIGNALS, 30.0), itertools.cycle(_SIGNALS)

    async def measure_s(self) -> float:
        """Sends a sample that changes the level; returns the time until message and line have come, in s."""
        assert self._process.stdout is not None
        signal = next(self._turns)
        self._values[signal] = 40.0 - self._values[signal]
        began_s = time.perf_counter()
        message = {"op": "publish", "topic": f"/{signal}", "msg": {"data": self._values[signal]}}
        await self._socket.send_json(message)
        both = asyncio.gather(self._socket.receive_str(), self._process.stdout.readline())
        await asyncio.wait_for(both, DEADLINE_S)
        return time.perf_counter() - began_s


class _Disk:
    """SQLite alone: commits as many bytes as the rows of a transition have, without a thread."""

    def __init__(self, file: Path) -> None:
        self._connection = sqlite3.connect(str(file), isolation_level=None)
        for statement in ("PRAGMA journal_mode = WAL", "PRAGMA synchronous = NORMAL", "CREATE TABLE kept (row BLOB)"):
            self._connection.execute(statement)

    async def measure_s(self) -> float:
        """Commits a transition, its evidence of 60 samples, a state and a notification; returns the time in s."""
        began_s = time.perf_counter()
        self._connection.execute("BEGIN IMMEDIATE")
        for size in (300, 728, 400, 1000):
            self._connection.execute("INSERT INTO kept VALUES (?)", (bytes(size),))
        self._connection.execute("COMMIT")
        return time.perf_counter() - began_s


async def _measure(count: int, folder: Path) -> Dict[str, List[float]]:
    """Returns the times in s, by contestant."""
    ended = asyncio.Event()

    async def target(request: web.Request) -> web.Response:
        await request.read()
        if request.path == "/hang":
            await ended.wait()
        return web.Response()

    async with AsyncExitStack() as stack:
        server = web.Server(target)
        listener = await asyncio.get_running_loop().create_server(server, "127.0.0.1", 0)
        stack.callback(listener.close)
        stack.callback(ended.set)
        url = f"http://127.0.0.1:{listener.sockets[0].getsockname()[1]}"
        urls = {**{f"stuck{number}": f"{url}/hang" for number in range(4)}, "chat": url}
        notify = {name: {"type": "webhook", "url": url} for name, url in urls.items()}
        recording = {"history": {"file": "run.db"}, "black_box": {"folder": "black_box"}}
        contestants: Dict[str, Any] = {name: _Run() for name in ("run", "run with", "run recording")}
        session = await stack.enter_async_context(aiohttp.ClientSession())
        for run, ops in zip(contestants.values(), ({}, {"history": {"file": "run.db"}, "notify": notify}, recording)):
            await run.start(stack, folder / str(len(list(folder.iterdir()))), ops)
        for run in contestants.values():
            await run.connect(session)
        contestants["disk"] = _Disk(folder / "disk.db")
        times_s: Dict[str, List[float]] = {name: [] for name in contestants}
        for _ in range(count):
            for name, contestant in contestants.items():
                await asyncio.sleep(PAUSE_S)
                times_s[name].append(await contestant.measure_s())
    return times_s


def rows(count: int = TRANSITIONS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with tempfile.TemporaryDirectory() as folder:
        times_s = asyncio.run(_measure(count, Path(folder)))
    median = {name: statistics.median(each) for name, each in times_s.items()}
    figure = {name: f"{median[name] * 1e6:.0f} us, worst {max(each) * 1e3:.1f} ms" for name, each in times_s.items()}
    what, remark = f"sample to alert at a client and on stdout, {count:,} alerts", "to without, after one disk write"
    yield Row("one disk write", "SQLite, the bytes of a transition", figure["disk"])
    yield Row(what, "without history", figure["run"])
    names = {"run with": "history, five targets, four hang", "run recording": "history, samples, black box"}
    for name, contestant in names.items():
        yield Row(what, contestant, figure[name], (median[name] - median["disk"]) / median["run"], 1.5, remark)
