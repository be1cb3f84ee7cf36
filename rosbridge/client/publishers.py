"""Why a topic brings no samples, as far as the server's rosapi knows. A server without rosapi gives no reason."""

from __future__ import annotations

import asyncio
from typing import Any, Container, Dict, Mapping, NamedTuple, Optional, Tuple

from robot_health_monitor.core.errors import LinkError, MessageError, ServiceError
from robot_health_monitor.core.hints import Answer, explain, similar_topics

from .subscriptions import Call

_TIMEOUT_S = 5.0
_MOST_CANDIDATES = 3
"""Similar topics of which the server is asked for publishers, for one question."""


class _Question(NamedTuple):
    topic: str
    type_name: str
    own_topics: Container[str]


class PublisherLookup:
    """Asks the server, one call after the other. Used in the event loop only."""

    def __init__(self, call: Call) -> None:
        """Asks nothing yet.

        Args:
            call: calls a service of the server: name, request, time limit in s.
        """
        self._call = call
        self._questions: Dict[Tuple[str, str], Tuple[_Question, Answer]] = {}
        self._task: Optional[asyncio.Task[None]] = None

    def look_up(self, topic: str, type_name: str, own_topics: Container[str], answer: Answer) -> None:
        """Answers later: why a topic brings no samples; None if nothing is known. See `core.hints.Hints`.

        Args:
            topic: the resolved topic.
            type_name: the configured type; empty: any.
            own_topics: the topics that the node itself uses.
            answer: receives the text.
        """
        self._questions[topic, type_name] = _Question(topic, type_name, own_topics), answer
        if self._task is None or self._task.done():
            self._task = asyncio.get_event_loop().create_task(self._ask())

    async def _ask(self) -> None:
        while self._questions:
            waiting = list(self._questions.values())
            self._questions.clear()
            try:
                topics = _types_by_topic(await self._call("/rosapi/topics", {}, _TIMEOUT_S))
                while waiting:
                    question, answer = waiting[0]
                    answer(await self._explain(question, topics))
                    del waiting[0]
            except (LinkError, MessageError, ServiceError):
                for _, answer in waiting:
                    answer(None)

    async def _explain(self, question: _Question, topics: Mapping[str, str]) -> Optional[str]:
        topic, type_name, own_topics = question
        if await self._has_publisher(topic):
            return explain(topic, type_name, [topics[topic]], ()) if topics.get(topic) else None
        similar = similar_topics(topic, type_name, topics, own_topics)[:_MOST_CANDIDATES]
        return explain(topic, type_name, [], [name for name in similar if await self._has_publisher(name)])

    async def _has_publisher(self, topic: str) -> bool:
        values = await self._call("/rosapi/publishers", {"topic": topic}, _TIMEOUT_S)
        return bool(values.get("publishers"))


def _types_by_topic(values: Mapping[str, Any]) -> Mapping[str, str]:
    """Returns the type of each topic in an answer of `/rosapi/topics`; empty where the server does not know it."""
    names, types = values.get("topics"), values.get("types")
    if not isinstance(names, list) or not isinstance(types, list):
        return {}
    return {name: str(type_name) for name, type_name in zip(names, types) if isinstance(name, str)}
