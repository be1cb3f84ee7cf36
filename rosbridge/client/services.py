"""Calls of the server's services, and what its rosapi knows of topics that bring no samples."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any, Awaitable, Callable, Container, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

from ...core.port.hints import Answer, explain, similar_topics
from ...core.values.errors import LinkError, MessageError, ServiceError
from ...core.values.formatting import printable
from ..calls import PendingCalls
from ..protocol import Operation, operations

Call = Callable[[str, Mapping[str, Any], float], Awaitable[Mapping[str, Any]]]
"""Calls a service of the server: name, request, time limit in s."""

_LONGEST_ERROR = 200
_TIMEOUT_S = 5.0
_REMEMBER_PERIOD_S = 30.0
_MOST_CANDIDATES = 3
"""Similar topics of which the server is asked for publishers, for one question."""


class ServiceCalls:
    """Calls of the server's services that wait for their response. Used in the event loop only."""

    def __init__(self, send: Callable[[Operation], None], down: Callable[[], Optional[str]]) -> None:
        """Starts without calls; `down` returns why the connection is down, None while it is up."""
        self._send = send
        self._down = down
        self._pending = PendingCalls()

    async def call(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Mapping[str, Any]:
        """Returns the response of a service.

        Raises LinkError if the connection is or went down, and ServiceError if the service failed, or did not respond
        within `timeout_s`.
        """
        down = self._down()
        if down is not None:
            raise LinkError(f"{service} was not called: {down}")
        values = await self._pending.call(self._send, None, service, request, timeout_s)
        return values if isinstance(values, dict) else {}

    def receive(self, response: operations.ServiceResponse) -> None:
        """Ends the call that a response belongs to; any other response is ignored."""
        reason = printable(str(response.values)[:_LONGEST_ERROR])
        self._pending.receive(response, None, f"{printable(response.service)} failed: {reason}")

    def fail_all(self, cause: str) -> None:
        """Ends every call because the connection went down."""
        self._pending.fail(LinkError(cause))


async def find_types(call: Call) -> Mapping[str, str]:
    """Returns the type of each topic that the server knows. Raises as `ServiceCalls.call`."""
    return _types_by_topic(await call("/rosapi/topics", {}, _TIMEOUT_S))


async def names_of(call: Call, service: str, **request: str) -> List[str]:
    """Returns the names that a service of rosapi answers with. Raises as `ServiceCalls.call`."""
    names = (await call(f"/rosapi/{service}", request, _TIMEOUT_S)).get(service)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ServiceError(f"/rosapi/{service} did not answer with a list of names")
    return names


class PublisherLookup:
    """Finds why a topic brings no samples, as far as the server's rosapi knows: without rosapi there is no reason.

    Asks the server, one call after the other. Used in the event loop only.
    """

    def __init__(self, call: Call) -> None:
        """Asks nothing yet."""
        self._call = call
        self._questions: Dict[Tuple[str, str], Tuple[Container[str], Answer]] = {}
        """Topics that the node itself uses, and who is answered; by topic and configured type (empty: any)."""
        self._task: Optional[asyncio.Task[None]] = None
        self._publishers: Dict[str, Sequence[str]] = {}
        """The nodes that published each topic when it had publishers last."""

    async def remember(self, topics: Callable[[], Iterable[str]], period_s: float = _REMEMBER_PERIOD_S) -> None:
        """Remembers again and again which nodes publish. Runs until it is cancelled."""
        while True:
            await asyncio.sleep(period_s)
            with contextlib.suppress(LinkError, MessageError, ServiceError):  # no rosapi, or no connection
                self._publishers = {topic: nodes for topic, nodes in self._publishers.items() if topic in set(topics())}
                for topic in tuple(topics()):
                    await self._publishers_of(topic)

    def look_up(self, topic: str, type_name: str, own_topics: Container[str], answer: Answer) -> None:
        """Answers later why a topic brings no samples, None if nothing is known; as in `core.hints.Hints`."""
        self._questions[topic, type_name] = own_topics, answer
        if self._task is None or self._task.done():
            self._task = asyncio.get_event_loop().create_task(self._ask())

    async def _ask(self) -> None:
        while self._questions:
            waiting = list(self._questions.items())
            self._questions.clear()
            try:
                topics = await find_types(self._call)
                while waiting:
                    (topic, type_name), (own_topics, answer) = waiting[0]
                    answer(await self._explain(topic, type_name, topics, own_topics))
                    del waiting[0]
            except (LinkError, MessageError, ServiceError):
                for _, (_, answer) in waiting:
                    answer(None)

    async def _explain(
        self, topic: str, type_name: str, topics: Mapping[str, str], own_topics: Container[str]
    ) -> Optional[str]:
        if await self._publishers_of(topic):
            return explain(topic, type_name, [topics[topic]], ()) if topics.get(topic) else None
        known = self._publishers.get(topic, ())
        gone = set(known).difference(await names_of(self._call, "nodes")) if known else ()
        similar = similar_topics(topic, type_name, topics, own_topics)[:_MOST_CANDIDATES]
        candidates = [name for name in similar if await names_of(self._call, "publishers", topic=name)]
        return explain(topic, type_name, [], candidates, gone)

    async def _publishers_of(self, topic: str) -> Sequence[str]:
        nodes = await names_of(self._call, "publishers", topic=topic)
        if nodes:
            self._publishers[topic] = nodes
        return nodes


def _types_by_topic(values: Mapping[str, Any]) -> Mapping[str, str]:
    """Returns the type of each topic in an answer of `/rosapi/topics`; empty where the server does not know it."""
    names, types = values.get("topics"), values.get("types")
    if not isinstance(names, list) or not isinstance(types, list):
        return {}
    return {name: str(type_name) for name, type_name in zip(names, types) if isinstance(name, str)}
