"""What a rosbridge server needs besides the port, over rospy: the graph, calls of services, raw bytes."""

from __future__ import annotations

import io
from typing import Any, Callable, Dict, List

import rosgraph
import rospy
import rospy.topics
import rosservice

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.middleware import Graph, Message, NodeInfo

from . import messages
from .middleware import Ros1Middleware, Subscription


class Ros1ServedMiddleware(Ros1Middleware):
    """A logical node that can be served; implements `core.middleware.ServedMiddleware`."""

    def graph(self) -> Graph:
        """Returns what the master knows; it knows no types of services."""
        master = rosgraph.Master(rospy.get_name())
        try:
            publishers, subscribers, services = master.getSystemState()
            types: Dict[str, str] = dict(master.getTopicTypes())
        except (OSError, rosgraph.MasterException) as error:
            raise ValueError(f"the ROS master does not answer: {error}") from None
        nodes: Dict[str, List[List[str]]] = {}
        for kind, state in enumerate((publishers, subscribers, services)):
            for name, users in state:
                for user in users:
                    nodes.setdefault(user, [[], [], []])[kind].append(name)
        known = {topic: type_name for topic, type_name in types.items() if type_name != rospy.AnyMsg._type}
        return Graph(
            known,
            {service: "" for service, _ in services},
            {name: NodeInfo(*lists) for name, lists in nodes.items()},
        )

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        resolved = self._resolve(service)
        try:
            rospy.wait_for_service(resolved, timeout_s)
            cls = messages.service_class(type_name) if type_name else rosservice.get_service_class_by_name(resolved)
            response = rospy.ServiceProxy(resolved, cls)(messages.to_native(cls._request_class, request))
        except (rospy.ROSException, rosservice.ROSServiceException, ConfigError) as error:
            raise ValueError(f"{resolved}: {error}") from None
        return messages.to_mapping(response)

    def message_definition(self, type_name: str) -> str:
        try:
            text: str = messages.message_class(type_name)._full_text
        except ConfigError:
            return ""
        return text

    def subscribe_raw(self, topic: str, type_name: str, callback: Callable[[bytes, float], None]) -> Any:
        """As `core.middleware.ServedMiddleware`; a topic that this process uses with its class is serialised again."""
        resolved = self._resolve(topic)
        impl = rospy.topics.get_topic_manager().get_subscriber_impl(rospy.resolve_name(resolved))
        cls = rospy.AnyMsg if impl is None else impl.data_class

        subscription = Subscription()

        def deliver(native: Any) -> None:
            with self._lock:
                if subscription.active:
                    data = native._buff if isinstance(native, rospy.AnyMsg) else _serialized(native)
                    callback(data, self.now_s())

        subscription.bind(rospy.Subscriber(resolved, cls, deliver, tcp_nodelay=True))
        with self._lock:
            self._subscriptions.append(subscription)
        return subscription


def _serialized(native: Any) -> bytes:
    buffer = io.BytesIO()
    native.serialize(buffer)
    return buffer.getvalue()
