"""The services of the package rosapi, by which clients query the graph.

Names and fields are those of rosapi_msgs. The server itself provides them, so that they exist with every middleware.
Each call reads the graph once.
"""

from __future__ import annotations

import json
from itertools import starmap
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

from robot_health_monitor.core.definitions import Definition, Field
from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.middleware import Graph, canonical_type
from robot_health_monitor.core.parameters import flatten

from ..protocol import definitions

PREFIX = "/rosapi/"
_EXAMPLES = {"string": "", "bool": "False", "float32": "0.0", "float64": "0.0"}


class Rosapi:
    """The services under `/rosapi/`."""

    def __init__(
        self,
        graph: Callable[[], Graph],
        definition: Callable[[str], str],
        parameters: Callable[[], Mapping[str, Mapping[str, Any]]],
        time_s: Callable[[], float],
    ) -> None:
        """Stores the sources.

        Args:
            graph: returns the current graph.
            definition: returns the definition of a message type, with the types that it contains; empty if unknown.
            parameters: returns the parameters per node, nested.
            time_s: returns the time for `get_time`, in s since its epoch.
        """
        self._graph = graph
        self._definition = definition
        self._parameters = parameters
        self._time_s = time_s
        self.services: Mapping[str, str] = {
            PREFIX + name: f"rosapi/{name.title().replace('_', '')}" for name in _SERVICES
        }
        """Type per service."""

    def answer(self, service: str, args: object) -> Mapping[str, Any]:
        """Returns the response of a service. May block.

        Args:
            service: its name, `/rosapi/topics`.
            args: the fields of the request, by name or in order.

        Raises:
            ServiceError: the service does not exist, or the graph cannot be read.
        """
        found = _SERVICES.get(service[len(PREFIX) :]) if service.startswith(PREFIX) else None
        if found is None:
            raise ServiceError(f"no service {service}")
        function, names = found
        return function(self, *_texts(args, names))

    def _topics(self) -> Mapping[str, Any]:
        topics = self._graph().topics
        return {"topics": list(topics), "types": list(topics.values())}

    def _topics_for_type(self, type_name: str) -> Mapping[str, Any]:
        return {"topics": _having(self._graph().topics, type_name)}

    def _topic_type(self, topic: str) -> Mapping[str, Any]:
        return {"type": self._graph().topics.get(topic, "")}

    def _topics_and_raw_types(self) -> Mapping[str, Any]:
        topics = self._graph().topics
        texts = {type_name: self._definition(type_name) for type_name in set(topics.values())}
        return {
            "topics": list(topics),
            "types": list(topics.values()),
            "typedefs_full_text": [texts[type_name] for type_name in topics.values()],
        }

    def _services(self) -> Mapping[str, Any]:
        return {"services": list(self._graph().services)}

    def _service_type(self, service: str) -> Mapping[str, Any]:
        return {"type": self._graph().services.get(service, "")}

    def _services_for_type(self, type_name: str) -> Mapping[str, Any]:
        return {"services": _having(self._graph().services, type_name)}

    def _service_node(self, service: str) -> Mapping[str, Any]:
        nodes = [name for name, node in self._graph().nodes.items() if service in node.services]
        return {"node": nodes[0] if nodes else ""}

    def _service_providers(self, service: str) -> Mapping[str, Any]:
        return {"providers": [name for name, node in self._graph().nodes.items() if service in node.services]}

    def _service_host(self, service: str) -> Mapping[str, Any]:
        return {"host": "localhost" if service in self._graph().services else ""}

    def _nodes(self) -> Mapping[str, Any]:
        return {"nodes": list(self._graph().nodes)}

    def _node_details(self, name: str) -> Mapping[str, Any]:
        node = self._graph().nodes.get(name)
        if node is None:
            return {"subscribing": [], "publishing": [], "services": []}
        return {
            "subscribing": list(node.subscribes),
            "publishing": list(node.publishes),
            "services": list(node.services),
        }

    def _publishers(self, topic: str) -> Mapping[str, Any]:
        return {"publishers": [name for name, node in self._graph().nodes.items() if topic in node.publishes]}

    def _subscribers(self, topic: str) -> Mapping[str, Any]:
        return {"subscribers": [name for name, node in self._graph().nodes.items() if topic in node.subscribes]}

    def _action_servers(self) -> Mapping[str, Any]:
        return {"action_servers": []}

    def _message_details(self, type_name: str) -> Mapping[str, Any]:
        found = definitions.parse(type_name, self._definition(type_name))
        return {"typedefs": [_typedef(name, one) for name, one in found.items() if one.fields or one.constants]}

    def _service_request_details(self, type_name: str) -> Mapping[str, Any]:
        return {"typedefs": list(starmap(_typedef, definitions.service_definition(type_name, False).items()))}

    def _service_response_details(self, type_name: str) -> Mapping[str, Any]:
        return {"typedefs": list(starmap(_typedef, definitions.service_definition(type_name, True).items()))}

    def _get_time(self) -> Mapping[str, Any]:
        seconds, rest = divmod(self._time_s(), 1.0)
        nanoseconds = int(rest * 1e9)
        whole = int(seconds)
        return {"time": {"secs": whole, "nsecs": nanoseconds, "sec": whole, "nanosec": nanoseconds}}

    def _get_param_names(self) -> Mapping[str, Any]:
        return {"names": list(self._values())}

    def _get_param(self, name: str, default: str) -> Mapping[str, Any]:
        values = self._values()
        return {"value": json.dumps(values[name]) if name in values else default or '""'}

    def _has_param(self, name: str) -> Mapping[str, Any]:
        return {"exists": name in self._values()}

    def _values(self) -> Dict[str, Any]:
        return {
            f"{node}:{name}": value
            for node, tree in self._parameters().items()
            for name, value in flatten(tree)
            if not name.endswith("token")
        }


