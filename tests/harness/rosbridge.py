"""The port over rosbridge, seen from outside: a local bus, this project's server, a real socket, the client's nodes.

Nodes announce on the bus: the robot behind the server is only read.
"""

from __future__ import annotations

from typing import Any, Mapping

from harness.bridged_bus import BridgedBus
from harness.port_conformance import ServiceFailed
from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.rosbridge.client.middleware import RosbridgeClient, RosbridgeMiddleware
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.runtime.access import Access

EVERYTHING = Access(publish=("*",), services=("*",), offer=("*",))


class RosbridgeHarness(BridgedBus):
    """The harness of `port_conformance.py`. The outside speaks on the bus, on the far side of the server."""

    knows_listeners = True

    def __init__(self) -> None:
        super().__init__()
        self.server = Server(self.bus.node("rosbridge"), port=0, threads=False, access=EVERYTHING)
        self.robot.call(self.server.start())
        self.make_client(RosbridgeClient, f"ws://127.0.0.1:{self.server.port}")
        self.run_client(self.robot)

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Mapping[str, Any] | None = None,
        remap: Mapping[str, str] | None = None,
        sim_time: bool = True,
    ) -> RosbridgeMiddleware:
        outputs = self.on_robot(lambda: self.bus.node(name, namespace=namespace, remap=remap))
        node: RosbridgeMiddleware = self.client.node(
            name, namespace=namespace, parameters=parameters, remap=remap, use_sim_time=sim_time, outputs=outputs
        )
        if sim_time:
            self.start_time(node)
        return node

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        self.settle()

        def publish() -> None:
            self.outside.advertise(topic, type_name)
            self.outside.publish(topic, message)

        self.on_robot(publish)

    def call(self, service: str, type_name: str, request: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        self.settle()
        try:
            return self.robot.call(self.server.services.call(service, request or {}, None))  # type: ignore[no-any-return]
        except (ValueError, ServiceError) as error:
            raise ServiceFailed(error) from None

    def close(self) -> None:
        self.client.close()
        self.running.cancel()
        self.robot.call(self.server.close())
        self.robot.close()

    def settle(self) -> None:
        """Returns when the server has processed what the nodes sent until now, and the nodes what it sent before that.

        The connection keeps the order in both directions.
        """
        self.robot.call(self.client.connection.call("/rosapi/get_time", {}, 10.0))
