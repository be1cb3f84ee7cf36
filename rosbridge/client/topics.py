"""The topics of a robot behind a rosbridge server, as its rosapi knows them."""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Mapping

from ...core.values.errors import ServiceError
from ...core.values.names import canonical_type
from ...runtime.bridge.node import KnownTopic
from .services import Call

_TIMEOUT_S = 10.0
_MOST_TOPICS = 10_000
_MOST_TYPES = 200
_LONGEST_DEFINITION = 200_000
"""Characters; the largest ones of ROS have about 50,000."""
_IDL_KINDS = {"boolean": "bool", "float": "float32", "double": "float64", "octet": "byte"}
_SLOT_OF_RCLPY = "check_fields"


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


async def find_definition(call: Call, type_name: str) -> str:
    """Returns the definition of a type in .msg, with those that it contains, without constants; empty: unknown.

    Raises as `list_topics`.
    """
    values = await call("/rosapi/message_details", {"type": type_name}, _TIMEOUT_S)
    typedefs = values.get("typedefs")
    parts: Dict[str, str] = {}
    for typedef in typedefs[:_MOST_TYPES] if isinstance(typedefs, list) else ():
        if isinstance(typedef, dict) and isinstance(typedef.get("type"), str):
            parts.setdefault(canonical_type(typedef["type"]), "".join(_lines(typedef)))
    own = parts.pop(canonical_type(type_name), "")
    text = own + "".join(f"{'=' * 80}\nMSG: {name}\n{part}" for name, part in parts.items())
    return text if own and len(text) <= _LONGEST_DEFINITION else ""


def _lines(typedef: Mapping[str, Any]) -> Iterator[str]:
    columns = [typedef.get(name) for name in ("fieldnames", "fieldtypes", "fieldarraylen")]
    if not all(isinstance(column, list) for column in columns):
        return
    for name, kind, length in zip(*columns):
        if not isinstance(name, str) or not isinstance(kind, str) or not isinstance(length, int):
            continue
        # rosapi of ROS 2 names the slots of Python's classes, and some types as in IDL.
        name, kind = name.lstrip("_"), kind.partition("<")[0]
        if name.isidentifier() and name != _SLOT_OF_RCLPY:
            array = "" if length < 0 else f"[{length or ''}]"
            yield f"{_IDL_KINDS.get(kind, kind)}{array} {name}\n"


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
