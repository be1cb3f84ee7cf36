"""Time from a sample to its alert, with a history and five targets of which four hang, with a black box, and without.

Three `robot-health run` take the same samples in turn from a rosbridge client. Each sample crosses the bound, so each
is an alert. Measured in the same round, on the same disk: one write, which is the rows of one transition committed by
SQLite alone.
"""

from __future__ import annotations

import asyncio
import itertools
import socket
import sqlite3
import statistics
import sys
import tempfile
import time
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Awaitable, Callable, Iterator, Mapping

import aiohttp
from aiohttp import web
from harness.reserved import free_port

from benchmarks.peers import listen, read_lines
from benchmarks.processes import Process, alert_system, write_yaml
from benchmarks.table import Row, figure

PAUSE_S = 0.005
"""Pause before each measurement, in s: four contestants, so an alert_system alerts 40 times a second at most."""
DEADLINE_S = 30.0
_BATTERY: Mapping[str, Any] = {"warn_below": 20.0, "stale_after_s": 0.0, "window_samples": 60}
_SIGNALS = tuple(f"battery_{number}" for number in range(40))
"""A signal that announced more than 60 transitions within the last 60 s would flap."""
DISK, PLAIN = "SQLite, the bytes of a transition", "without history"
HISTORY, BLACK_BOX = "history, five targets, four hang", "history, samples, black box"


async def _run(stack: AsyncExitStack, folder: Path, ops: object) -> Callable[[], Awaitable[object]]:
    """Starts `robot-health run`, which ends with the stack, and a client that publishes samples and receives alerts.

    Returns what sends a sample that changes the level, and waits until message and line have come.
    """
    folder.mkdir()
    port = free_port()
    write_yaml(folder, thresholds=alert_system(dict.fromkeys(_SIGNALS, _BATTERY), robot_name="r3"), ops=ops)
    command = [sys.executable, "-m", "robot_health_monitor", "run", "--json", "--port", port, "--allow-publish", "*"]
    command += ["--source", "none", "--thresholds", folder / "thresholds.yaml", "--ops", folder / "ops.yaml"]
    process = stack.enter_context(Process(command, answers=True))
    output = await read_lines(process.stdout)
    process.wait_for_port(port)
    session = await stack.enter_async_context(aiohttp.ClientSession())
    client = await session.ws_connect(f"ws://127.0.0.1:{port}")
    for signal in _SIGNALS:
        await client.send_json({"op": "advertise", "topic": f"/{signal}", "type": "std_msgs/Float32"})
    await client.send_json({"op": "subscribe", "topic": "/alerts", "type": "diagnostic_msgs/DiagnosticStatus"})
    await asyncio.sleep(1.0)
    samples = itertools.cycle(itertools.product((10.0, 30.0), _SIGNALS))

    async def measure() -> None:
        value, signal = next(samples)
        await client.send_json({"op": "publish", "topic": f"/{signal}", "msg": {"data": value}})
        await asyncio.wait_for(asyncio.gather(client.receive_str(), output.readline()), DEADLINE_S)

    return measure


def _disk(file: Path) -> Callable[[], Awaitable[object]]:
    """Returns what commits a transition, its evidence of 60 samples, a state and a notification, without a thread."""
    connection = sqlite3.connect(str(file), isolation_level=None)
    for statement in ("PRAGMA journal_mode = WAL", "PRAGMA synchronous = NORMAL", "CREATE TABLE kept (row BLOB)"):
        connection.execute(statement)

    async def measure() -> None:
        connection.execute("BEGIN IMMEDIATE")
        connection.executemany("INSERT INTO kept VALUES (?)", [(bytes(size),) for size in (300, 728, 400, 1000)])
        connection.execute("COMMIT")

    return measure


async def _measure(count: int, folder: Path) -> dict[str, list[float]]:
    """Returns the times in s, by contestant."""

    async def chat(request: web.Request) -> web.Response:
        await request.read()
        return web.Response()

    hanging = socket.create_server(("127.0.0.1", 0))  # accepts nothing
    ports = {"chat": await listen(chat), **dict.fromkeys(("a", "b", "c", "d"), hanging.getsockname()[1])}
    notify = {name: {"type": "webhook", "url": f"http://127.0.0.1:{port}"} for name, port in ports.items()}
    history = {"history": {"file": "run.db"}}
    recording = {**history, "black_box": {"folder": "black_box"}}
    operations = {PLAIN: {}, HISTORY: {**history, "notify": notify}, BLACK_BOX: recording}
    async with AsyncExitStack() as stack:
        # At the same time: a client that waits for the others does not answer pings.
        runs = await asyncio.gather(*(_run(stack, folder / str(at), ops) for at, ops in enumerate(operations.values())))
        contestants = {**dict(zip(operations, runs)), DISK: _disk(folder / "disk.db")}
        times_s: dict[str, list[float]] = {name: [] for name in contestants}
        for _, (name, measure) in itertools.product(range(count), contestants.items()):
            await asyncio.sleep(PAUSE_S)
            began_s = time.perf_counter()
            await measure()
            times_s[name].append(time.perf_counter() - began_s)
    return times_s


def rows(count: int = 1000) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with tempfile.TemporaryDirectory() as folder:
        times_s = asyncio.run(_measure(count, Path(folder)))
    median = {name: statistics.median(each) for name, each in times_s.items()}
    figures = {name: f"{figure(median[name], 'us')}, worst {figure(max(each), 'ms')}" for name, each in times_s.items()}
    what, remark = f"sample to alert at a client and on stdout, {count:,} alerts", "to without, after one disk write"
    yield Row("one disk write", DISK, figures[DISK])
    yield Row(what, PLAIN, figures[PLAIN])
    for name in (HISTORY, BLACK_BOX):
        yield Row(what, name, figures[name], (median[name] - median[DISK]) / median[PLAIN], 1.5, remark)
