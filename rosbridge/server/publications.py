"""Publishing for clients."""

from __future__ import annotations

from typing import Any, Callable, Dict, Mapping

from robot_health_monitor.core.errors import ConfigError, MessageError, ServiceError
from robot_health_monitor.core.middleware import Message, ServedMiddleware, canonical_type

from ..protocol import Id, ProtocolError
from ..protocol.definitions import null_reader
from .access import Access
from .graph import ServedGraph
from .node_access import NodeAccess

MOST_TOPICS = 1_000
"""Most topics that clients may advertise, in sum. They stay advertised: others may have subscribed to them."""


class Publications:
    """The topics that clients publish on."""

    def __init__(self, middleware: ServedMiddleware, node: NodeAccess, graph: ServedGraph, access: Access) -> None:
        """Starts without topics.

        Args:
            middleware: the served node, which publishes.
            node: access to it.
            graph: types and definitions.
            access: topics that clients may publish on.
        """
        self._middleware = middleware
        self._node = node
        self._graph = graph
        self._access = access
        self._types: Dict[str, str] = {}
        self._readers: Dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]] = {}

    async def advertise(self, topic: str, type_name: str, id: Id) -> None:  # noqa: A002 - the protocol's word
        """Advertises a topic for a client.

        Args:
            topic: its name, absolute or relative.
            type_name: its type; empty: that of the topic, which must exist.
            id: of the operation.

        Raises:
            ProtocolError: clients may not publish on the topic, have advertised too many, the type is not known or is
                not that of the topic, or the middleware does not respond.
        """
        topic = self._graph.resolve(topic)
        if not self._access.may_publish(topic):
            raise ProtocolError(f"clients may not publish on {topic}", "advertise", id)
        if topic not in self._types and len(self._types) >= MOST_TOPICS:
            raise ProtocolError(f"clients have advertised {MOST_TOPICS} topics already", "advertise", id)
        try:
            known = self._types.get(topic) or await self._graph.topic_type(topic)
            if not (known or type_name):
                raise ProtocolError(f"{topic} is not advertised", "publish", id)
            if known and type_name and canonical_type(known) != canonical_type(type_name):
                raise ProtocolError(f"type of {topic}: expected {known}, got {type_name}", "advertise", id)
            type_name = type_name or known
            await self._node.call(self._middleware.advertise, topic, type_name)
            self._readers[topic] = null_reader(type_name, await self._graph.message_definition(type_name))
        except (ConfigError, ServiceError, OSError) as error:
            raise ProtocolError(str(error), "advertise", id) from None
        self._types[topic] = type_name

    async def publish(self, topic: str, message: Message, id: Id) -> None:  # noqa: A002 - the protocol's word
        """Publishes a client's message on an advertised topic; null becomes NaN in float fields.

        Raises:
            ProtocolError: the message does not match its type, or the middleware does not respond.
        """
        topic = self._graph.resolve(topic)
        try:
            await self._node.call(self._middleware.publish, topic, self._readers[topic](message))
        except (MessageError, ServiceError, ValueError, TypeError, OSError) as error:
            raise ProtocolError(str(error), "publish", id) from None
