"""The services of the package rosapi, by which clients query the graph.

Names and fields are those of rosapi_msgs. The server itself provides them, so that they exist with every middleware.
Each call reads the graph once.
"""

from __future__ import annotations

import json
from typing import Any, Callable, Mapping

from ...core.config import flatten
from ...core.messages import Definitions
from ...core.port import Graph, NodeInfo
from ...core.values import JsonObject, ServiceError, canonical_type
from ..protocol.definitions import parse, service_definition
from .sending import wall_stamp
from .served_node import ServedNode

PREFIX = "/rosapi/"

Values = JsonObject


def _topics_and_raw_types(node: ServedNode) -> Values:
    topics = node.graph().topics
    texts = {type_name: node.definition(type_name) for type_name in set(topics.values())}
    return {**_topics(topics), "typedefs_full_text": [texts[one] for one in topics.values()]}


def _topics(topics: Mapping[str, str]) -> Values:
    return {"topics": list(topics), "types": list(topics.values())}


def _nodes_with(graph: Graph, kind: str, name: str) -> list[str]:
    """Returns the nodes of which `kind`, a field of NodeInfo, contains a topic or service."""
    return [node for node, info in graph.nodes.items() if name in getattr(info, kind)]


def _node_details(node: ServedNode, name: str) -> Values:
    info = node.graph().nodes.get(name, NodeInfo((), (), ()))
    return {"subscribing": list(info.subscribes), "publishing": list(info.publishes), "services": list(info.services)}


def _get_time(node: ServedNode) -> Values:
    stamp = wall_stamp()
    return {"time": {**stamp, "sec": stamp["secs"], "nanosec": stamp["nsecs"]}}


def _parameters(node: ServedNode) -> dict[str, Any]:
    """Returns the parameters that clients may read, by node and name."""
    return {
        f"{owner}:{name}": value
        for owner, tree in node.parameters().items()
        for name, value in flatten(tree)
        if not name.endswith("token")
    }


def _get_param(node: ServedNode, name: str, default_value: str, default: str) -> Values:
    values = _parameters(node)
    return {"value": json.dumps(values[name]) if name in values else default_value or default or '""'}


_SERVICES: Mapping[str, tuple[str, str, Callable[..., Any]]] = {
    "topics": ("", "", lambda node: _topics(node.graph().topics)),
    "topics_for_type": ("type", "topics", lambda graph, kind: _having(graph.topics, kind)),
    "topic_type": ("topic", "type", lambda graph, topic: graph.topics.get(topic, "")),
    "topics_and_raw_types": ("", "", _topics_and_raw_types),
    "services": ("", "services", lambda graph: list(graph.services)),
    "service_type": ("service", "type", lambda graph, service: graph.services.get(service, "")),
    "services_for_type": ("type", "services", lambda graph, kind: _having(graph.services, kind)),
    "service_node": ("service", "node", lambda graph, name: "".join(_nodes_with(graph, "services", name)[:1])),
    "service_providers": ("service", "providers", lambda graph, name: _nodes_with(graph, "services", name)),
    "service_host": ("service", "host", lambda graph, name: "localhost" if name in graph.services else ""),
    "nodes": ("", "nodes", lambda graph: list(graph.nodes)),
    "node_details": ("node", "", _node_details),
    "publishers": ("topic", "publishers", lambda graph, topic: _nodes_with(graph, "publishes", topic)),
    "subscribers": ("topic", "subscribers", lambda graph, topic: _nodes_with(graph, "subscribes", topic)),
    "action_servers": ("", "action_servers", lambda graph: []),
    "message_details": ("type", "", lambda node, name: _message_details(name, node.definition(name))),
    "service_request_details": ("type", "", lambda node, name: _typedefs(service_definition(name, False))),
    "service_response_details": ("type", "", lambda node, name: _typedefs(service_definition(name, True))),
    "get_time": ("", "", _get_time),
    "get_param_names": ("", "", lambda node: {"names": list(_parameters(node))}),
    "get_param": ("name default_value default", "", _get_param),  # the last one is its name in ROS 1
    "has_param": ("name", "", lambda node, name: {"exists": name in _parameters(node)}),
}
"""Of each service: the fields of its request, all of them strings; and the field of its response that a function
returns of the graph, or none, if the function returns the response of the node."""

SERVICES: Mapping[str, str] = {PREFIX + name: f"rosapi/{name.title().replace('_', '')}" for name in _SERVICES}
"""Type per service."""


def answer(node: ServedNode, service: str, request: Values) -> Values:
    """Returns the response of a service. Fields of the request that are missing or not strings are empty. May block.

    Raises ServiceError if the service does not exist, or the graph cannot be read.
    """
    if service not in SERVICES:
        raise ServiceError(f"no service {service}")
    fields, field, function = _SERVICES[service[len(PREFIX) :]]
    texts = [value if isinstance(value, str) else "" for value in map(request.get, fields.split())]
    return {field: function(node.graph(), *texts)} if field else function(node, *texts)


def _having(types: Mapping[str, str], type_name: str) -> list[str]:
    return [name for name, known_type in types.items() if canonical_type(known_type) == canonical_type(type_name)]


def _message_details(type_name: str, text: str) -> Values:
    """Returns a definition, also as text: for this project's client, which reads the bytes of ROS by it."""
    return {**_typedefs(parse(type_name, text)), "definition": text}


def _typedefs(known: Definitions) -> Values:
    """Returns definitions as a list of rosapi_msgs/TypeDef."""
    return {
        "typedefs": [
            {
                "type": type_name,
                "fieldnames": [field.name for field in fields],
                "fieldtypes": [field.kind for field in fields],
                "fieldarraylen": [-1 if field.size is None else max(field.size, 0) for field in fields],
                "examples": [""] * len(fields),
                "constnames": [name for name, _ in constants],
                "constvalues": [value for _, value in constants],
            }
            for type_name, (fields, constants) in known.items()
        ]
    }
