"""The graph that clients see: that of the middleware, and what the server adds."""

from __future__ import annotations

from typing import Callable, Mapping

from robot_health_monitor.core.middleware import Graph, NodeInfo, ServedMiddleware, resolve_name
from robot_health_monitor.core.standard_messages import definition

from .node_access import NodeAccess

ROSOUT = "/rosout"
ROSOUT_TYPE = "rosgraph_msgs/Log"


class ServedGraph:
    """Topics, services, nodes and message definitions."""

    def __init__(
        self,
        middleware: ServedMiddleware,
        node: NodeAccess,
        services: Callable[[], Mapping[str, str]],
        *,
        adds_rosout: bool,
    ) -> None:
        """Stores the sources.

        Args:
            middleware: the served node.
            node: access to it.
            services: type per service that the server adds.
            adds_rosout: whether the server provides `/rosout`.
        """
        self.adds_rosout = adds_rosout
        self._middleware = middleware
        self._node = node
        self._services = services

    def resolve(self, name: str) -> str:
        """Returns the absolute name of a topic or service; roslibjs sends relative ones."""
        return resolve_name(name, self._middleware.name)

    def read(self) -> Graph:
        """Returns the current graph. May block: not to be called in the loop.

        Raises:
            ServiceError: the middleware's name server does not respond.
        """
        graph = self._middleware.graph()
        topics, services, nodes = dict(graph.topics), dict(graph.services), dict(graph.nodes)
        own = nodes.get(self._middleware.name, NodeInfo((), (), ()))
        publishes = list(own.publishes)
        if self.adds_rosout:
            topics[ROSOUT] = ROSOUT_TYPE
            publishes.append(ROSOUT)
        added = self._services()
        services.update(added)
        nodes[self._middleware.name] = NodeInfo(publishes, own.subscribes, [*own.services, *added])
        return Graph(topics, services, nodes)

    def definition(self, type_name: str) -> str:
        """Returns the definition of a message type, with the types that it contains; empty if it is not known."""
        return self._middleware.message_definition(type_name) or definition(type_name)

    async def topic_type(self, topic: str) -> str:
        """Returns the type of a topic; empty if it is not known.

        Raises:
            ServiceError: the middleware's name server does not respond.
        """
        graph = await self._node.call(self.read)
        return graph.topics.get(self.resolve(topic), "")

    async def has_service(self, service: str) -> bool:
        """Returns whether a service of the middleware has this absolute name.

        Raises:
            ServiceError: the middleware's name server does not respond.
        """
        graph = await self._node.call(self._middleware.graph)
        return service in graph.services

    async def message_definition(self, type_name: str) -> str:
        """Like `definition`, for the loop."""
        return await self._node.call(self.definition, type_name) if type_name else ""
