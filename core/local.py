"""The in-process middleware: tests, the embedded monitor, virtual time.

A `LocalBus` joins nodes inside one process. It has no thread: messages are delivered within `publish`, timers within
`run_due(now_s)`, which the owner calls. With a test's own numbers that is virtual time; `robot-health run` calls it
with the monotonic clock.
"""

from __future__ import annotations

import heapq
import itertools
import struct
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from .errors import ConfigError
from .faults import Faults
from .field_path import ABSENT, Keyed, key_field, number_of_text, parse_field_path
from .middleware import Graph, Message, NodeInfo, Severity, resolve_name, split_type_name
from .parameters import Parameter, flatten, unflatten

FieldGetter = Callable[[Any], Any]
Coercion = Callable[[Message, float], Message]


class LogLine(NamedTuple):
    """One line that a node wrote."""

    now_s: float
    node: str
    severity: Severity
    text: str


class LocalBus:
    """Topics, services and time shared by the nodes of one process."""

    def __init__(
        self,
        start_s: float = 0.0,
        on_log: Optional[Callable[[LogLine], None]] = None,
        wall_time_s: Optional[Callable[[], float]] = None,
    ) -> None:
        """Makes an empty bus.

        Args:
            start_s: the time at the start, in seconds.
            on_log: called with every log line; None keeps them in `log_lines`.
            wall_time_s: seconds since 1970, for the stamps of messages; None: the time of the bus.
        """
        self.now_s = start_s
        self.wall_time_s: Callable[[], float] = wall_time_s or (lambda: self.now_s)
        self.log_lines: List[LogLine] = []
        self.on_log: Callable[[LogLine], None] = on_log or self.log_lines.append
        self.types: Dict[str, str] = {}
        """Type name per topic, for topics that were advertised or subscribed to."""
        self._subscriptions: Dict[str, List[_LocalSubscription]] = {}
        self._services: Dict[str, Callable[[Message], Message]] = {}
        self._service_types: Dict[str, str] = {}
        self.nodes: List[LocalMiddleware] = []
        """The nodes that are not closed."""
        self._timers: List[Tuple[float, int, _LocalTimer]] = []
        self._order = itertools.count()

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Optional[Mapping[str, Any]] = None,
        remap: Optional[Mapping[str, str]] = None,
    ) -> LocalMiddleware:
        """Adds a node.

        Args:
            name: base name, `alert_system`.
            namespace: `robot1`, `/fleet/robot1` or empty.
            parameters: its configuration, nested as in the file under `ros__parameters`.
            remap: names as the node uses them (relative or absolute) to the names to use instead.
        """
        namespace = namespace.strip("/")
        full_name = f"/{namespace}/{name}" if namespace else f"/{name}"
        node = LocalMiddleware(self, full_name, parameters or {}, remap or {})
        self.nodes.append(node)
        return node

    def graph(self) -> Graph:
        """Returns the nodes that are not closed and what they do."""
        nodes = {
            node.name: NodeInfo(
                tuple(node._advertised),
                tuple(subscription.topic for subscription in node._subscriptions),
                tuple(node._services),
            )
            for node in self.nodes
        }
        used = {topic for node in nodes.values() for topic in (*node.publishes, *node.subscribes)}
        topics = {topic: type_name for topic, type_name in self.types.items() if topic in used}
        return Graph(topics, dict(self._service_types), nodes)

    def next_due_s(self) -> Optional[float]:
        """Returns when the next timer is due, None when there is none."""
        while self._timers and self._timers[0][2].cancelled:
            heapq.heappop(self._timers)
        return self._timers[0][0] if self._timers else None

    def run_due(self, now_s: float) -> None:
        """Moves time to `now_s` and calls every timer that is due, in the order of their times.

        Each is called at its own time, so that a jump ahead in a test sees every period. Time that goes back
        restarts every period.
        """
        if now_s < self.now_s:
            timers = [timer for _, _, timer in sorted(self._timers) if not timer.cancelled]
            self._timers = []
            self.now_s = now_s
            for timer in timers:
                self._schedule(timer, now_s + timer.period_s)
            return
        while True:
            due_s = self.next_due_s()
            if due_s is None or due_s > now_s:
                break
            timer = heapq.heappop(self._timers)[2]
            self.now_s = due_s
            self._schedule(timer, due_s + timer.period_s)
            timer.node.guard(timer.callback, due_s)
        self.now_s = now_s

    def call_service(self, service: str, request: Optional[Message] = None) -> Message:
        """Calls a service by its absolute name.

        Raises:
            ValueError: nobody offers it, or it failed.
        """
        handler = self._services.get(service)
        if handler is None:
            raise ValueError(f"no service {service}; there are {', '.join(sorted(self._services)) or 'none'}")
        return handler(request or {})

    def _schedule(self, timer: _LocalTimer, due_s: float) -> None:
        heapq.heappush(self._timers, (due_s, next(self._order), timer))

    def _deliver(self, topic: str, message: Message) -> None:
        for subscription in tuple(self._subscriptions.get(topic, ())):
            subscription.node.guard(subscription.deliver, message)