_SERVICES: Mapping[str, Tuple[Callable[..., Mapping[str, Any]], Sequence[str]]] = {
    "topics": (Rosapi._topics, ()),
    "topics_for_type": (Rosapi._topics_for_type, ("type",)),
    "topic_type": (Rosapi._topic_type, ("topic",)),
    "topics_and_raw_types": (Rosapi._topics_and_raw_types, ()),
    "services": (Rosapi._services, ()),
    "service_type": (Rosapi._service_type, ("service",)),
    "services_for_type": (Rosapi._services_for_type, ("type",)),
    "service_node": (Rosapi._service_node, ("service",)),
    "service_providers": (Rosapi._service_providers, ("service",)),
    "service_host": (Rosapi._service_host, ("service",)),
    "nodes": (Rosapi._nodes, ()),
    "node_details": (Rosapi._node_details, ("node",)),
    "publishers": (Rosapi._publishers, ("topic",)),
    "subscribers": (Rosapi._subscribers, ("topic",)),
    "action_servers": (Rosapi._action_servers, ()),
    "message_details": (Rosapi._message_details, ("type",)),
    "service_request_details": (Rosapi._service_request_details, ("type",)),
    "service_response_details": (Rosapi._service_response_details, ("type",)),
    "get_time": (Rosapi._get_time, ()),
    "get_param_names": (Rosapi._get_param_names, ()),
    "get_param": (Rosapi._get_param, ("name", "default_value")),
    "has_param": (Rosapi._has_param, ("name",)),
}
"""Function and fields of the request per service; all fields are strings."""


_OLD_NAMES = {"default_value": "default"}
"""The name of a field in ROS 1."""


def _texts(args: object, names: Sequence[str]) -> List[str]:
    """Returns the fields of a request in order; empty if one is missing or not a string."""
    if isinstance(args, Mapping):
        found = [args.get(name, args.get(_OLD_NAMES.get(name, ""))) for name in names]
    else:
        found = list(args)[: len(names)] if isinstance(args, list) else []
    found += [None] * (len(names) - len(found))
    return [value if isinstance(value, str) else "" for value in found]


def _having(types: Mapping[str, str], type_name: str) -> List[str]:
    return [name for name, found in types.items() if canonical_type(found) == canonical_type(type_name)]


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
