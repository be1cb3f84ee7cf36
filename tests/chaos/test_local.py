"""Chaos around `robot-health run`: the local middleware and its rosbridge server."""

from __future__ import annotations

import contextlib
import glob
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import urllib.request
from functools import partial
from pathlib import Path
from typing import Any, Callable, Iterator

import cbor2
import pytest
from harness.chaos import DEADLINE_S, Robot, check_stderr, end, kill, trial_of
from harness.line_process import LineProcess
from harness.unread import fill
from harness.waiting import wait_for

ROUNDS = 4
HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def frame(data: bytes, first: int = 0x81) -> bytes:
    """Returns a client's frame, masked with zeros."""
    return bytes([first, 0x80 | 127]) + len(data).to_bytes(8, "big") + bytes(4) + data


def options(port: int, thresholds: Path) -> list[object]:
    allowed = ("--allow-publish", "/battery_level")
    return ["run", "--source", "none", "--port", port, "--thresholds", thresholds, *allowed]


class Hostile:
    """Clients that connect and leave, send garbage, bombs and huge messages, and never read."""

    def __init__(self, port: int, seed: int) -> None:
        self._port = port
        self._chance = random.Random(seed)
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._run, daemon=True) for _ in range(3)]

    def __enter__(self) -> Hostile:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(20.0)

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                with socket.create_connection(("127.0.0.1", self._port), 2.0) as connection:
                    connection.sendall(self._chance.choice(ATTACKS)(self._chance))
                    if self._chance.random() < 0.3:
                        connection.settimeout(0.2)
                        connection.recv(100)
            except OSError:
                self._ended.wait(0.01)


def garbage(chance: random.Random) -> bytes:
    return bytes(chance.randrange(256) for _ in range(500)) + b"\r\n\r\n"


def bomb(chance: random.Random) -> bytes:
    """A list that contains itself by shared references, twice per level."""
    item: Any = b"\x80"
    for level in range(25):
        item = b"\xd8\x1c\x82" + item + b"\xd8\x1d" + cbor2.dumps(level)
    return HANDSHAKE + frame(b"\xa2\x62op\x67publish\x63msg" + item, 0x82)


def huge(chance: random.Random) -> bytes:
    return HANDSHAKE + frame(b'{"op":"publish","topic":"/battery_level","msg":{"data":"' + b"x" * 1_200_000)


def nested(chance: random.Random) -> bytes:
    return HANDSHAKE + frame(b'{"op":"publish","topic":"/x","msg":' + b"[" * 5_000 + b"]" * 5_000 + b"}")


def unread(chance: random.Random) -> bytes:
    return HANDSHAKE + b"".join(
        frame(b'{"op":"subscribe","topic":"%s","compression":"png"}' % topic)
        for topic in (b"/battery_level", b"/diagnostics", b"/rosout")
    )


ATTACKS = (garbage, bomb, huge, nested, unread, lambda chance: b"", lambda chance: HANDSHAKE)


def test_hostile_clients_cost_no_alert(robot_health: Any, robot: Any, thresholds: Path, port: int, seed: int) -> None:
    process = robot_health(*options(port, thresholds))
    process.wait_for_text("serving on")
    trial = trial_of(robot("rosbridge_peer", f"http://127.0.0.1:{port}/"), seed)
    with Hostile(port, seed):
        for _ in range(ROUNDS * 3):
            trial.change(trial.pause)
    trial.finish()
    end(process)


class HalfOpen:
    """Clients without the token that hold half a request each, more than there is room for, and open lost ones anew."""

    REQUESTS = (
        b"POST /api/login HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Content-Length: 30\r\n\r\n{}",
        HANDSHAKE + b"\x81",
        b"GET /api/events HTTP/1.1\r\nHost: localhost\r\nCookie: robot_health=1.2.3\r\n\r\n",
    )
    COUNT = 520

    def __init__(self, port: int, seed: int) -> None:
        self._port = port
        self._chance = random.Random(seed)
        self._ended = threading.Event()
        self._held: list[socket.socket] = []
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> HalfOpen:
        self._thread.start()
        wait_for(lambda: len(self._held) >= self.COUNT)
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._thread.join(20.0)
        for connection in self._held:
            connection.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            if len(self._held) > self.COUNT:
                self._held.pop(self._chance.randrange(self.COUNT)).close()
            request = self._chance.choice(self.REQUESTS)
            try:
                connection = socket.create_connection(("127.0.0.1", self._port), 2.0)
                self._held.append(connection)
                connection.sendall(request[: self._chance.randrange(len(request) + 1)])
            except OSError:
                self._ended.wait(0.01)


@pytest.mark.newest_python
def test_half_open_connections_cost_no_alert_and_no_request(
    robot_health: Any, robot: Any, thresholds: Path, port: int, seed: int, tmp_path: Path
) -> None:
    token = "0123456789abcdef"
    (tmp_path / "token").write_text(token, encoding="ascii")
    (tmp_path / "token").chmod(0o600)
    process = robot_health(*options(port, thresholds), "--token-file", tmp_path / "token")
    process.wait_for_text("serving on")
    trial = trial_of(robot("rosbridge_peer", f"http://127.0.0.1:{port}/?token={token}"), seed)
    with HalfOpen(port, seed):
        for _ in range(ROUNDS * 3):
            trial.change(trial.pause)
            for path in ("api/state", "healthz"):
                headers = {"Authorization": f"Bearer {token}"} if path == "api/state" else {}
                request = urllib.request.Request(f"http://127.0.0.1:{port}/{path}", headers=headers)
                with urllib.request.urlopen(request, timeout=DEADLINE_S) as response:
                    assert response.status == 200
    trial.finish()
    end(process)