class _LocalTimer:
    def __init__(self, node: LocalMiddleware, period_s: float, callback: Callable[[float], None]) -> None:
        self.node = node
        self.period_s = period_s
        self.callback = callback
        self.cancelled = False

    def cancel(self) -> None:
        self.cancelled = True


class _LocalSubscription:
    def __init__(
        self, node: LocalMiddleware, topic: str, field: Optional[str], callback: Callable[[Any, float], None]
    ) -> None:
        self.node = node
        self.topic = topic
        self._field = field
        self._get: FieldGetter = _arrival if field is None else mapping_getter(field)
        self._callback = callback
        self._complained = False

    def deliver(self, message: Message) -> None:
        try:
            value = self._get(message)
        except (KeyError, TypeError, AttributeError):
            if not self._complained:
                self._complained = True
                there = ", ".join(message)
                self.node.log(Severity.ERROR, f"{self.topic} has no field {self._field}; there are {there}")
            return
        if value is not ABSENT:
            self._callback(value, self.node.now_s())


class LocalMiddleware:
    """One node on a `LocalBus`; implements `core.middleware.Middleware`."""

    def __init__(self, bus: LocalBus, name: str, parameters: Mapping[str, Any], remap: Mapping[str, str]) -> None:
        """Use `LocalBus.node`."""
        self.name = name
        self._bus = bus
        self._given = parameters
        self._on_change: Optional[Callable[[Mapping[str, Any]], str]] = None
        self._remap = {resolve_name(old, name): resolve_name(new, name) for old, new in remap.items()}
        self._advertised: Dict[str, Coercion] = {}
        self._subscriptions: List[_LocalSubscription] = []
        self._services: List[str] = []
        self._timers: List[_LocalTimer] = []
        self._closed = False
        self.faults = Faults()

    def now_s(self) -> float:
        return self._bus.now_s

    def waiting_for_clock(self) -> bool:
        return False

    def steady_s(self) -> float:
        return self._bus.now_s

    def given_parameters(self) -> Mapping[str, Any]:
        return self._given

    def declare_parameters(
        self, parameters: Sequence[Parameter], on_change: Callable[[Mapping[str, Any]], str]
    ) -> None:
        self._on_change = on_change

    def set_parameters(self, tree: Mapping[str, Any]) -> str:
        """Proposes a new configuration, nested, as `ros2 param set` and `~reload` do elsewhere.

        Returns:
            What changed, as one line.

        Raises:
            ConfigError: the node rejects it; the old one stays.
        """
        changes = ""
        if self._on_change is not None:
            try:
                changes = self._on_change(tree)
            except ConfigError:
                raise
            except Exception as error:
                raise ConfigError(self._log_failure(error)) from error
        self._given = tree
        return changes

    def set_parameter(self, name: str, value: object) -> str:
        """Proposes one changed value, by its dotted name.

        Returns:
            What changed, as one line.

        Raises:
            ConfigError: the node rejects it; the old one stays.
        """
        return self.set_parameters(unflatten({**dict(flatten(self._given)), name: value}))

    def advertise(self, topic: str, type_name: str) -> None:
        resolved = self._resolve(topic)
        self._bus.types.setdefault(resolved, type_name)
        self._advertised[resolved] = _coercion(type_name)

    def publish(self, topic: str, message: Message) -> None:
        resolved = self._require_advertised(topic)
        self._bus._deliver(resolved, self._advertised[resolved](message, self._bus.wall_time_s()))

    def has_listeners(self, topic: str) -> bool:
        return bool(self._bus._subscriptions.get(self._require_advertised(topic)))

    def subscribe(
        self, topic: str, type_name: str, callback: Callable[[Any, float], None], *, field: Optional[str] = ""
    ) -> _LocalSubscription:
        resolved = self._resolve(topic)
        if type_name:
            _coercion(type_name)
            self._bus.types.setdefault(resolved, type_name)
        subscription = _LocalSubscription(self, resolved, field, callback)
        self._bus._subscriptions.setdefault(resolved, []).append(subscription)
        self._subscriptions.append(subscription)
        return subscription

    def unsubscribe(self, subscription: Any) -> None:
        if subscription in self._subscriptions:
            self._subscriptions.remove(subscription)
            self._bus._subscriptions[subscription.topic].remove(subscription)

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        def answer(request: Message) -> Message:
            try:
                return handler(request)
            except Exception as error:
                raise ValueError(self._log_failure(error)) from error

        resolved = self._resolve(service)
        self._bus._services[resolved] = answer
        self._bus._service_types[resolved] = type_name
        self._services.append(resolved)

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> _LocalTimer:
        timer = _LocalTimer(self, period_s, callback)
        self._timers.append(timer)
        self._bus._schedule(timer, self._bus.now_s + period_s)
        return timer

    def graph(self) -> Graph:
        return self._bus.graph()

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        return self._bus.call_service(self._resolve(service), request)

    def message_definition(self, type_name: str) -> str:
        return ""

    def subscribe_raw(self, topic: str, type_name: str, callback: Callable[[bytes, float], None]) -> _LocalSubscription:
        raise ConfigError(f"{self._resolve(topic)} has no raw bytes: the in-process middleware carries mappings")

    def log(self, severity: Severity, text: str) -> None:
        self._bus.on_log(LogLine(self._bus.now_s, self.name, severity, text))

    def close(self) -> None:
        self._closed = True
        for timer in self._timers:
            timer.cancel()
        for subscription in tuple(self._subscriptions):
            self.unsubscribe(subscription)
        for service in self._services:
            self._bus._services.pop(service, None)
            self._bus._service_types.pop(service, None)
        if self in self._bus.nodes:
            self._bus.nodes.remove(self)
        self._services.clear()
        self._advertised.clear()

    def guard(self, callback: Callable[[Any], None], argument: object) -> None:
        """Calls back unless the node is closed; an exception becomes a log line."""
        if self._closed:
            return
        try:
            callback(argument)
        except Exception as error:
            self._log_failure(error)

    def _log_failure(self, error: Exception) -> str:
        text = f"{type(error).__name__} in a callback: {error}"
        self.log(Severity.ERROR, text)
        return text

    def _require_advertised(self, topic: str) -> str:
        """Returns the resolved name."""
        resolved = self._resolve(topic)
        if resolved not in self._advertised:
            raise ValueError(f"{self.name} publishes on {resolved}, which it has not advertised")
        return resolved

    def _resolve(self, name: str) -> str:
        resolved = resolve_name(name, self.name)
        return self._remap.get(resolved, resolved)


