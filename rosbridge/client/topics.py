"""The topics of a robot behind a rosbridge server, and why one is silent, as its rosapi knows them."""

from __future__ import annotations

import asyncio
import contextlib
from typing import (
    Any,
    Awaitable,
    Callable,
    Iterable,
    Mapping,
    Sequence,
)

from ...core.port import Answer, explain, similar_topic
from ...core.values import JsonObject, LinkError, MessageError, ServiceError, canonical_type
from ...runtime.bridge.node import KnownTopic

Call = Callable[[str, JsonObject, float], Awaitable[JsonObject]]
"""Calls a service of the server: name, request, time limit in s."""

_TIMEOUT_S = 10.0
_ANSWER_TIMEOUT_S = 5.0
_REMEMBER_PERIOD_S = 60.0
_MOST_TOPICS = 10_000
_LONGEST_DEFINITION = 200_000
"""Characters; the largest ones of ROS have about 50,000."""


async def list_topics(call: Call) -> list[KnownTopic]:
    """Returns the topics that the server knows.

    Raises ServiceError if it has no rosapi or did not answer, LinkError if the connection is down.
    """
    try:
        values = await call("/rosapi/topics_and_raw_types", {}, _TIMEOUT_S)
        texts: Any = values.get("typedefs_full_text")
    except ServiceError:  # an old rosapi
        values = await call("/rosapi/topics", {}, _TIMEOUT_S)
        texts = None
    return _known(values, texts if isinstance(texts, list) else [])


async def find_types(call: Call) -> Mapping[str, str]:
    """Returns the type of each topic that the server knows. Raises as `list_topics`."""
    return {each.topic: each.type_name for each in _known(await call("/rosapi/topics", {}, _ANSWER_TIMEOUT_S), [])}


async def find_definition(call: Call, type_name: str) -> str:
    """Returns the definition of a type, with those that it contains; empty if it is unknown.

    Only rosapi of this project's server gives it. Raises as `list_topics`.
    """
    text = (await call("/rosapi/message_details", {"type": type_name}, _TIMEOUT_S)).get("definition")
    return text if isinstance(text, str) and len(text) <= _LONGEST_DEFINITION else ""


async def names_of(call: Call, service: str, **request: str) -> list[str]:
    """Returns the names that a service of rosapi answers with. Raises as `ServerConnection.call`."""
    names = (await call(f"/rosapi/{service}", request, _ANSWER_TIMEOUT_S)).get(service)
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
        self._questions: dict[tuple[str, str], Answer] = {}
        """What is answered, by topic and configured type, which is empty if any type is meant."""
        self._task: asyncio.Task[None] | None = None
        self._publishers: dict[str, Sequence[str]] = {}
        """The nodes that published each topic when it had publishers last."""

    async def remember(self, topics: Callable[[], Iterable[str]], period_s: float = _REMEMBER_PERIOD_S) -> None:
        """Remembers again and again which nodes publish. Runs until it is cancelled."""
        while True:
            await asyncio.sleep(period_s)
            with contextlib.suppress(LinkError, MessageError, ServiceError):  # no rosapi, or no connection
                for topic in tuple(topics()):
                    await self._publishers_of(topic)

    def look_up(self, topic: str, type_name: str, answer: Answer) -> None:
        """Answers later why a topic brings no samples, None if nothing is known; as in `core.hints.Hints`."""
        self._questions[topic, type_name] = answer
        if self._task is None or self._task.done():
            self._task = asyncio.get_event_loop().create_task(self._ask())

    async def _ask(self) -> None:
        while self._questions:
            waiting = list(self._questions.items())
            self._questions.clear()
            try:
                topics = await find_types(self._call)
                while waiting:
                    (topic, type_name), answer = waiting[0]
                    answer(await self._explain(topic, type_name, topics))
                    del waiting[0]
            except (LinkError, MessageError, ServiceError):
                for _, answer in waiting:
                    answer(None)

    async def _explain(self, topic: str, type_name: str, topics: Mapping[str, str]) -> str | None:
        if await self._publishers_of(topic):
            return explain(topic, type_name, [topics[topic]]) if topics.get(topic) else None
        known = self._publishers.get(topic, ())
        gone = set(known).difference(await names_of(self._call, "nodes")) if known else ()
        similar = similar_topic(topic, type_name, topics)
        if similar and not await self._publishers_of(similar):
            similar = None
        return explain(topic, type_name, [], gone, similar)

    async def _publishers_of(self, topic: str) -> Sequence[str]:
        nodes = await names_of(self._call, "publishers", topic=topic)
        if nodes:
            self._publishers[topic] = nodes
        return nodes


def _known(values: JsonObject, texts: list[Any]) -> list[KnownTopic]:
    names, types = values.get("topics"), values.get("types")
    if not isinstance(names, list) or not isinstance(types, list):
        return []
    topics = []
    for at, (name, type_name) in enumerate(zip(names[:_MOST_TOPICS], types)):
        if isinstance(name, str) and isinstance(type_name, str) and name:
            text = texts[at] if at < len(texts) and isinstance(texts[at], str) else ""
            topics.append(KnownTopic(name, canonical_type(type_name), text))
    return topics
