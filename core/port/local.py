"""The in-process middleware, for the embedded monitor, tests and virtual time.

A `LocalBus` connects nodes inside one process. It has no thread: messages are delivered within `publish`, timers are
called within `run_due(now_s)`, which the owner calls: `robot-health run` with the monotonic clock, a test with
numbers. Simulated time comes from the bus's topic `/clock`, as on a robot.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Callable, Collection, Iterable, Mapping, NamedTuple

from ..messages import RawFormat, check_type, definition, json_format
from ..values import Clock, ConfigError, JsonObject, Message, ServiceError, full_name, split_type_name
from .graph import Counts, GraphCallback, Wanted, count, state_of
from .hints import Answer, explain, similar_topic
from .mapping_node import CLOCK, MappingNode, MappingSubscription, RawSubscription
from .middleware import Callback, Graph, NodeInfo, RawCallback, Severity
from .timers import ClockTimer


class LogLine(NamedTuple):
    """One line in the log."""

    now_s: float
    node: str
    severity: Severity
    text: str


_Deliver = Callable[[Message], None]


@dataclass
class _Topic:
    """What a bus knows of a topic."""

    type_name: str = ""
    publisher: str = ""
    """The node that published last."""
    listeners: list[_Deliver] = field(default_factory=list)


class LocalBus:
    """Topics, services and time shared by the nodes of one process."""

    def __init__(
        self,
        start_s: float = 0.0,
        on_log: Callable[[LogLine], None] | None = None,
        wall_time_s: Clock | None = None,
        clock: Clock | None = None,
    ) -> None:
        """Creates a bus without nodes, whose time begins at `start_s`, in s.

        `on_log` is called with every log line; if it is None, they are appended to `log_lines`. `wall_time_s` returns
        seconds since 1970, for the stamps of messages; if it is None, they have the time of the bus. `clock` returns
        monotonic seconds, also between two calls of `run_due`; if it is None, time changes only in `run_due`.
        """
        self._now_s = start_s
        self._clock = clock
        self.wall_time_s: Clock = wall_time_s or (lambda: self.now_s)
        self.log_lines: list[LogLine] = []
        self._on_log: list[Callable[[LogLine], None]] = [on_log or self.log_lines.append]
        self.nodes: list[LocalMiddleware] = []
        """The nodes that are not closed."""
        self._topics: dict[str, _Topic] = {}
        """Those that are advertised or subscribed to."""
        self._services: dict[str, tuple[str, Callable[[Message], Message]]] = {}
        """Type and handler of each service."""

    @property
    def now_s(self) -> float:
        """The time in seconds."""
        return self._now_s if self._clock is None else self._clock()

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: JsonObject | None = None,
        remap: Mapping[str, str] | None = None,
        use_sim_time: bool = False,
    ) -> LocalMiddleware:
        """Adds a node by its base name, in a namespace such as `robot1`, `/fleet/robot1` or, empty, in none.

        `parameters` is its configuration, nested as in the file under `ros__parameters`. `remap` maps names as the node
        uses them (relative or absolute) to the names to use instead. With `use_sim_time`, its time is that of `/clock`.
        """
        node = LocalMiddleware(self, full_name(name, namespace), parameters or {}, remap or {}, use_sim_time)
        self.nodes.append(node)
        return node

    def log(self, line: LogLine) -> None:
        """Writes a line to the log."""
        for receive in tuple(self._on_log):
            receive(line)

    def add_log(self, on_log: Callable[[LogLine], None]) -> None:
        """Calls a further function with every log line from now on."""
        self._on_log.append(on_log)

    def graph(self) -> Graph:
        """Returns the nodes that are not closed, with their topics and services."""
        nodes = {}
        for node in self.nodes:
            subscribed = tuple(subscription.topic for subscription in node._subscriptions)
            nodes[node.name] = NodeInfo(tuple(node._advertised), subscribed, tuple(node._services))
        topics = {name: topic.type_name for name, topic in self._topics.items() if topic.type_name}
        services = {service: type_name for service, (type_name, _) in self._services.items()}
        return Graph(topics, services, nodes)

    def next_due_s(self) -> float | None:
        """Returns when the next timer is due, in s; None without timers."""
        due_s = min((node.next_steady_s() for node in self.nodes), default=math.inf)
        return None if due_s == math.inf else due_s

    def run_due(self, now_s: float) -> None:
        """Moves time to `now_s` and calls every timer that is due, once; if time goes back, every period restarts."""
        self._now_s = now_s
        for node in sorted(self.nodes, key=LocalMiddleware.next_steady_s):
            node.run_steady_timers()

    def run_until(self, now_s: float) -> None:
        """Moves virtual time to `now_s` from one due timer to the next, so that no period is skipped.

        For tests and replays. A real clock that jumps ahead must not be followed like this: use `run_due`.
        """
        due_s = self.next_due_s()
        while due_s is not None and due_s <= now_s:
            self.run_due(due_s)
            due_s = self.next_due_s()
        self.run_due(now_s)

    def call_service(self, service: str, request: Message | None = None) -> Message:
        """Calls a service by its absolute name; raises ServiceError if it does not exist, or if it failed."""
        if service not in self._services:
            raise ServiceError(f"there is no service {service}")
        _, handler = self._services[service]
        return handler(request or {})

    def _topic(self, name: str, type_name: str) -> _Topic:
        """Returns a topic, which begins to be known; its type is the first one that is not empty."""
        topic = self._topics.setdefault(name, _Topic())
        topic.type_name = topic.type_name or type_name
        return topic

    def _remove_listener(self, topic: str, deliver: _Deliver) -> None:
        self._topics[topic].listeners.remove(deliver)
        self._forget_unused([topic])

    def _forget_unused(self, topics: Iterable[str]) -> None:
        """Forgets topics without publishers and subscribers: the clients of a server may invent any number of names."""
        for topic in topics:
            if not self._topics[topic].listeners and not any(topic in node._advertised for node in self.nodes):
                del self._topics[topic]


class LocalMiddleware(MappingNode):
    """One node on a `LocalBus`; implements `core.port.ServedMiddleware`."""

    knows_graph = True

    def __init__(
        self, bus: LocalBus, name: str, parameters: JsonObject, remap: Mapping[str, str], use_sim_time: bool
    ) -> None:
        """Use `LocalBus.node`."""
        clocks: dict[str, Clock] = {"clock": lambda: bus.now_s, "wall_clock": lambda: bus.wall_time_s()}
        super().__init__(name, parameters, remap, **clocks, use_sim_time=use_sim_time)
        self._bus = bus
        self._subscriptions: list[Any] = []
        self._services: list[str] = []
        self._latched: dict[str, Message | None] = {}
        if use_sim_time:
            bus._topic(CLOCK, "").listeners.append(self.take_clock)

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> str:
        resolved = self.resolve(topic)
        check_type(type_name)
        self._bus._topic(resolved, type_name)
        self._advertised[resolved] = type_name
        if latched:
            self._latched.setdefault(resolved, None)
        return resolved

    def publish(self, topic: str, message: Message) -> None:
        resolved = self.require_advertised(topic)
        transported = self.transported(self._advertised[resolved], message)
        if resolved in self._latched:
            self._latched[resolved] = transported
        topic_there = self._bus._topics[resolved]
        topic_there.publisher = self.name
        for deliver in tuple(topic_there.listeners):
            deliver(transported)

    def has_listeners(self, topic: str) -> bool:
        return bool(self._bus._topics[self.require_advertised(topic)].listeners)

    def subscribe(
        self, topic: str, type_name: str, callback: Callback, *, field: str | None = "", latched: bool = False
    ) -> MappingSubscription:
        subscription = MappingSubscription(self, self.resolve(topic), type_name, field, callback)
        self._add(subscription, type_name)
        if latched:
            for message in filter(None, [node._latched.get(subscription.topic) for node in self._bus.nodes]):
                subscription.deliver(message)
        return subscription

    def subscribe_raw(self, topic: str, type_name: str, callback: RawCallback) -> RawSubscription:
        subscription = RawSubscription(self, self.resolve(topic), type_name, callback)
        self._add(subscription, type_name)
        return subscription

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        published = {name: kind for node in self._bus.nodes for name, kind in node._advertised.items()}
        types = [published[topic]] if topic in published else []
        last = self._bus._topics.get(topic, _Topic()).publisher
        gone = {last}.difference(["", *(node.name for node in self._bus.nodes)])
        answer(explain(topic, type_name, types, gone, similar_topic(topic, type_name, published)))

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> ClockTimer:
        def read(now_s: float) -> None:
            if not self.waiting_for_clock():
                callback(self._count(wanted()), now_s)

        return self.create_timer(1.0, read, steady=True)

    def _count(self, wanted: Collection[Wanted]) -> Counts:
        names = [node.name for node in self._bus.nodes]
        others = [node for node in self._bus.nodes if node is not self]
        publishers = (topic for node in others for topic in node._advertised)
        subscribers = (topic for node in others for topic in {each.topic for each in node._subscriptions})
        counts = count(wanted, names, publishers, subscribers)
        for key, name in wanted:
            if key == "lifecycle":
                with contextlib.suppress(Exception):  # whatever its handler raises
                    is_there = name in names
                    counts[key, name] = state_of(self._bus.call_service(f"{name}/get_state")) if is_there else 0.0
        return counts

    def unsubscribe(self, subscription: Any) -> None:
        if subscription in self._subscriptions:
            subscription.active = False
            self._subscriptions.remove(subscription)
            self._bus._remove_listener(subscription.topic, subscription.deliver)

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        if split_type_name(type_name) is None:
            raise ConfigError(f"expected a type such as std_srvs/Trigger, got {type_name!r}")
        resolved = self.resolve(service)
        self._bus._services[resolved] = type_name, partial(self.answer, handler)
        self._services.append(resolved)

    def graph(self) -> Graph:
        return self._bus.graph()

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        return self._bus.call_service(self.resolve(service), request)

    def type_of(self, topic: str) -> str:
        return self._bus._topics.get(topic, _Topic()).type_name

    def topic_types(self) -> Mapping[str, str]:
        return self._bus.graph().topics

    def raw_format(self, type_name: str) -> RawFormat:
        check_type(type_name)
        return json_format(type_name, definition(type_name))

    def log(self, severity: Severity, text: str) -> None:
        self.faults.guard("log", self._bus.log, LogLine(self._bus.now_s, self.name, severity, text))

    def _add(self, subscription: MappingSubscription | RawSubscription, type_name: str) -> None:
        topic = self._bus._topic(subscription.topic, type_name)
        # What is captured comes first: its time must not include that which an alert takes.
        is_first = isinstance(subscription, RawSubscription)
        topic.listeners.insert(0 if is_first else len(topic.listeners), subscription.deliver)
        self._subscriptions.append(subscription)

    def close(self) -> None:
        if self.closed:
            return
        self.closed = True
        self.cancel_timers()
        for subscription in tuple(self._subscriptions):
            self.unsubscribe(subscription)
        if self._sim_time_s is not None:
            self._bus._remove_listener(CLOCK, self.take_clock)
        for service in self._services:
            self._bus._services.pop(service, None)
        self._services.clear()
        self._bus.nodes.remove(self)
        self._bus._forget_unused(self._advertised)
        self._advertised.clear()
