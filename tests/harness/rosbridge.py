"""The port over rosbridge, seen from outside: a local bus, this project's server, a real socket, the client's nodes."""

from __future__ import annotations

import asyncio
import threading
from typing import Any, Callable, List, Mapping, Optional, Sequence

from harness.parameters import set_parameter
from harness.port_conformance import START_S, LogLine, ServiceFailed, poll_until
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError, ServiceError
from robot_health_monitor.rosbridge.client.middleware import RosbridgeClient, RosbridgeMiddleware
from robot_health_monitor.rosbridge.server.access import Access
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.runtime.event_loops import LoopThread

EVERYTHING = Access(publish=("*",), services=("*",), offer=("*",))


class RosbridgeHarness:
    """The harness of `port_conformance.py`. The outside speaks on the bus, on the far side of the server."""

    knows_listeners = False

    def __init__(self) -> None:
        self._now_s = START_S
        self._robot, self._watcher = LoopThread("robot"), LoopThread("watcher")
        self.bus = LocalBus(START_S)
        self.server = Server(self.bus.node("rosbridge"), port=0, threads=False, access=EVERYTHING)
        self._robot.call(self.server.start())
        self._outside = self.bus.node("outside")
        self._outside.advertise("/clock", "rosgraph_msgs/Clock")
        up = threading.Event()
        self.client = RosbridgeClient(
            f"ws://127.0.0.1:{self.server.port}",
            probation_s=0.0,
            on_link=lambda is_up, cause: up.set() if is_up else up.clear(),
        )
        self._running = asyncio.run_coroutine_threadsafe(self.client.run(), self._watcher.loop)
        assert up.wait(30.0), self.client.log_lines
        self._nodes: List[RosbridgeMiddleware] = []
        self._simulated: List[RosbridgeMiddleware] = []

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Optional[Mapping[str, Any]] = None,
        remap: Optional[Mapping[str, str]] = None,
        sim_time: bool = True,
    ) -> RosbridgeMiddleware:
        node = self.client.node(name, namespace=namespace, parameters=parameters, remap=remap, use_sim_time=sim_time)
        self._nodes.append(node)
        if sim_time:
            self._simulated.append(node)
            self.set_time(self._now_s)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        self._settle()

        def publish() -> None:
            self._outside.advertise(topic, type_name)
            self._outside.publish(topic, message)

        self.on_robot(publish)

    def listen(self, topic: str, type_name: str) -> List[Mapping[str, Any]]:
        self._settle()
        heard: List[Mapping[str, Any]] = []
        self.on_robot(lambda: self._outside.subscribe(topic, type_name, lambda value, now_s: heard.append(value)))
        return heard

    def call(self, service: str, type_name: str, request: Optional[Mapping[str, Any]] = None) -> Mapping[str, Any]:
        self._settle()
        try:
            return self._robot.call(self.server.services.call(service, request or {}, None))  # type: ignore[no-any-return]
        except (ValueError, ServiceError) as error:
            raise ServiceFailed(error) from None

    def propose(self, node: RosbridgeMiddleware, name: str, value: object) -> str:
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

        self.on_robot(move)
        self._settle()
        assert all(node.now_s() == now_s for node in self._simulated if not node.closed)

    def log_lines(self) -> Sequence[LogLine]:
        return [LogLine(line.severity, line.text) for line in tuple(self.client.log_lines)]

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        poll_until(predicate, self._settle)

    def close(self) -> None:
        self.client.close()
        self._running.cancel()
        self._watcher.close()
        self._robot.call(self.server.close())
        self._robot.close()

    def on_robot(self, function: Callable[[], Any]) -> Any:
        """Calls a function in the thread of the bus."""

        async def call() -> Any:
            return function()

        return self._robot.call(call())

    def _settle(self) -> None:
        """Returns when the server has processed what the nodes sent until now, and the nodes what it sent before that.

        The connection keeps the order in both directions.
        """
        self._watcher.call(self.client.connection.calls.call("/rosapi/get_time", {}, 10.0))
