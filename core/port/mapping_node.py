"""Code shared by the adapters that carry messages as mappings: the in-process one and the rosbridge client.

`MappingNode` adds names, parameters and the reading of fields to `ClockedNode`. A subclass adds publishing,
subscribing, services and `log`.
"""

from __future__ import annotations

from typing import Callable, Collection, Mapping, Sequence

from ..config import Parameter
from ..messages import (
    MISSING,
    MappingField,
    RawFormat,
    check_type,
    complete,
    definition,
    is_stamped,
    json_bytes,
    json_format,
)
from ..values import (
    ABSENT,
    Clock,
    ConfigError,
    JsonObject,
    Message,
    MessageError,
    ServiceError,
    Stamp,
    mapping_getter,
    printable,
    resolve_name,
)
from .clocked_node import ClockedNode
from .graph import GraphCallback, Wanted
from .middleware import Callback, OnChange, RawCallback, Severity, Timer

CLOCK = "/clock"
CLOCK_TYPE = "rosgraph_msgs/Clock"

_MAX_RESOLVED = 1000
_MAX_FIELDS_SHOWN = 20
_MAX_TEXT = 200


class LoggedSubscription:
    """A subscription that logs once why messages cannot be read."""

    topic: str
    _node: MappingNode
    _has_failed = False

    def log_once(self, text: str) -> None:
        """Logs a text, unless another one was logged before."""
        if not self._has_failed:
            self._has_failed = True
            self._node.failures.write(self.topic, Severity.ERROR, printable(text))


class MappingSubscription(LoggedSubscription, MappingField):
    """A subscription that reads one field from messages that are mappings. Implements `middleware.Subscription`."""

    def __init__(self, node: MappingNode, topic: str, type_name: str, field: str | None, callback: Callback) -> None:
        """Binds the field, with arguments, and errors, as of `Middleware.subscribe`, and the resolved topic."""
        super().__init__(topic, type_name, field)
        self.active = True
        """False once it has ended."""
        self.callback = callback
        self._node = node

    def deliver(self, message: Message) -> None:
        """Passes a message's value to the node, with the time."""
        try:
            value = self.read(message)
        except MISSING:
            self._log_missing(message)
            value = ABSENT
        self._node.call_back(self, value)

    def known_type(self) -> str:
        return self._type_name or self._node.type_of(self.topic)

    def _log_missing(self, message: Message) -> None:
        type_name = self.known_type()
        shown = f"{self.topic} ({type_name})" if type_name else self.topic
        available = ", ".join(list(message)[:_MAX_FIELDS_SHOWN])[:_MAX_TEXT]
        lacks = "does not have all of" if " where " in str(self._field) else "has no field"
        self.log_once(f"{shown} {lacks} {self._field}; available: {available}")


class RawSubscription(LoggedSubscription):
    """A subscription that gets messages, which are mappings, as JSON. Implements `middleware.Subscription`."""

    def __init__(self, node: MappingNode, topic: str, type_name: str, callback: RawCallback) -> None:
        """Binds the resolved topic, with arguments, and errors, as of `Middleware.subscribe_raw`."""
        if type_name:
            check_type(type_name)
        self.topic = topic
        self.active = True
        """False once it has ended."""
        self.callback: Callback = callback
        self._node = node
        self._type_name = type_name

    def deliver(self, message: Message) -> None:
        """Passes a message as JSON to the node, with its format, once this is known."""
        raw_format = self._node.raw_format_of(self.topic, self._type_name)
        if raw_format is None or raw_format.message_encoding != "json":
            return
        try:
            item = json_bytes(message), raw_format
        except (MessageError, TypeError, ValueError, RecursionError) as error:
            self.log_once(f"{self.topic}: a message is not recorded: {error}")
            return
        self._node.call_back(self, item)


