"""The port over rosbridge: nodes for a robot that is reached through its rosbridge server. Needs no ROS here."""

from __future__ import annotations

import asyncio
import concurrent.futures
from typing import Any, Callable, Collection, Coroutine, List, Mapping, Optional, TypeVar

from ...core.messages.raw_messages import RawFormat
from ...core.port.graph import GraphCallback, Wanted
from ...core.port.hints import Answer
from ...core.port.middleware import Callback, NodeInfo, RawCallback
from ...core.values.errors import LinkError, ServiceError
from ...runtime.bridge.node import BridgeClient, BridgeNode, KnownTopic
from .connection import ServerConnection
from .graph import GraphReader, list_nodes
from .receivers import CaptureReceiver, FieldReceiver
from .services import Call
from .topics import PublisherLookup, find_types, list_topics

_ANSWER_TIMEOUT_S = 30.0

T = TypeVar("T")


class RosbridgeClient(BridgeClient["RosbridgeMiddleware"]):
    """The connection to one robot's rosbridge server, shared by the nodes that `node` makes."""

    connection: ServerConnection
    connection_class = ServerConnection
    log_name = "rosbridge"

    def __init__(self, url: str, **options: Any) -> None:
        """Creates a client that is not connected, with the `options` of `BridgeClient`; `run` connects."""
        super().__init__(url, **options)
        self.publishers = PublisherLookup(self.connection.calls.call)

    def _new_node(self, name: str, *binding: Any) -> RosbridgeMiddleware:
        return RosbridgeMiddleware(self, name, *binding)

    async def known_topics(self) -> List[KnownTopic]:
        """See `BridgeClient.known_topics`: what its rosapi lists."""
        try:
            return await list_topics(self.connection.calls.call)
        except ServiceError as error:
            raise ServiceError(f"{self.connection.address} does not list its topics (no rosapi?): {error}") from None

    async def run(self) -> None:
        """Keeps the connection up and the timers going until it is cancelled."""
        remembering = asyncio.ensure_future(self.publishers.remember(lambda: self.connection.subscriptions.topics))
        try:
            await super().run()
        finally:
            remembering.cancel()

    async def known_nodes(self, topics: Collection[str]) -> Mapping[str, NodeInfo]:
        return await list_nodes(self.connection.calls.call, topics)

    def run_and_wait(self, ask: Callable[[Call], Coroutine[Any, Any, T]]) -> T:
        """Returns what a coroutine function finds out by calling the server's services. Called in another thread.

        Raises ServiceError if there is no answer, no connection, or no loop.
        """
        if self.loop is None:
            raise ServiceError(f"no connection to {self.connection.address}")
        asking = ask(self.connection.calls.call)
        try:
            return asyncio.run_coroutine_threadsafe(asking, self.loop).result(_ANSWER_TIMEOUT_S)
        except LinkError as error:
            raise ServiceError(str(error)) from None
        except (concurrent.futures.TimeoutError, concurrent.futures.CancelledError, RuntimeError):
            raise ServiceError(f"{self.connection.address} does not answer") from None


class RosbridgeMiddleware(BridgeNode):
    """One node for a robot behind rosbridge; implements `core.port.middleware.Middleware`."""

    _client: RosbridgeClient

    @property
    def _connection(self) -> ServerConnection:
        return self._client.connection

    def _new_receiver(self, topic: str, type_name: str, field: Optional[str], callback: Callback) -> FieldReceiver:
        return FieldReceiver(self, self._connection.limits.message_bytes, topic, type_name, field, callback)

    def _new_capture(self, topic: str, type_name: str, callback: RawCallback) -> CaptureReceiver:
        return CaptureReceiver(self, self._connection.limits.message_bytes, topic, type_name, callback)

    def _add(self, type_name: str, receiver: Any) -> None:
        self._connection.subscriptions.add(receiver.topic, type_name, receiver)

    def _remove(self, receiver: Any) -> None:
        self._connection.subscriptions.remove(receiver.topic, receiver)

    def raw_format_of(self, topic: str, type_name: str) -> Optional[RawFormat]:
        return self._connection.subscriptions.formats.get(topic)

    def topic_types(self) -> Mapping[str, str]:
        return self._client.run_and_wait(find_types)

    def graph_name(self, key: str, name: str) -> str:
        return self.resolve(name)

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> GraphReader:
        return GraphReader(self, self._connection, wanted, callback)

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        own = self.own_topics()
        self._client.run_in_loop(lambda: self._client.publishers.look_up(topic, type_name, own, answer))
