"""The served node, as the server's event loop uses it: calls, messages, and the graph with what the server adds.

A middleware with threads may block (service calls, name servers) and calls back from its threads. It is called in
worker threads, and its messages are handed over to the loop. The local middleware runs in the loop's own thread and is
called directly; it has no `/rosout`, so that the server adds one.
"""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any, Callable, Mapping, TypeVar

from ...core.messages import definition
from ...core.port import Graph, NodeInfo, ServedMiddleware
from ...core.values import ConfigError, JsonObject, ServiceError, resolve_name
from ...runtime.access import READ_ONLY, Access
from ...runtime.bounded_queue import BoundedQueue
from ...runtime.event_loops import ThreadPool
from ..protocol import DEFAULT_LIMITS, Limits
from .sending import estimated_bytes

T = TypeVar("T")

ROSOUT = "/rosout"
ROSOUT_TYPE = "rosgraph_msgs/Log"

_THREADS = 4
_MOST_PENDING = 1_000
_MOST_CALLS = 16
_SLICE_S = 0.005
_GRACE_S = 0.5
"""Time for the middleware itself to report that a service did not respond."""


class ServedNode:
    """Access to the served node."""

    def __init__(
        self,
        middleware: ServedMiddleware,
        *,
        threads: bool,
        access: Access = READ_ONLY,
        limits: Limits = DEFAULT_LIMITS,
        parameters: Callable[[], Mapping[str, JsonObject]] | None = None,
        log: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Prepares the access to a node; the arguments are those of `Server`.

        `log` writes one line about a message that cannot be sent. If the estimated size of the messages that wait for
        the loop exceeds `limits.waiting_bytes`, the oldest are dropped.
        """
        self.middleware = middleware
        self.threads = threads
        self.access = access
        self.limits = limits
        self.parameters = parameters or (lambda: {middleware.name: middleware.given_parameters()})
        self.log = log
        self.added_services: dict[str, str] = {}
        """Type of each service that the server adds."""
        self.codec = ThreadPool("rosbridge-codec", 2, 2_000)
        """Encodes and decodes large messages."""
        self._workers = ThreadPool("rosbridge", _THREADS, _MOST_PENDING)
        # Separate: services that do not respond must not block subscriptions.
        self._callers = ThreadPool("rosbridge-call", _MOST_CALLS, _MOST_CALLS)
        self._lock = threading.Lock()
        self.messages: BoundedQueue[tuple[Callable[[Any], None], Any]] = BoundedQueue(limits.waiting_bytes)
        """Those that wait for the loop, used with the lock; it counts what was dropped because the loop was busy."""
        self._waking = False
        self.dropped = 0
        """Messages that were dropped since, in the loop."""

    async def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """Calls a method of the node, in a thread if it may block; raises ServiceError if too many are pending."""
        if not self.threads:
            return function(*arguments)
        return await self._workers.run(function, *arguments)

    async def call_service(self, service: str, request: JsonObject, timeout_s: float) -> JsonObject:
        """Returns the response of a service.

        Raises ServiceError if there is none within `timeout_s`, or if too many calls are pending.
        """
        arguments = (service, "", request, timeout_s)
        if not self.threads:
            return self.middleware.call_service(*arguments)
        call = self._callers.run(self.middleware.call_service, *arguments)
        try:
            return await asyncio.wait_for(call, timeout_s + _GRACE_S)
        except asyncio.TimeoutError:
            raise ServiceError(f"no response within {timeout_s:g} s") from None

    def hand_over(self, function: Callable[[Any], None]) -> Callable[[Any, float], None]:
        """Returns a callback for the node's subscriptions that calls `function(value)` in the loop that runs now."""
        if not self.threads:
            return lambda value, now_s: function(value)
        loop = asyncio.get_event_loop()

        def callback(value: Any, now_s: float) -> None:
            size = estimated_bytes(value)
            with self._lock:
                self.messages.put((function, value), size)
                wake = not self._waking
                self._waking = True
            if wake:
                try:
                    loop.call_soon_threadsafe(self._deliver)
                except RuntimeError:  # the loop has ended
                    with self._lock:
                        self.messages.clear()

        return callback

    def close(self) -> None:
        """Starts nothing new; functions that are running end by themselves."""
        for pool in (self.codec, self._workers, self._callers):
            pool.close()

    def resolve(self, name: str) -> str:
        """Returns the absolute name of a topic or service; roslibjs sends relative ones."""
        return resolve_name(name, self.middleware.name)

    def graph(self) -> Graph:
        """Returns the graph that clients see. May block; raises ServiceError if the name server does not respond."""
        graph = self.middleware.graph()
        topics, nodes, added = dict(graph.topics), dict(graph.nodes), dict(self.added_services)
        own = nodes.get(self.middleware.name, NodeInfo((), (), ()))
        publishes = list(own.publishes)
        if not self.threads:
            topics[ROSOUT] = ROSOUT_TYPE
            publishes.append(ROSOUT)
        nodes[self.middleware.name] = NodeInfo(publishes, own.subscribes, [*own.services, *added])
        return Graph(topics, {**graph.services, **added}, nodes)

    def definition(self, type_name: str) -> str:
        """Returns the definition of a message type, with the types that it contains; empty if it is not known.

        May block.
        """
        if not type_name:
            return ""
        try:
            raw_format = self.middleware.raw_format(type_name)
        except ConfigError:
            return definition(type_name)
        return raw_format.schema if raw_format.profile else definition(type_name)

    async def topic_type(self, topic: str) -> str:
        """Returns the type of a topic, empty if it is not known; raises ServiceError as `graph` does."""
        return (await self.call(self.graph)).topics.get(self.resolve(topic), "")

    def _deliver(self) -> None:
        end_s = time.monotonic() + _SLICE_S
        while time.monotonic() <= end_s:
            with self._lock:
                if not self.messages:
                    self._waking = False
                    return
                function, value = self.messages.pop()
            function(value)
        asyncio.get_event_loop().call_soon(self._deliver)  # other tasks of the loop run before
