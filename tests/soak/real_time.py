"""`robot-health run` in real time, with clients that connect, behave in different ways, and leave."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import socket as sockets
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, Awaitable, Callable, Sequence, Tuple

import aiohttp
import psutil
from harness.line_process import LineProcess
from soak.figures import Figure, count, flat

ROOT = Path(__file__).resolve().parents[2]
CONFIGURATION = """
alert_system:
  ros__parameters:
    robot_name: atlas
    signals:
      battery_level: {unit: "%", valid_min: 0.0, valid_max: 100.0, warn_below: 80.0, error_below: 30.0}
      cpu_usage: {unit: "%", statistic: mean, window_s: 10.0, warn_above: 50.0, flap_detection: true}
battery_sensor:
  ros__parameters:
    publish_rate: 20.0
    battery_level: {discharge_rate: 100.0, charge_rate: 200.0}
    temperature: {source: none}
"""
CLIENTS = 12
"""Clients at the same time."""
QUIET_S = 5.0
"""Longest wait until the server has closed everything of clients that have left."""
ALLOWED_MB, ALLOWED_MB_SHORT = 3.0, 30.0
SHORT_S = 50.0
"""A shorter run is mostly warm-up."""
TOPICS = ("/battery_level", "/alerts", "/diagnostics", "/rosout", "/system_health", "/none")
SERVICES = ("/rosapi/topics", "/rosapi/nodes", "/alert_system/reset", "/rosapi/get_time", "/none")

Point = Tuple[float, float]


def run(duration_s: float, seed: int) -> list[Figure]:
    """Runs the monitor and its clients; returns the figures of its process."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "soak.yaml"
        file.write_text(CONFIGURATION, encoding="utf-8")
        variables = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}
        command = [sys.executable, "-m", "robot_health_monitor", "run", "--port", "0", "--thresholds", str(file)]
        process = LineProcess(command, variables)
        try:
            port = int(process.wait_for_text("serving on ws://").rsplit(":", 1)[1])
            return asyncio.run(_soak(process, port, duration_s, random.Random(seed)))
        finally:
            process.end()


async def _soak(process: LineProcess, port: int, duration_s: float, chance: random.Random) -> list[Figure]:
    watched = psutil.Process(process.pid)
    memory: list[Point] = []
    threads: list[Point] = []
    files: list[Point] = []
    alerts = Alerts(process)
    quiet_files = watched.num_fds()
    start_s = time.monotonic()
    clients = 0
    while time.monotonic() < start_s + duration_s:
        behaviours = [chance.choice(BEHAVIOURS) for _ in range(CLIENTS)]
        await asyncio.gather(*(_safely(behave, port, random.Random(chance.random())) for behave in behaviours))
        clients += len(behaviours)
        give_up_s = time.monotonic() + QUIET_S
        while watched.num_fds() > quiet_files and time.monotonic() < give_up_s:
            await asyncio.sleep(0.02)
        now_s = time.monotonic() - start_s
        memory.append((now_s, watched.memory_info().rss / 2**20))
        threads.append((now_s, watched.num_threads()))
        files.append((now_s, watched.num_fds()))
    process.signal()
    exit_code = process.wait()
    alerts.end()
    allowed_mb = ALLOWED_MB if duration_s >= SHORT_S else ALLOWED_MB_SHORT
    return [
        Figure("seconds in real time", 0.0, duration_s, 0.0, 0.0, ""),
        count("  clients", clients, CLIENTS),
        count("  alert lines", alerts.number, duration_s),
        flat("  memory (RSS)", memory, allowed_mb, "MB"),
        flat("  threads", threads, 0.5, "threads"),
        flat("  file descriptors", files, 0.5, "files"),
        Figure("  exit code", 0.0, exit_code, abs(exit_code), 0.0, ""),
        Figure("  lines on stderr", 0.0, len(process.errors), len(process.errors), 0.0, ""),
    ]


class Alerts:
    """Reads the output of a process all the time, and counts the alerts."""

    def __init__(self, process: LineProcess) -> None:
        self.number = 0
        self._process = process
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._ended.set()
        self._thread.join(5.0)
        self._count()

    def _read(self) -> None:
        while not self._ended.is_set():
            with contextlib.suppress(AssertionError):  # the deadline, or the end of the process
                self._process.wait_for_line(lambda line: False, deadline_s=0.5)
            self._count()

    def _count(self) -> None:
        lines = list(self._process.lines)
        self._process.lines[:] = [line for line in lines if line.stream == "err"]  # the rest would fill the memory
        self.number += sum(" battery_level " in line.text for line in lines if line.stream == "out")


async def _safely(behave: Callable[[int, random.Random], Awaitable[None]], port: int, chance: random.Random) -> None:
    """The server may refuse or close a connection at any time."""
    with contextlib.suppress(OSError, aiohttp.ClientError, asyncio.TimeoutError, EOFError):
        await asyncio.wait_for(behave(port, chance), 10.0)


async def _read_and_leave(port: int, chance: random.Random) -> None:
    async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{port}/") as socket:
        for topic in chance.sample(TOPICS, 3):
            await socket.send_json({"op": "subscribe", "topic": topic, **_options(chance)})
        for _ in range(10):
            await socket.receive(timeout=1.0)
        await socket.send_json({"op": "unsubscribe", "topic": "/battery_level"})


async def _call_services(port: int, chance: random.Random) -> None:
    async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{port}/") as socket:
        for service in SERVICES:
            await socket.send_json({"op": "call_service", "service": service, "args": {}})
            await socket.receive(timeout=1.0)


async def _cut_off(port: int, chance: random.Random) -> None:
    """Subscribes to everything, never reads, and resets the connection."""
    async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{port}/") as socket:
        for topic in TOPICS:
            await socket.send_json({"op": "subscribe", "topic": topic, **_options(chance)})
        await asyncio.sleep(chance.random())
        socket.get_extra_info("socket").setsockopt(sockets.SOL_SOCKET, sockets.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        await session.close()


async def _send_garbage(port: int, chance: random.Random) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(bytes(chance.randrange(256) for _ in range(chance.randrange(1, 2000))) + b"\r\n\r\n")
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(reader.read(), 0.5)
    writer.close()


async def _send_nonsense(port: int, chance: random.Random) -> None:
    async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{port}/") as socket:
        for text in ("{", "[]", json.dumps({"op": "publish", "topic": "/x", "msg": {}}), '{"op":"fragment","id":1}'):
            await socket.send_str(text)
        await socket.send_bytes(bytes(chance.randrange(256) for _ in range(1000)))
        await socket.send_json({"op": "call_service", "service": "/rosapi/get_time", "id": "end"})
        await socket.receive(timeout=1.0)


async def _ask_by_http(port: int, chance: random.Random) -> None:
    url = f"http://127.0.0.1:{port}/{chance.random()}"
    async with aiohttp.ClientSession() as session, session.get(url) as response:
        await response.read()


BEHAVIOURS: Sequence[Callable[[int, random.Random], Awaitable[None]]] = (
    _read_and_leave,
    _call_services,
    _cut_off,
    _send_garbage,
    _send_nonsense,
    _ask_by_http,
)


def _options(chance: random.Random) -> dict[str, Any]:
    options: dict[str, Any] = {"compression": chance.choice(("none", "png", "cbor"))}
    if chance.random() < 0.3:
        options.update(throttle_rate=100, queue_length=5)
    return options