def damage(file: Path, chance: random.Random) -> None:
    """Gives every row of some columns an unexpected value, as another program or a bad disk may do."""
    connection = sqlite3.connect(str(file), timeout=DEADLINE_S, isolation_level=None)
    query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
    for (table,) in connection.execute(query).fetchall():
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
        with contextlib.suppress(sqlite3.Error):  # a key
            connection.execute(f"UPDATE {table} SET {chance.choice(columns)} = ?", (chance.choice(ODD),))
    connection.close()


ODD = ("text", 9e999, 2**63 - 1, b"\xff\x00", None, "", -1)


@pytest.mark.newest_python
def test_odd_rows_in_the_history_cost_no_alert(
    robot_health: Any, robot: Any, thresholds: Path, port: int, seed: int, tmp_path: Path
) -> None:
    file, ops = tmp_path / "history.db", tmp_path / "ops.yaml"
    ops.write_text(f"history: {{file: {file}}}\nnotify: {{gone: {{type: webhook, url: 'http://127.0.0.1:9'}}}}\n")
    process = robot_health(*options(port, thresholds), "--ops", ops)
    process.wait_for_text("serving on")
    trial = trial_of(robot("rosbridge_peer", f"http://127.0.0.1:{port}/"), seed)
    chance = random.Random(seed)
    for _ in range(ROUNDS * 2):
        trial.change(trial.pause)
        damage(file, chance)
    trial.finish()
    end(process)


class WallClock:
    """The wall clock of a process, which can be set while it runs. Its monotonic clock stays."""

    def __init__(self, folder: Path) -> None:
        libraries = glob.glob("/usr/lib/*/faketime/libfaketime.so.1")
        if not libraries:
            pytest.skip("needs Debian's package faketime")
        self._file = folder / "clock"
        self.variables = {
            "LD_PRELOAD": libraries[0],
            "FAKETIME_TIMESTAMP_FILE": str(self._file),
            "FAKETIME_CACHE_DURATION": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        }

    def set(self, offset: str) -> None:
        """Sets the clock: `+300d` is 300 days fast. Takes effect within a second."""
        new = self._file.with_suffix(".new")
        new.write_text(offset, encoding="ascii")
        new.replace(self._file)


@pytest.mark.newest_python
def test_a_wrong_clock_that_is_set_right_costs_no_alert(
    robot: Any, environment: dict[str, str], thresholds: Path, port: int, seed: int, tmp_path: Path
) -> None:
    clock = WallClock(tmp_path)
    clock.set("+300d")
    file, ops = tmp_path / "history.db", tmp_path / "ops.yaml"
    ops.write_text(f"history: {{file: {file}}}\nnotify: {{gone: {{type: webhook, url: 'http://127.0.0.1:9'}}}}\n")
    command = [sys.executable, "-m", "robot_health_monitor"]
    process = LineProcess(
        [*command, *map(str, options(port, thresholds)), "--ops", str(ops)], {**environment, **clock.variables}
    )
    process.wait_for_text("serving on")
    trial = trial_of(robot("rosbridge_peer", f"http://127.0.0.1:{port}/"), seed)
    trial.change(trial.pause)
    for offset in ("+0d", "-2d", "+1h", "+0d"):
        clock.set(offset)
        for _ in range(ROUNDS):
            trial.change(lambda: trial.pause(0.6))
    trial.finish()
    end(process)


def test_a_monitor_that_is_killed_or_stopped_recovers(
    robot_health: Any, robot: Any, thresholds: Path, port: int, seed: int
) -> None:
    process = robot_health(*options(port, thresholds))
    process.wait_for_text("serving on")
    peer: Robot = robot("rosbridge_peer", f"http://127.0.0.1:{port}/")
    trial = trial_of(peer, seed)
    for _ in range(ROUNDS):
        trial.change(trial.pause)
        trial.change(partial(trial.stop, process, 2.0))
        trial.pause()
        kill(process)
        peer.wait_for_arrivals()
        trial.restarted()
        process = robot_health(*options(port, thresholds))
        process.wait_for_text("serving on")
        trial.wait_for_alert()
    trial.finish()
    end(process)


@pytest.fixture
def start_with(environment: dict[str, str]) -> Iterator[Callable[..., Any]]:
    """Starts `robot-health` with the given streams."""
    started: list[Any] = []

    def start(arguments: list[object], **streams: Any) -> Any:
        words = [sys.executable, "-m", "robot_health_monitor", *map(str, arguments)]
        started.append(subprocess.Popen(words, env=environment, stdin=subprocess.DEVNULL, **streams))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.newest_python
@pytest.mark.parametrize("stdout", ["/dev/full", "an unread terminal", "an unread pipe"])
def test_an_output_that_cannot_be_written_costs_no_alert(
    start_with: Any, robot: Any, thresholds: Path, port: int, seed: int, tmp_path: Path, stdout: str
) -> None:
    opened: list[int] = []
    if stdout == "/dev/full":
        opened = [os.open("/dev/full", os.O_WRONLY)] * 2
    else:
        opened = list(os.openpty() if "terminal" in stdout else os.pipe())
        fill(opened[1])
    with open(tmp_path / "stderr", "w+") as errors:
        process = start_with(options(port, thresholds), stdout=opened[1], stderr=errors)
        trial = trial_of(robot("rosbridge_peer", f"http://127.0.0.1:{port}/"), seed)
        for _ in range(ROUNDS * 2):
            trial.change(trial.pause)
        trial.finish()
        process.send_signal(signal.SIGTERM)
        assert process.wait(DEADLINE_S) == 0
        errors.seek(0)
        check_stderr(errors.read().splitlines())
    for file in set(opened):
        os.close(file)
