"""A real monitor that is killed with -9 within a silence, or while a signal settles: nothing is repeated or lost."""

from __future__ import annotations

import asyncio
import json
import urllib.request
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from harness import reserved
from harness.histories import stored_texts
from harness.line_process import LineProcess
from harness.waiting import wait_for

pytest.importorskip("aiohttp")

from aiohttp import ClientError, ClientSession

from robot_health_monitor.runtime.event_loops import LoopThread

pytestmark = pytest.mark.newest_python

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      low: {topic: /scan, warn_below: 1.0, stale_after_s: 1.0}
      high: {topic: /scan, warn_above: 99.0, stale_after_s: 1.0}
      motor: {topic: /motor, error_above: 90.0}
      wheel: {topic: /wheel, warn_below: 1.0, depends_on: [motor], for_s: 3.0}
"""


class Driver:
    """A driver that publishes its `values`, by topic, all the time, to whichever monitor is there."""

    def __init__(self, port: int) -> None:
        self.values: dict[str, float] = {}
        self._thread = LoopThread("driver")
        asyncio.run_coroutine_threadsafe(self._run(port), self._thread.loop)

    async def _run(self, port: int) -> None:
        while True:
            try:
                async with ClientSession() as session, session.ws_connect(f"ws://127.0.0.1:{port}") as socket:
                    for topic in ("/scan", "/motor", "/wheel"):
                        await socket.send_json({"op": "advertise", "topic": topic, "type": "std_msgs/Float32"})
                    while not socket.closed:
                        for topic, value in list(self.values.items()):
                            await socket.send_json({"op": "publish", "topic": topic, "msg": {"data": value}})
                        await asyncio.sleep(0.05)
            except (ClientError, ConnectionError):
                await asyncio.sleep(0.05)

    def close(self) -> None:
        self._thread.close()


class Monitor:
    """A monitor with a history, as a process that can be killed and started again."""

    def __init__(self, start: Callable[..., LineProcess], port: int, folder: Path) -> None:
        self._start, self._port = start, port
        self.history = folder / "history.db"
        self._thresholds, self._ops = folder / "thresholds.yaml", folder / "ops.yaml"
        self._thresholds.write_text(THRESHOLDS)
        self._ops.write_text(json.dumps({"history": {"file": str(self.history)}}))
        self.start()

    def start(self) -> None:
        files = ("--thresholds", self._thresholds, "--ops", self._ops)
        allowed = [word for topic in ("scan", "motor", "wheel") for word in ("--allow-publish", f"/{topic}")]
        self.process = self._start("run", "--robot", "r1", "--source", "none", "--port", self._port, *files, *allowed)
        self.process.wait_for_text("serving on")

    def kill(self) -> None:
        self.process.signal(9)
        assert self.process.wait() == -9

    def signal(self, name: str) -> dict[str, Any]:
        """Returns the status of a signal, as the page gets it."""
        with urllib.request.urlopen(f"http://127.0.0.1:{self._port}/api/state", timeout=10.0) as response:
            status: dict[str, Any] = json.load(response)["robots"]["r1"]["signals"][name]
        return status

    def stored(self) -> list[str]:
        return [text.partition(" (")[0] for text in stored_texts(self.history)]


@pytest.fixture
def port() -> int:
    return reserved.free_port()


@pytest.fixture
def driver(port: int) -> Iterator[Driver]:
    driver = Driver(port)
    yield driver
    driver.close()


def test_killed_within_a_silence(robot_health: Any, driver: Driver, port: int, tmp_path: Path) -> None:
    monitor = Monitor(robot_health, port, tmp_path)
    driver.values = {"/scan": 50.0}
    wait_for(lambda: monitor.signal("high")["level"] == "OK")
    driver.values = {}
    stale = monitor.process.wait_for_text("/scan STALE: no message for")
    assert "2 signals" in stale
    monitor.kill()
    monitor.start()
    wait_for(lambda: monitor.signal("high").get("cause") == "/scan")
    driver.values = {"/scan": 50.0}
    monitor.process.wait_for_text("/scan OK: messages again: 2 signals")
    wait_for(lambda: monitor.signal("high")["level"] == "OK")
    assert [line.text for line in monitor.process.lines if "STALE:" in line.text] == []
    assert [text.partition(":")[0] for text in monitor.stored()] == ["/scan STALE", "/scan OK"]


def test_killed_while_a_signal_settles(robot_health: Any, driver: Driver, port: int, tmp_path: Path) -> None:
    monitor = Monitor(robot_health, port, tmp_path)
    driver.values = {"/motor": 95.0, "/wheel": 0.0}
    monitor.process.wait_for_text("motor ERROR: 95 is above 90")
    wait_for(lambda: monitor.signal("wheel").get("cause") == "motor")
    driver.values = {"/motor": 50.0, "/wheel": 0.0}
    monitor.process.wait_for_text("motor OK:")
    monitor.kill()
    assert monitor.stored() == ["motor ERROR: 95 is above 90", "motor OK: 50 is no longer above 90"]
    monitor.start()
    announced = monitor.process.wait_for_text("wheel WARN: 0 is below 1")
    assert "was caused by motor for" in announced
    assert monitor.stored() == [
        "motor ERROR: 95 is above 90",
        "motor OK: 50 is no longer above 90",
        "wheel WARN: 0 is below 1",
    ]
