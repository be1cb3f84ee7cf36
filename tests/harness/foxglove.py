"""The port over Foxglove's protocol, seen from outside: a local bus, a server of the protocol, a real socket, nodes."""

from __future__ import annotations

import asyncio
import itertools
import json
import threading
from typing import Any, Callable, List, Mapping, Optional, Sequence

from harness.foxglove_server import MARKER, FoxgloveServer
from harness.parameters import set_parameter
from harness.port_conformance import START_S, LogLine, ServiceFailed, poll_until
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError, ServiceError
from robot_health_monitor.foxglove import FoxgloveClient, FoxgloveMiddleware
from robot_health_monitor.runtime.event_loops import LoopThread


class FoxgloveHarness:
    """The harness of `port_conformance.py`. The outside is a bus; nodes announce there too."""

    knows_listeners = True

    def __init__(self, encoding: str = "cdr") -> None:
        self._now_s = START_S
        self._loop = LoopThread("robot")
        self.bus = LocalBus(START_S)
        self.server = FoxgloveServer(self.bus, encoding)
        self._loop.call(self.server.start())
        self._outside = self.bus.node("outside")
        self._outside.advertise("/clock", "rosgraph_msgs/Clock")
        up = threading.Event()
        self.client = FoxgloveClient(
            f"foxglove://127.0.0.1:{self.server.port}",
            probation_s=0.0,
            on_link=lambda is_up, cause: up.set() if is_up else up.clear(),
        )
        self._marked = threading.Event()
        self._numbers = itertools.count(1)
        self._heard = 0.0
        self.client.node("marker").subscribe(MARKER, "", self._note_marker, field="data")
        self._running = asyncio.run_coroutine_threadsafe(self.client.run(), self._loop.loop)
        assert up.wait(30.0), self.client.log_lines
        self._nodes: List[FoxgloveMiddleware] = []
        self._simulated: List[FoxgloveMiddleware] = []

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Optional[Mapping[str, Any]] = None,
        remap: Optional[Mapping[str, str]] = None,
        sim_time: bool = True,
    ) -> FoxgloveMiddleware:
        outputs = self.bus.node(name, namespace=namespace, remap=remap)
        node = self.client.node(
            name, namespace=namespace, parameters=parameters, remap=remap, use_sim_time=sim_time, outputs=outputs
        )
        self._nodes.append(node)
        if sim_time:
            self._simulated.append(node)
            self.set_time(self._now_s)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        self._on_loop(lambda: self._outside.advertise(topic, type_name))
        self._settle()
        self._on_loop(lambda: self._outside.publish(topic, message))

    def listen(self, topic: str, type_name: str) -> List[Mapping[str, Any]]:
        self._settle()
        heard: List[Mapping[str, Any]] = []
        self._on_loop(lambda: self._outside.subscribe(topic, type_name, lambda value, now_s: heard.append(value)))
        return heard

    def call(self, service: str, type_name: str, request: Optional[Mapping[str, Any]] = None) -> Mapping[str, Any]:
        self._settle()
        try:
            return self.bus.call_service(service, request or {})
        except (ValueError, ServiceError) as error:
            raise ServiceFailed(error) from None

    def propose(self, node: FoxgloveMiddleware, name: str, value: object) -> str:
        try:
            set_parameter(node, name, value)
        except ConfigError as error:
            return str(error)
        return ""

    def set_time(self, now_s: float) -> None:
        self._now_s = now_s
        self._settle()
        seconds = int(now_s)
        stamp = {"secs": seconds, "nsecs": round((now_s - seconds) * 1e9)}

        def move() -> None:
            self.bus.run_due(now_s)
            self._outside.publish("/clock", {"clock": stamp})

        self._on_loop(move)
        self._settle()
        assert all(node.now_s() == now_s for node in self._simulated if not node.closed)

    def log_lines(self) -> Sequence[LogLine]:
        return [LogLine(line.severity, line.text) for line in tuple(self.client.log_lines)]

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        poll_until(predicate, self._settle)

    def close(self) -> None:
        self.client.close()
        self._running.cancel()
        self._loop.call(self.server.close())
        self._loop.close()

    def _note_marker(self, value: Any, now_s: float) -> None:
        self._heard = value
        self._marked.set()

    def _on_loop(self, function: Callable[[], Any]) -> Any:
        async def call() -> Any:
            return function()

        return self._loop.call(call())

    def _settle(self) -> None:
        """Returns when the server has processed what the client sent until now, and the client what the server sent.

        Twice, since the client subscribes to what the server offers.
        """
        for _ in range(2):
            self._on_loop(self.server.advertise_all)
            number = next(self._numbers)
            self._marked.clear()
            self.client.connection.send_wire(json.dumps({"op": "harness_marker", "number": number}))
            poll_until(lambda: self._heard >= number, lambda: self._marked.wait(0.05))  # noqa: B023 - used at once
