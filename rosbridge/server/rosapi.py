"""The services of the package rosapi, by which clients query the graph.

Names and fields are those of rosapi_msgs. The server itself provides them, so that they exist with every middleware.
Each call reads the graph once.
"""

from __future__ import annotations

import json
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

from ...core.config.parameters import flatten
from ...core.messages.definitions import Definition, Field
from ...core.port.middleware import Graph, NodeInfo
from ...core.values.errors import ServiceError
from ...core.values.names import canonical_type
from ..protocol import definitions

PREFIX = "/rosapi/"
_EXAMPLES = {"string": "", "bool": "False", "float32": "0.0", "float64": "0.0"}
_OLD_NAMES = {"default_value": "default"}
"""The name of a field in ROS 1."""

Values = Mapping[str, Any]


class Rosapi:
    """The services under `/rosapi/`."""

    def __init__(
        self,
        graph: Callable[[], Graph],
        definition: Callable[[str], str],
        parameters: Callable[[], Mapping[str, Values]],
        time_s: Callable[[], float],
    ) -> None:
        """Stores functions that return the graph, definitions, parameters and the time in s.

        A definition contains those of the types in it, and is empty if unknown. Parameters are nested, per node.
        """
        self._graph = graph
        self._definition = definition
        self._parameters = parameters
        self._time_s = time_s
        self.services: Mapping[str, str] = {
            PREFIX + name: f"rosapi/{name.title().replace('_', '')}" for name in (*_OF_GRAPH, *_OTHERS)
        }
        """Type per service."""

    def answer(self, service: str, args: object) -> Values:
        """Returns the response of a service to the fields of a request, by name or in order. May block.

        Raises ServiceError if the service does not exist, or the graph cannot be read.
        """
        name = service[len(PREFIX) :] if service.startswith(PREFIX) else ""
        if name in _OF_GRAPH:
            names, of_graph = _OF_GRAPH[name]
            return of_graph(self._graph(), *_texts(args, names))
        if name in _OTHERS:
            names, function = _OTHERS[name]
            return function(self, *_texts(args, names))
        raise ServiceError(f"no service {service}")

    def _topics_and_raw_types(self) -> Values:
        topics = self._graph().topics
        texts = {type_name: self._definition(type_name) for type_name in set(topics.values())}
        types = list(topics.values())
        return {"topics": list(topics), "types": types, "typedefs_full_text": [texts[one] for one in types]}

    def _message_details(self, type_name: str) -> Values:
        definitions_by_type = definitions.parse(type_name, self._definition(type_name))
        return {
            "typedefs": [
                _typedef(name, one) for name, one in definitions_by_type.items() if one.fields or one.constants
            ]
        }

    def _get_time(self) -> Values:
        seconds, rest = divmod(self._time_s(), 1.0)
        whole, nanoseconds = int(seconds), int(rest * 1e9)
        return {"time": {"secs": whole, "nsecs": nanoseconds, "sec": whole, "nanosec": nanoseconds}}

    def _get_param(self, name: str, default: str) -> Values:
        values = self._values()
        return {"value": json.dumps(values[name]) if name in values else default or '""'}

    def _values(self) -> Dict[str, Any]:
        return {
            f"{node}:{name}": value
            for node, tree in self._parameters().items()
            for name, value in flatten(tree)
            if not name.endswith("token")
        }


def _node_details(graph: Graph, name: str) -> Values:
    node = graph.nodes.get(name, NodeInfo((), (), ()))
    return {"subscribing": list(node.subscribes), "publishing": list(node.publishes), "services": list(node.services)}


def _service_details(type_name: str, *, response: bool) -> Values:
    definitions_by_type = definitions.service_definition(type_name, response)
    return {"typedefs": [_typedef(name, one) for name, one in definitions_by_type.items()]}


def _nodes_with(graph: Graph, kind: str, name: str) -> List[str]:
    """Returns the nodes of which `kind`, a field of NodeInfo, contains a topic or service."""
    return [node for node, info in graph.nodes.items() if name in getattr(info, kind)]


_OF_GRAPH: Mapping[str, Tuple[Sequence[str], Callable[..., Values]]] = {
    "topics": ((), lambda graph: {"topics": list(graph.topics), "types": list(graph.topics.values())}),
    "topics_for_type": (("type",), lambda graph, type_name: {"topics": _having(graph.topics, type_name)}),
    "topic_type": (("topic",), lambda graph, topic: {"type": graph.topics.get(topic, "")}),
    "services": ((), lambda graph: {"services": list(graph.services)}),
    "service_type": (("service",), lambda graph, service: {"type": graph.services.get(service, "")}),
    "services_for_type": (("type",), lambda graph, type_name: {"services": _having(graph.services, type_name)}),
    "service_node": (("service",), lambda graph, name: {"node": "".join(_nodes_with(graph, "services", name)[:1])}),
    "service_providers": (("service",), lambda graph, name: {"providers": _nodes_with(graph, "services", name)}),
    "service_host": (("service",), lambda graph, name: {"host": "localhost" if name in graph.services else ""}),
    "nodes": ((), lambda graph: {"nodes": list(graph.nodes)}),
    "node_details": (("node",), _node_details),
    "publishers": (("topic",), lambda graph, topic: {"publishers": _nodes_with(graph, "publishes", topic)}),
    "subscribers": (("topic",), lambda graph, topic: {"subscribers": _nodes_with(graph, "subscribes", topic)}),
}
"""The services that need only the graph: the fields of their request, all of them strings, and their function."""

_OTHERS: Mapping[str, Tuple[Sequence[str], Callable[..., Values]]] = {
    "topics_and_raw_types": ((), Rosapi._topics_and_raw_types),
    "action_servers": ((), lambda rosapi: {"action_servers": []}),
    "message_details": (("type",), Rosapi._message_details),
    "service_request_details": (("type",), lambda rosapi, name: _service_details(name, response=False)),
    "service_response_details": (("type",), lambda rosapi, name: _service_details(name, response=True)),
    "get_time": ((), Rosapi._get_time),
    "get_param_names": ((), lambda rosapi: {"names": list(rosapi._values())}),
    "get_param": (("name", "default_value"), Rosapi._get_param),
    "has_param": (("name",), lambda rosapi, name: {"exists": name in rosapi._values()}),
}


def _texts(args: object, names: Sequence[str]) -> List[str]:
    """Returns the fields of a request in order; empty if one is missing or not a string."""
    if isinstance(args, Mapping):
        values = [args.get(name, args.get(_OLD_NAMES.get(name, ""))) for name in names]
    else:
        values = list(args)[: len(names)] if isinstance(args, list) else []
    values += [None] * (len(names) - len(values))
    return [value if isinstance(value, str) else "" for value in values]


def _having(types: Mapping[str, str], type_name: str) -> List[str]:
    return [name for name, known_type in types.items() if canonical_type(known_type) == canonical_type(type_name)]


def _typedef(type_name: str, definition: Definition) -> Mapping[str, Any]:
    """Returns one definition as rosapi_msgs/TypeDef."""
    return {
        "type": type_name,
        "fieldnames": [field.name for field in definition.fields],
        "fieldtypes": [field.kind for field in definition.fields],
        "fieldarraylen": [-1 if field.size is None else max(field.size, 0) for field in definition.fields],
        "examples": [_example(field) for field in definition.fields],
        "constnames": [name for name, _ in definition.constants],
        "constvalues": [value for _, value in definition.constants],
    }


def _example(field: Field) -> str:
    if field.size is not None:
        return "[]"
    return "{}" if "/" in field.kind or field.kind in ("time", "duration") else _EXAMPLES.get(field.kind, "0")
