"""What a rosbridge server needs in addition to the port, over rclpy: the graph, service calls, raw messages."""

from __future__ import annotations

import functools
import threading
import time
from typing import Any, Callable, Dict, List

from robot_health_monitor.core.dialect import FieldType
from robot_health_monitor.core.errors import ConfigError, MessageError, ServiceError
from robot_health_monitor.core.middleware import Graph, Message, NodeInfo
from robot_health_monitor.core.native_fields import as_it_is

from . import messages
from .middleware import Ros2Middleware, Subscription

_SEPARATOR = "=" * 80


class Ros2ServedMiddleware(Ros2Middleware):
    """A node that can be served; implements `core.middleware.ServedMiddleware`."""

    def graph(self) -> Graph:
        """As `core.middleware.ServedMiddleware`: what discovery has found so far."""
        node = self.node
        nodes: Dict[str, NodeInfo] = {}
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
            {topic: types[0] for topic, types in node.get_topic_names_and_types() if types},
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

    def message_definition(self, type_name: str) -> str:
        """Returns the definition with what the class contains: no constants and no comments."""
        try:
            return _full_text(messages.message_class(type_name))
        except ConfigError:
            return ""

    def subscribe_raw(self, topic: str, type_name: str, callback: Callable[[bytes, float], None]) -> Any:
        resolved = self._resolve(topic)
        subscription = Subscription(resolved, resolved, callback, None, get=as_it_is)
        with self._lock:
            self._join(subscription, messages.message_class(type_name), is_raw=True)
            self._keep(subscription)
        return subscription


def _names(names_and_types: Any) -> List[str]:
    return [name for name, _ in names_and_types]


@functools.lru_cache(maxsize=None)
def _full_text(native_class: Any) -> str:
    """Returns the fields of a class in .msg syntax, followed by the messages that it contains, each once."""
    parts: Dict[str, str] = {}
    waiting = [native_class]
    while waiting:
        cls = waiting.pop(0)
        if messages.type_name(cls) not in parts:
            fields = messages.field_types(cls)
            parts[messages.type_name(cls)] = "".join(_line(name, field) for name, field in fields.items())
            waiting += [field.message for field in fields.values() if field.message is not None]
    first, *others = parts.items()
    return first[1] + "".join(f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)


def _line(name: str, field: FieldType) -> str:
    # As in a .msg file: byte, and string<=5 for string<5>.
    element = "byte" if field.kind == "octet" else field.kind.replace("<", "<=").rstrip(">")
    bound = str(field.size) if field.size else f"<={field.most}" if field.most else ""
    return f"{element}{f'[{bound}]' if field.is_array else ''} {name}\n"
