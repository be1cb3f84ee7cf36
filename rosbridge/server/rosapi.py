"""The services of the package rosapi, by which clients query the graph.

Names and fields are those of rosapi_msgs. The server itself provides them, so that they exist with every middleware.
Each call reads the graph once.
"""

from __future__ import annotations

import json
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

from ...core.config.parameters import flatten
from ...core.messages.definitions import Definitions, Field
from ...core.port.middleware import Graph, NodeInfo
from ...core.values.errors import ServiceError
from ...core.values.names import canonical_type
from ..protocol.definitions import parse, service_definition

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
        self.graph = graph
        self.definition = definition
        self._parameters = parameters
        self._time_s = time_s
        self.services: Mapping[str, str] = {
            PREFIX + name: f"rosapi/{name.title().replace('_', '')}" for name in _SERVICES
        }
        """Type per service."""

    def answer(self, service: str, args: object) -> Values:
        """Returns the response of a service to the fields of a request, by name or in order. May block.

        Raises ServiceError if the service does not exist, or the graph cannot be read.
        """
        if service not in self.services:
            raise ServiceError(f"no service {service}")
        names, function = _SERVICES[service[len(PREFIX) :]]
        return function(self, *_texts(args, names))

    def nodes_with(self, kind: str, name: str) -> List[str]:
        """Returns the nodes of which `kind`, a field of NodeInfo, contains a topic or service."""
        return [node for node, info in self.graph().nodes.items() if name in getattr(info, kind)]

    def _topics(self) -> Dict[str, List[str]]:
        topics = self.graph().topics
        return {"topics": list(topics), "types": list(topics.values())}

    def _topics_and_raw_types(self) -> Values:
        values = self._topics()
        texts = {type_name: self.definition(type_name) for type_name in set(values["types"])}
        return {**values, "typedefs_full_text": [texts[one] for one in values["types"]]}

    def _node_details(self, name: str) -> Values:
        node = self.graph().nodes.get(name, NodeInfo((), (), ()))
        return {
            "subscribing": list(node.subscribes),
            "publishing": list(node.publishes),
            "services": list(node.services),
        }

    def _get_time(self) -> Values:
        seconds, rest = divmod(self._time_s(), 1.0)
        whole, nanoseconds = int(seconds), int(rest * 1e9)
        return {"time": {"secs": whole, "nsecs": nanoseconds, "sec": whole, "nanosec": nanoseconds}}

    def _get_param(self, name: str, default: str) -> Values:
        values = self.values()
        return {"value": json.dumps(values[name]) if name in values else default or '""'}

    def values(self) -> Dict[str, Any]:
        """Returns the parameters that clients may read, by node and name."""
        return {
            f"{node}:{name}": value
            for node, tree in self._parameters().items()
            for name, value in flatten(tree)
            if not name.endswith("token")
        }


_SERVICES: Mapping[str, Tuple[Sequence[str], Callable[..., Values]]] = {
    "topics": ((), Rosapi._topics),
    "topics_for_type": (("type",), lambda api, kind: {"topics": _having(api.graph().topics, kind)}),
    "topic_type": (("topic",), lambda api, topic: {"type": api.graph().topics.get(topic, "")}),
    "topics_and_raw_types": ((), Rosapi._topics_and_raw_types),
    "services": ((), lambda api: {"services": list(api.graph().services)}),
    "service_type": (("service",), lambda api, service: {"type": api.graph().services.get(service, "")}),
    "services_for_type": (("type",), lambda api, kind: {"services": _having(api.graph().services, kind)}),
    "service_node": (("service",), lambda api, name: {"node": "".join(api.nodes_with("services", name)[:1])}),
    "service_providers": (("service",), lambda api, name: {"providers": api.nodes_with("services", name)}),
    "service_host": (("service",), lambda api, name: {"host": "localhost" if name in api.graph().services else ""}),
    "nodes": ((), lambda api: {"nodes": list(api.graph().nodes)}),
    "node_details": (("node",), Rosapi._node_details),
    "publishers": (("topic",), lambda api, topic: {"publishers": api.nodes_with("publishes", topic)}),
    "subscribers": (("topic",), lambda api, topic: {"subscribers": api.nodes_with("subscribes", topic)}),
    "action_servers": ((), lambda api: {"action_servers": []}),
    "message_details": (("type",), lambda api, name: _typedefs(parse(name, api.definition(name)))),
    "service_request_details": (("type",), lambda api, name: _typedefs(service_definition(name, False))),
    "service_response_details": (("type",), lambda api, name: _typedefs(service_definition(name, True))),
    "get_time": ((), Rosapi._get_time),
    "get_param_names": ((), lambda api: {"names": list(api.values())}),
    "get_param": (("name", "default_value"), Rosapi._get_param),
    "has_param": (("name",), lambda api, name: {"exists": name in api.values()}),
}
"""The fields of each service's request, all of them strings, and its function."""


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


def _typedefs(known: Definitions) -> Values:
    """Returns definitions as a list of rosapi_msgs/TypeDef."""
    return {
        "typedefs": [
            {
                "type": type_name,
                "fieldnames": [field.name for field in fields],
                "fieldtypes": [field.kind for field in fields],
                "fieldarraylen": [-1 if field.size is None else max(field.size, 0) for field in fields],
                "examples": [_example(field) for field in fields],
                "constnames": [name for name, _ in constants],
                "constvalues": [value for _, value in constants],
            }
            for type_name, (fields, constants) in known.items()
        ]
    }


def _example(field: Field) -> str:
    if field.size is not None:
        return "[]"
    return "{}" if "/" in field.kind or field.kind in ("time", "duration") else _EXAMPLES.get(field.kind, "0")
