"""Reads the robot's graph through the server's rosapi, in the event loop: no message waits for an answer.

Only services are called that rosapi of ROS 1 and of ROS 2 answer alike. `node_details` is not one of them: rosapi of
ROS 2 fails if the node has just left.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from typing import Callable, Collection, Mapping

from ...core.port import (
    NOT_COUNTED,
    Counts,
    GraphCallback,
    MappingNode,
    NodeInfo,
    Unread,
    Wanted,
    count,
    is_pattern,
    matching,
    state_of,
)
from ...core.values import JsonObject, LinkError, ServiceError
from ...runtime.sockets import ignore_result
from .connection import ServerConnection
from .topics import Call, names_of

_PERIOD_S = 2.0
_STATE_TIMEOUT_S = 60.0
"""A server may wait for a node that hangs, in a thread for each call: it is not called again before."""


async def list_nodes(call: Call, topics: Collection[str]) -> Mapping[str, NodeInfo]:
    """Returns the nodes with those of these topics that they publish, and the service of lifecycle nodes.

    Raises as `ServerConnection.call`.
    """
    publishes: dict[str, list[str]] = {name: [] for name in await names_of(call, "nodes")}
    services = set(await names_of(call, "services"))
    for topic in topics:
        for name in await names_of(call, "publishers", topic=topic):
            publishes.setdefault(name, []).append(topic)
    return {
        name: NodeInfo(of_node, (), [each for each in (f"{name}/get_state",) if each in services])
        for name, of_node in publishes.items()
    }


class GraphReader:
    """Reads the graph every 2 s, until it is cancelled. One reading ends before the next one begins."""

    def __init__(
        self,
        node: MappingNode,
        connection: ServerConnection,
        wanted: Callable[[], Collection[Wanted]],
        callback: GraphCallback,
    ) -> None:
        """Begins to read, for a node of this connection; see `Middleware.follow_graph`."""
        self._node, self._connection = node, connection
        self._wanted, self._callback = wanted, callback
        self._timer = node.create_timer(_PERIOD_S, self._begin, steady=True)
        self._reading: asyncio.Future[None] | None = None
        self._was_read = False
        self._server: str = ""
        """The server's own node, empty while it is not known."""
        self._own_topic = f"/robot_health_monitor_{secrets.token_hex(4)}"
        """Only the server's own node subscribes to it."""
        self._states: dict[str, asyncio.Future[JsonObject]] = {}
        """The latest call of `get_state` of each lifecycle node."""

    def cancel(self) -> None:
        """Ends reading; nothing is called back any more."""
        self._timer.cancel()

    def _begin(self, now_s: float) -> None:
        if self._reading is None or self._reading.done():
            self._reading = asyncio.ensure_future(self._read())
            self._reading.add_done_callback(ignore_result)

    async def _read(self) -> None:
        answer: Counts | Unread
        try:
            answer = await self._count(self._wanted())
            self._was_read = True
        except LinkError:
            self._server = ""
            return
        except ServiceError as error:
            answer = Unread(f"the server's rosapi does not give the graph: {error}", self._was_read)
        if not self._timer.cancelled and not self._node.waiting_for_clock():
            self._node.call(lambda: self._callback(answer, self._node.now_s()))

    async def _count(self, wanted: Collection[Wanted]) -> Counts:
        keys = {key for key, _ in wanted}
        if "subscribers" in keys and not self._server:
            await self._find_server()
            if not self._server:
                wanted = [each for each in wanted if each[0] != "subscribers"]
        nodes = await self._ask("nodes") if keys & {"node", "lifecycle"} else []
        publishers = await self._endpoints("publishers", wanted)
        subscribers = await self._endpoints("subscribers", wanted)
        own_topics = self._connection.subscriptions.topics
        counts = count(
            wanted,
            [node for node in nodes if node != NOT_COUNTED],
            [topic for topic, _ in publishers],
            [topic for topic, node in subscribers if node != self._server or topic not in own_topics],
        )
        self._read_states({name for key, name in wanted if key == "lifecycle"}, nodes, counts)
        return counts

    async def _endpoints(self, key: str, wanted: Collection[Wanted]) -> list[tuple[str, str]]:
        """Returns topic and node of each such endpoint."""
        topics = {name for its_key, name in wanted if its_key == key}
        if any(map(is_pattern, topics)):
            topics = matching(wanted, key, await self._ask("topics"))
        return [(topic, node) for topic in topics for node in await self._ask(key, topic=topic) if node != NOT_COUNTED]

    async def _find_server(self) -> None:
        """Finds the server's own node, which may need some readings: ROS 2 has to discover its subscription first."""
        subscription = {"topic": self._own_topic, "id": self._own_topic}
        self._connection.send({"op": "subscribe", "type": "std_msgs/String", **subscription})
        self._server = next(iter(await self._ask("subscribers", topic=self._own_topic)), "")
        if self._server:
            self._connection.send({"op": "unsubscribe", **subscription})

    def _read_states(self, wanted: set[str], nodes: Collection[str], counts: Counts) -> None:
        """Adds the states that were answered since the last reading, and calls again."""
        self._states = {name: call for name, call in self._states.items() if name in wanted and name in nodes}
        for name in wanted:
            call = self._states.get(name)
            if name not in nodes:
                counts["lifecycle", name] = 0.0
            elif call is None or call.done():
                with contextlib.suppress(ServiceError, LinkError, LookupError, TypeError, ValueError):  # no state
                    if call is not None:
                        counts["lifecycle", name] = state_of(call.result())
                request = self._connection.call(f"{name}/get_state", {}, _STATE_TIMEOUT_S)
                self._states[name] = asyncio.ensure_future(request)
                self._states[name].add_done_callback(ignore_result)

    async def _ask(self, service: str, **request: str) -> list[str]:
        return await names_of(self._connection.call, service, **request)