def _arrival(message: Message) -> float:
    return 1.0


def mapping_getter(field: str) -> FieldGetter:
    """Returns a function that reads `field`, a path as in `field_path.py`, from a mapping.

    Empty: the function returns the mapping itself. An index beyond the end reads as None, a key that no element has as
    ABSENT.

    Raises:
        ConfigError: it is no path.
    """
    try:
        steps = parse_field_path(field)
    except ValueError as error:
        raise ConfigError(f"found the field {field!r}, {error}") from None
    if len(steps) == 1:
        key = steps[0]
        return lambda message: message[key]

    def get(message: Any) -> Any:
        for step in steps:
            if isinstance(step, Keyed):
                message = _element_of_key(message, step.key)
                if message is ABSENT:
                    return ABSENT
            elif isinstance(step, int) and step >= len(message):
                return None
            else:
                message = message[step]
        if steps and isinstance(steps[-1], Keyed) and "key" in message:
            return number_of_text(message.get("value"))
        return message

    return get


def _element_of_key(elements: Any, key: str) -> Any:
    for element in elements:
        field = key_field(element)
        if field is not None and element[field] == key:
            return element
    return ABSENT


def _coercion(type_name: str) -> Coercion:
    """Returns what a real middleware does to a message of this type, sent at a time in seconds."""
    split = split_type_name(type_name)
    if split is None:
        raise ConfigError(f"found the type {type_name!r}, allowed is package/Type, for instance std_msgs/Float32")
    if tuple(split) == ("std_msgs", "Float32"):
        return _as_float32
    return _as_stamped if tuple(split) == ("diagnostic_msgs", "DiagnosticArray") else _as_is


def _as_is(message: Message, now_s: float) -> Message:
    return dict(message)


def _as_stamped(message: Message, now_s: float) -> Message:
    seconds = int(now_s // 1)
    stamp = {"sec": seconds, "nanosec": int((now_s - seconds) * 1e9)}
    return {**message, "header": {"stamp": stamp, "frame_id": "", **message.get("header", {})}}


def _as_float32(message: Message, now_s: float) -> Message:
    try:
        return {"data": _FLOAT32.unpack(_FLOAT32.pack(message.get("data", 0.0)))[0]}
    except OverflowError:
        return {"data": float("inf") if message["data"] > 0 else float("-inf")}
    except struct.error as error:
        raise ValueError(f"std_msgs/Float32 needs a number as data: {error}") from None


_FLOAT32 = struct.Struct("<f")
