"""The topics of a robot behind a rosbridge server, as its rosapi knows them."""

from __future__ import annotations

from typing import Any, List, Mapping, NamedTuple

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.middleware import canonical_type

from .services import Call

_TIMEOUT_S = 10.0
_MOST_TOPICS = 10_000


class KnownTopic(NamedTuple):
    """One topic of the robot."""

    topic: str
    type_name: str
    """`package/Type`; empty where the server does not know it."""
    definition: str
    """The definition of the type with those that it contains, as from `gendeps --cat`; empty: the server has none."""


async def list_topics(call: Call) -> List[KnownTopic]:
    """Returns the topics that the server knows.

    Raises ServiceError: it has no rosapi, or did not answer. LinkError: the connection is down.
    """
    try:
        values = await call("/rosapi/topics_and_raw_types", {}, _TIMEOUT_S)
        texts: Any = values.get("typedefs_full_text")
    except ServiceError:  # an old rosapi
        values = await call("/rosapi/topics", {}, _TIMEOUT_S)
        texts = None
    return _known(values, texts if isinstance(texts, list) else [])


def _known(values: Mapping[str, Any], texts: List[Any]) -> List[KnownTopic]:
    names, types = values.get("topics"), values.get("types")
    if not isinstance(names, list) or not isinstance(types, list):
        return []
    found = []
    for at, (name, type_name) in enumerate(zip(names[:_MOST_TOPICS], types)):
        if isinstance(name, str) and isinstance(type_name, str) and name:
            text = texts[at] if at < len(texts) and isinstance(texts[at], str) else ""
            found.append(KnownTopic(name, canonical_type(type_name), text))
    return found
