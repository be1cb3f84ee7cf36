"""What a rosbridge server needs in addition to the port, over rclpy: the graph, service calls, raw messages."""

from __future__ import annotations

import threading
import time
from typing import Any

from ..core.messages.dialect import Message
from ..core.messages.raw_messages import RawFormat
from ..core.port import Graph, NodeInfo
from ..core.values import MessageError, ServiceError
from . import messages
from .middleware import Ros2Middleware


class Ros2ServedMiddleware(Ros2Middleware):
    """A node that can be served; implements `core.middleware.ServedMiddleware`."""

    def graph(self) -> Graph:
        """As `core.middleware.ServedMiddleware`: what discovery has found so far."""
        node = self.node
        nodes: dict[str, NodeInfo] = {}
        for name, namespace in node.get_node_names_and_namespaces():
            full_name = f"{namespace.rstrip('/')}/{name}"
            try:
                nodes[full_name] = NodeInfo(
                    _names(node.get_publisher_names_and_types_by_node(name, namespace)),
                    _names(node.get_subscriber_names_and_types_by_node(name, namespace)),
                    _names(node.get_service_names_and_types_by_node(name, namespace)),
                )
            except RuntimeError:  # the node has just left
                continue
        return Graph(
            self.topic_types(),
            {service: types[0] for service, types in node.get_service_names_and_types() if types},
            nodes,
        )

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        """As `core.middleware.ServedMiddleware`; call it while another thread spins the node."""
        deadline_s = time.monotonic() + timeout_s
        try:
            resolved = self._resolve(service)
            type_name = type_name or dict(self.node.get_service_names_and_types()).get(resolved, [""])[0]
            if not type_name:
                raise ServiceError(f"{resolved}: no such service")
            cls = messages.service_class(type_name)
            native = messages.to_native(cls.Request, request)
            client = self.node.create_client(cls, resolved)
        except MessageError as error:
            raise MessageError(f"{service}: {error}") from None
        except (ValueError, RuntimeError) as error:  # an unknown type, an invalid name, a node that is closing
            raise ServiceError(f"{service}: {' '.join(str(error).split())}") from None
        try:
            if not client.wait_for_service(timeout_s):
                raise ServiceError(f"{resolved}: no such service")
            answered = threading.Event()
            future = client.call_async(native)
            future.add_done_callback(lambda done: answered.set())
            if not answered.wait(max(0.0, deadline_s - time.monotonic())):
                client.remove_pending_request(future)
                raise ServiceError(f"{resolved}: no response within {timeout_s:g} s")
            return messages.to_mapping(future.result())
        finally:
            self.node.destroy_client(client)

    def raw_format(self, type_name: str) -> RawFormat:
        return messages.raw_format(type_name)


def _names(names_and_types: Any) -> list[str]:
    return [name for name, _ in names_and_types]
