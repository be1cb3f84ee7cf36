"""The port over Foxglove's protocol, seen from outside: a local bus, a server of the protocol, a real socket, nodes."""

from __future__ import annotations

import itertools
import json
import threading
from typing import Any, Mapping

from harness.bridged_bus import BridgedBus
from harness.foxglove_server import MARKER, FoxgloveServer
from harness.port_conformance import ServiceFailed, poll_until
from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.foxglove import FoxgloveClient, FoxgloveMiddleware


class FoxgloveHarness(BridgedBus):
    """The harness of `port_conformance.py`. The outside is a bus; nodes announce there too."""

    knows_listeners = True

    def __init__(self, encoding: str = "cdr") -> None:
        super().__init__()
        self.server = FoxgloveServer(self.bus, encoding)
        self.robot.call(self.server.start())
        self.make_client(FoxgloveClient, f"foxglove://127.0.0.1:{self.server.port}")
        self._marked = threading.Event()
        self._numbers = itertools.count(1)
        self._heard = 0.0
        self.client.node("marker").subscribe(MARKER, "", self._note_marker, field="data")
        self.run_client(self.robot)

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        remap: Mapping[str, str] | None = None,
        sim_time: bool = True,
    ) -> FoxgloveMiddleware:
        outputs = self.bus.node(name, namespace=namespace, remap=remap)
        node: FoxgloveMiddleware = self.client.node(
            name, namespace=namespace, parameters=parameters, remap=remap, use_sim_time=sim_time, outputs=outputs
        )
        if sim_time:
            self.start_time(node)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        self.on_robot(lambda: self.outside.advertise(topic, type_name))
        self.settle()
        self.on_robot(lambda: self.outside.publish(topic, message))

    def call(self, service: str, type_name: str, request: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        self.settle()
        try:
            return self.bus.call_service(service, request or {})
        except (ValueError, ServiceError) as error:
            raise ServiceFailed(error) from None

    def close(self) -> None:
        self.client.close()
        self.running.cancel()
        self.robot.call(self.server.close())
        self.robot.close()

    def _note_marker(self, value: Any, now_s: float) -> None:
        self._heard = value
        self._marked.set()

    def settle(self) -> None:
        """Returns when the server has processed what the client sent until now, and the client what the server sent.

        Twice, since the client subscribes to what the server offers.
        """
        for _ in range(2):
            self.on_robot(self.server.advertise_all)
            number = next(self._numbers)
            self._marked.clear()
            self.client.connection.send_wire(json.dumps({"op": "harness_marker", "number": number}))
            poll_until(lambda: self._heard >= number, lambda: self._marked.wait(0.05))  # noqa: B023 - used at once
