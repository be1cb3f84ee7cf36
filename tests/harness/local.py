"""The conformance harness over the in-process middleware, in virtual time."""

from __future__ import annotations

import time
from typing import Any, Callable, Mapping, Sequence

from harness.parameters import set_parameter
from harness.port_conformance import START_S, LogLine, ServiceFailed, poll_until
from robot_health_monitor.core.port.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.values.errors import ConfigError, ServiceError


class LocalHarness:
    """A bus in virtual time."""

    knows_listeners = True

    def __init__(self) -> None:
        self.bus = LocalBus(1.0, wall_time_s=time.time)
        self._outside = self.bus.node("outside")
        self._outside.advertise("/clock", "rosgraph_msgs/Clock")
        self._nodes: list[LocalMiddleware] = []
        self._sim_time_s = START_S

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        remap: Mapping[str, str] | None = None,
        sim_time: bool = True,
    ) -> LocalMiddleware:
        node = self.bus.node(name, namespace=namespace, parameters=parameters, remap=remap, use_sim_time=sim_time)
        self._nodes.append(node)
        self.set_time(self._sim_time_s)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        self._outside.advertise(topic, type_name)
        self._outside.publish(topic, message)

    def listen(self, topic: str, type_name: str) -> list[Mapping[str, Any]]:
        messages: list[Mapping[str, Any]] = []
        self._outside.subscribe(topic, type_name, lambda message, now_s: messages.append(message))
        return messages

    def call(self, service: str, type_name: str, request: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        try:
            return self.bus.call_service(service, request)
        except ServiceError as error:
            raise ServiceFailed(str(error)) from error

    def propose(self, node: LocalMiddleware, name: str, value: object) -> str:
        try:
            set_parameter(node, name, value)
        except ConfigError as error:
            return str(error)
        return ""

    def set_time(self, now_s: float) -> None:
        self._sim_time_s = now_s
        seconds = int(now_s)
        self._outside.publish("/clock", {"clock": {"sec": seconds, "nanosec": round((now_s - seconds) * 1e9)}})

    def log_lines(self) -> Sequence[LogLine]:
        return [LogLine(line.severity, line.text) for line in self.bus.log_lines]

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        poll_until(predicate, lambda: self.bus.run_due(self.bus.now_s + 0.01))

    def close(self) -> None:
        for node in (*self._nodes, self._outside):
            node.close()