class MappingNode(ClockedNode):
    """One node; the base of classes that implement `core.port.Middleware`."""

    knows_graph = False
    """Whether nodes and endpoints can be counted; then the class also has `follow_graph`."""

    def __init__(
        self,
        name: str,
        parameters: JsonObject,
        remap: Mapping[str, str],
        *,
        clock: Clock,
        wall_clock: Clock,
        use_sim_time: bool = False,
    ) -> None:
        """Creates a node that is not connected to anything, by its fully qualified name.

        `remap` maps names as the node uses them (relative or absolute) to the names to use instead. `clock` returns
        monotonic seconds, `wall_clock` seconds since 1970.
        """
        super().__init__(name, clock=clock, wall_clock=wall_clock, sim_time_s=0.0 if use_sim_time else None)
        self._given = parameters
        self._on_change: OnChange | None = None
        self._remap = {resolve_name(old, name): resolve_name(new, name) for old, new in remap.items()}
        self._resolved: dict[str, str] = {}
        self._advertised: dict[str, str] = {}

    def why_silent(self, topic: str, type_name: str) -> str | None:
        return self._hints.get(self.resolve(topic), type_name)

    def graph_name(self, key: str, name: str) -> str:
        if not self.knows_graph:
            raise ServiceError("the robot's graph is not known here")
        return self.resolve(name)

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> Timer:
        raise ServiceError("the robot's graph is not known here")

    def given_parameters(self) -> JsonObject:
        return self._given

    def declare_parameters(self, parameters: Sequence[Parameter], on_change: OnChange) -> None:
        self._on_change = on_change

    def set_parameters(self, tree: JsonObject) -> str:
        """Proposes a new configuration, nested, as `ros2 param set` and `~reload` do elsewhere; returns what changed.

        Raises ConfigError if the node rejects it, or fails; the old values stay in force.
        """
        with self._lock:
            try:
                changes = "" if self._on_change is None else self.answer(self._on_change, tree)
            except ServiceError as error:
                raise ConfigError(str(error)) from error
            self._given = tree
            return changes

    def take_clock(self, message: Message, arrived_s: float = 0.0) -> None:
        """Processes a message of /clock, as a callback; call for every one of them under `use_sim_time`."""
        now_s = read_clock(message)
        if now_s is not None:
            self.set_sim_time(now_s)

    def type_of(self, topic: str) -> str:
        """Returns the type of a topic by its resolved name, empty if it is not known."""
        return ""

    def raw_format_of(self, topic: str, type_name: str) -> RawFormat | None:
        """Returns the format of a topic's messages as they are captured; None if it is not known yet."""
        type_name = type_name or self.type_of(topic)
        return json_format(type_name, definition(type_name))

    def resolve(self, name: str) -> str:
        """Returns the absolute name that a name stands for, after remapping."""
        known = self._resolved.get(name)
        if known is None:
            if len(self._resolved) >= _MAX_RESOLVED:
                self._resolved.clear()  # clients of a server choose names
            resolved = resolve_name(name, self.name)
            known = self._resolved[name] = self._remap.get(resolved, resolved)
        return known

    def serialize(self, type_name: str, message: Message) -> tuple[bytes, RawFormat]:
        return json_bytes(self.transported(type_name, message)), json_format(type_name, definition(type_name))

    def transported(self, type_name: str, message: Message) -> Message:
        """Returns what subscribers receive of a message: with all fields, and stamped if it has no stamp."""
        completed = complete(type_name, message)
        if is_stamped(type_name) and "stamp" not in message.get("header", {}):
            stamp_s = self.stamp_s()
            seconds = int(stamp_s // 1)
            completed["header"]["stamp"] = {"secs": seconds, "nsecs": int((stamp_s - seconds) * 1e9)}
        return completed

    def require_advertised(self, topic: str) -> str:
        """Returns the resolved name of a topic; raises MessageError if it is not advertised."""
        resolved = self.resolve(topic)
        if resolved not in self._advertised:
            raise MessageError(f"{self.name} has not advertised {resolved}")
        return resolved


def read_clock(message: Message) -> float | None:
    """Returns the time of a rosgraph_msgs/Clock in s, with the stamp of ROS 1 or ROS 2; None if it is not valid."""
    stamp = _clock_of(message) if "clock" in message else None
    return float(stamp) if type(stamp) is Stamp else None


_clock_of = mapping_getter("clock")
