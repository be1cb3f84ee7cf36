"""What the harnesses of robots behind a socket share: a bus on the far side, whose time moves with /clock."""

from __future__ import annotations

import asyncio
import itertools
import threading
from typing import Any, Callable, Mapping, Sequence

from harness.parameters import set_parameter
from harness.port_conformance import START_S, LogLine, poll_until
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.runtime.event_loops import LoopThread


class BridgedBus:
    """The part of a `Harness` that does not depend on the protocol.

    A subclass starts its server on the loop `robot`, calls `make_client` and `run_client`, and defines `settle`.
    """

    def __init__(self) -> None:
        self._now_s = START_S
        self.robot = LoopThread("robot")
        self.bus = LocalBus(START_S)
        self.outside = self.bus.node("outside")
        self.outside.advertise("/clock", "rosgraph_msgs/Clock")
        self._up, self._pause = threading.Event(), threading.Event()
        self._nodes: list[Any] = []

    def make_client(self, kind: Callable[..., Any], url: str) -> None:
        up = self._up
        self._lines: list[Any] = []
        self.client = kind(
            url,
            probation_s=0.0,
            on_link=lambda is_up, cause: up.set() if is_up else up.clear(),
            on_log=self._lines.append,
        )

    def run_client(self, loop: LoopThread) -> None:
        """Returns when the client is connected."""
        self.running = asyncio.run_coroutine_threadsafe(self.client.run(), loop.loop)
        assert self._up.wait(30.0), self._lines

    def settle(self) -> None:
        """Returns when what was sent until now, in either direction, is processed."""
        raise NotImplementedError

    def start_time(self, node: Any) -> None:
        """Gives a new node with simulated time the present one, and every later one."""
        self._nodes.append(node)
        self.set_time(self._now_s)

    def listen(self, topic: str, type_name: str) -> list[Mapping[str, Any]]:
        self.settle()
        heard: list[Mapping[str, Any]] = []
        self.on_robot(lambda: self.outside.subscribe(topic, type_name, lambda value, now_s: heard.append(value)))
        return heard

    def propose(self, node: Any, name: str, value: object) -> str:
        try:
            set_parameter(node, name, value)
        except ConfigError as error:
            return str(error)
        return ""

    def set_time(self, now_s: float) -> None:
        self._now_s = now_s
        self.settle()
        seconds = int(now_s)
        stamp = {"secs": seconds, "nsecs": round((now_s - seconds) * 1e9)}

        def move() -> None:
            self.bus.run_due(now_s)
            self.outside.publish("/clock", {"clock": stamp})

        self.on_robot(move)
        self.settle()
        assert all(node.now_s() == now_s for node in self._nodes if not node.closed)

    def log_lines(self) -> Sequence[LogLine]:
        return [LogLine(line.severity, line.text) for line in tuple(self._lines)]

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        # Most things take a round trip or two; what takes real time is looked at rarely.
        pauses_s = itertools.chain(itertools.repeat(0.0, 10), itertools.repeat(0.02))

        def look_later() -> None:
            self._pause.wait(next(pauses_s))
            self.settle()

        poll_until(predicate, look_later)

    def on_robot(self, function: Callable[[], Any]) -> Any:
        """Calls a function in the thread of the bus."""

        async def call() -> Any:
            return function()

        return self.robot.call(call())
