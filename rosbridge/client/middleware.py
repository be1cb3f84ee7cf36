"""The port over rosbridge: nodes for a robot that is reached through its rosbridge server. Needs no ROS here."""

from __future__ import annotations

import asyncio
import concurrent.futures
from typing import Any, Callable, Collection, Mapping

from ...core.messages import RawFormat
from ...core.port import Answer, Callback, GraphCallback, NodeInfo, Wanted
from ...core.values import LinkError, ServiceError
from ...runtime.bridge.node import BridgeClient, BridgeNode, KnownTopic
from .connection import ServerConnection
from .graph import GraphReader, list_nodes
from .receivers import CaptureReceiver, FieldReceiver, Receiver
from .topics import PublisherLookup, find_types, list_topics

_ANSWER_TIMEOUT_S = 30.0


class RosbridgeMiddleware(BridgeNode):
    """One node for a robot behind rosbridge; implements `core.port.middleware.Middleware`."""

    knows_graph = True
    _client: RosbridgeClient

    @property
    def _connection(self) -> ServerConnection:
        return self._client.connection

    def _receiver(
        self, topic: str, type_name: str, field: str | None, callback: Callback, *, is_raw: bool = False
    ) -> Receiver:
        receiver: Receiver
        if is_raw:
            receiver = CaptureReceiver(self, topic, type_name, callback)
        else:
            receiver = FieldReceiver(self, topic, type_name, field, callback)
        receiver.largest_bytes = self._connection.limits.message_bytes
        return receiver

    def raw_format_of(self, topic: str, type_name: str) -> RawFormat | None:
        return self._connection.subscriptions.format_of(topic)

    def topic_types(self) -> Mapping[str, str]:
        loop, address = self._connection.loop, self._connection.address
        if loop is None:
            raise ServiceError(f"no connection to {address}")
        try:
            asking = find_types(self._connection.call)
            return asyncio.run_coroutine_threadsafe(asking, loop).result(_ANSWER_TIMEOUT_S)
        except LinkError as error:
            raise ServiceError(str(error)) from None
        except (concurrent.futures.TimeoutError, concurrent.futures.CancelledError, RuntimeError):
            raise ServiceError(f"{address} does not answer") from None

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> GraphReader:
        return GraphReader(self, self._connection, wanted, callback)

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        self._connection.run_in_loop(self._client.publishers.look_up, topic, type_name, answer)


class RosbridgeClient(BridgeClient[RosbridgeMiddleware]):
    """The connection to one robot's rosbridge server, shared by the nodes that `node` makes."""

    connection: ServerConnection
    connection_class = ServerConnection
    node_class = RosbridgeMiddleware
    log_name = "rosbridge"

    def __init__(self, url: str, **options: Any) -> None:
        """Creates a client that is not connected, with the `options` of `BridgeClient`; `run` connects."""
        super().__init__(url, **options)
        self.publishers = PublisherLookup(self.connection.call)
        topics = self.connection.subscriptions
        self.connection.tasks.append(lambda: self.publishers.remember(lambda: topics.topics))

    async def known_topics(self) -> list[KnownTopic]:
        """See `BridgeClient.known_topics`: what its rosapi lists."""
        try:
            return await list_topics(self.connection.call)
        except ServiceError as error:
            raise ServiceError(f"{self.connection.address} does not list its topics (no rosapi?): {error}") from None

    async def known_nodes(self, topics: Collection[str]) -> Mapping[str, NodeInfo]:
        return await list_nodes(self.connection.call, topics)
