"""The port over rclpy: translates, and holds the lock. Health is judged in `core`.

A process may hold several `Ros2Middleware`s, each an rclpy node with its own parameters and services:
`/alert_system/reset` exists whether or not the three nodes are composed.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Collection, Iterator, Mapping, Sequence

from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.logging import get_logger
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ..core.config import Parameter
from ..core.messages import SerializedType
from ..core.port import (
    Callback,
    ClockTimer,
    Counts,
    Graph,
    NodeInfo,
    OnChange,
    RawCallback,
    Severity,
    Wanted,
    count,
    is_pattern,
    matching,
)
from ..core.values import (
    ConfigError,
    Getter,
    Message,
    MessageError,
    ServiceError,
    canonical_type,
    resolve_name,
    with_degree_sign,
)
from ..runtime.native_node import NativeNode
from . import messages
from .lifecycle import LifecycleStates
from .parameters import NodeParameters, ParameterNode
from .publishers import PublisherLookup, are_latched, full_name, has_best_effort, node_names

_QUEUE_SIZE = 1000
"""Outgoing messages that a reliable subscriber may still request, then the oldest are lost: room for many alerts."""
_SUBSCRIBER_QUEUE_SIZE = 10
"""Incoming messages that may wait: ROS 2's own default."""
_STATIC_QUEUE_SIZE = 100
"""The same for latched messages, of which each of many publishers may have one: that of tf2's listeners."""
_DURABILITY = {True: DurabilityPolicy.TRANSIENT_LOCAL, False: DurabilityPolicy.VOLATILE}
"""By whether the messages are latched."""
_GET_STATE = "lifecycle_msgs/GetState"
_QOS_CHECK_PERIOD_S = 1.0
"""Period of the check for publishers with an incompatible QoS, in s."""
_LONGEST_WAIT_S = 3600.0
"""Longest wait for a timer, in s."""


class Ros2Middleware(NativeNode):
    """One rclpy node; implements `core.port.middleware.ServedMiddleware`. It works while an executor spins `node`."""

    def __init__(self, name: str, context: Context | None = None, **options: Any) -> None:
        """Creates the node.

        Args:
            name: name of the node, which `__node:=` may change.
            context: rclpy's context; None for the default one.
            options: further arguments of rclpy's Node, such as `namespace` and `parameter_overrides`.
        """
        self.node = ParameterNode(name, context=context, **options)
        self._ros_clock = self.node.get_clock()
        self._lookup = PublisherLookup(self.node, self._qos_of)
        sim_time_s = self._ros_clock.now().nanoseconds / 1e9 if self._ros_clock.ros_time_is_active else None
        super().__init__(self.node.get_fully_qualified_name(), messages, sim_time_s)
        self.parameters = NodeParameters(self.node)
        self._states = LifecycleStates(self.node)
        self._channels: dict[tuple[str, Any], _Channel] = {}
        self._wake = self.node.create_timer(
            _LONGEST_WAIT_S, self._run_timers, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        """Calls when the next timer on steady time is due. Those on simulated time are called when it is set."""
        self.create_timer(_QOS_CHECK_PERIOD_S, self._check_publishers, steady=True)
        self._jumps = self._ros_clock.create_jump_callback(
            JumpThreshold(min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1)),
            post_callback=self._on_time_jump,
        )

    def declare_parameters(self, parameters: Sequence[Parameter], on_change: OnChange) -> None:
        self.parameters.declare(parameters, partial(self.answer, on_change), self.log)

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> str:
        resolved = self._resolve(topic)
        if resolved not in self._publishers:
            cls = messages.message_class(type_name)
            publisher = self.node.create_publisher(
                cls,
                _native_name(topic),
                QoSProfile(depth=1, durability=_DURABILITY[True]) if latched else _QUEUE_SIZE,
                event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            )
            self._publishers[resolved] = publisher, cls
        return resolved

    def has_listeners(self, topic: str) -> bool:
        publisher, _ = self._advertised(topic)
        return bool(publisher.get_subscription_count())

    def subscribe(
        self, topic: str, type_name: str, callback: Callback, *, field: str | None = "", latched: bool = False
    ) -> Subscription:
        native_name = _native_name(topic)
        return self._begin(Subscription(self._resolve(topic), native_name, callback, field, latched), type_name)

    def subscribe_raw(self, topic: str, type_name: str, callback: RawCallback) -> Subscription:
        subscription = Subscription(self._resolve(topic), _native_name(topic), callback, None, is_raw=True)
        subscription.follows_type = not type_name
        return self._begin(subscription, type_name)

    def topic_types(self) -> Mapping[str, str]:
        return {topic: types[0] for topic, types in self.node.get_topic_names_and_types() if types}

    def why_silent(self, topic: str, type_name: str) -> str | None:
        with self._lock:
            return self._hints.get(self._resolve(topic), type_name)

    def graph_name(self, key: str, name: str) -> str:
        if key == "lifecycle":
            messages.service_class(_GET_STATE)
        is_topic = key in ("publishers", "subscribers") and not is_pattern(name)
        return self._resolve(name) if is_topic else resolve_name(name, self.name)

    def graph(self) -> Graph:
        """See `ServedMiddleware.graph`: what discovery has found so far."""
        node = self.node
        nodes: dict[str, NodeInfo] = {}
        for name, namespace in node.get_node_names_and_namespaces():
            try:
                nodes[full_name(name, namespace)] = NodeInfo(
                    _names(node.get_publisher_names_and_types_by_node(name, namespace)),
                    _names(node.get_subscriber_names_and_types_by_node(name, namespace)),
                    _names(node.get_service_names_and_types_by_node(name, namespace)),
                )
            except RuntimeError:  # the node has just left
                continue
        return Graph(
            self.topic_types(),
            {service: types[0] for service, types in node.get_service_names_and_types() if types},
            nodes,
        )

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        """See `ServedMiddleware.call_service`; call it while another thread spins the node."""
        deadline_s = time.monotonic() + timeout_s
        try:
            resolved = self._resolve(service)
            type_name = type_name or dict(self.node.get_service_names_and_types()).get(resolved, [""])[0]
            if not type_name:
                raise ServiceError(f"{resolved}: no such service")
            cls = messages.service_class(type_name)
            native = messages.to_native(cls.Request, request)
            client = self.node.create_client(cls, resolved)
        except MessageError as error:
            raise MessageError(f"{service}: {error}") from None
        except (ValueError, RuntimeError) as error:  # an unknown type, an invalid name, a node that is closing
            raise ServiceError(f"{service}: {' '.join(str(error).split())}") from None
        try:
            if not client.wait_for_service(timeout_s):
                raise ServiceError(f"{resolved}: no such service")
            answered = threading.Event()
            future = client.call_async(native)
            future.add_done_callback(lambda done: answered.set())
            if not answered.wait(max(0.0, deadline_s - time.monotonic())):
                client.remove_pending_request(future)
                raise ServiceError(f"{resolved}: no response within {timeout_s:g} s")
            return messages.to_mapping(future.result())
        finally:
            self.node.destroy_client(client)

    def _count(self, wanted: Collection[Wanted]) -> Counts:
        node = self.node
        names = node_names(node)
        publishers = self._endpoints("publishers", wanted, node.get_publishers_info_by_topic)
        subscribers = self._endpoints("subscribers", wanted, node.get_subscriptions_info_by_topic)
        counts = count(wanted, names, publishers, subscribers)
        watched = {name for key, name in wanted if key == "lifecycle"}
        counts.update((("lifecycle", name), 0.0) for name in watched.difference(names))
        for name, state in self._states.read(watched.intersection(names)).items():
            counts["lifecycle", name] = state
        return counts

    def _endpoints(self, key: str, wanted: Collection[Wanted], infos: Callable[[str], Any]) -> Iterator[str]:
        """Yields the topic of each endpoint of another node."""
        topics = {name for its_key, name in wanted if its_key == key}
        if any(map(is_pattern, topics)):
            topics = matching(wanted, key, self.topic_types())
        for topic in topics:
            for info in infos(topic):
                if full_name(info.node_name, info.node_namespace) != self.name:
                    yield topic

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> ClockTimer:
        timer = super().create_timer(period_s, callback, steady=steady)
        self._set_wake()
        if self.node.executor is not None:
            self.node.executor.wake()  # it may be waiting for a later one
        return timer

    def _run_timers(self) -> None:
        self.run_steady_timers()
        self._set_wake()

    def _set_wake(self) -> None:
        with self._lock:
            if not self.closed:
                wait_s = self.next_steady_s() - self.steady_s()
                self._wake.timer_period_ns = 1e9 * min(max(0.0, wait_s), _LONGEST_WAIT_S)
                self._wake.reset()

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        cls = messages.service_class(type_name)

        def answer(request: Any, response: Any) -> Any:
            with self._lock:
                try:
                    return messages.to_native(cls.Response, handler(messages.to_mapping(request)))
                except Exception as error:
                    # ROS 2 has no failed calls. In std_srvs `success` is false by default; `message` gets the reason.
                    text = self.log_failure(error)
                    if hasattr(response, "message"):
                        response.message = text
                    return response

        self.node.create_service(cls, _native_name(service), answer)

    def log(self, severity: Severity, text: str) -> None:
        if self.node.context.ok():  # otherwise rcl would print that it cannot publish the line
            # Another object for each line, as one remembers the severity of each line of code that calls it.
            logger = get_logger(self.node.get_logger().name)
            self.faults.guard("log", logger.log, with_degree_sign(text), severity)

    def _leave(self) -> None:
        self._channels.clear()
        self._jumps.unregister()
        if self.node.executor is not None:
            self.node.executor.remove_node(self.node)
        self.node.destroy_node()

    def _on_time_jump(self, jump: TimeJump) -> None:
        self.set_sim_time(self._ros_clock.now().nanoseconds / 1e9)

    def _stamp(self) -> Any:
        return self._ros_clock.now().to_msg()

    def _qos_of(self, topic: str) -> list[QoSProfile]:
        """Returns the QoS of this node's subscriptions to a topic."""
        return [channel.native.qos_profile for channel in self._channels.values() if channel.key[0] == topic]

    def _resolve(self, name: str) -> str:
        try:
            resolved: str = self.node.resolve_topic_name(_native_name(name))
        except (RuntimeError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise ConfigError(f"expected the name of a topic, got {name!r}: {reason}") from None
        return resolved

    def _begin(self, subscription: Subscription, type_name: str) -> Subscription:
        with self._lock:
            type_name = type_name or self._type_of(subscription.topic)
            if type_name:
                self._start(subscription, type_name)
            self._subscriptions.append(subscription)
        return subscription

    def _start(self, subscription: Subscription, type_name: str) -> None:
        """Subscribes, sharing rclpy's subscription with others to the topic: its cost per message is high."""
        cls = messages.message_class(type_name)
        topic = subscription.topic
        key = topic, cls
        channel = self._channels.get(key) or _Channel(
            key, subscription.native_name, SerializedType(topic, messages.raw_format(type_name))
        )
        subscription.get = _reader(subscription, channel.messages)
        is_first = channel.native is None
        is_latched = subscription.is_latched or (subscription.is_raw and is_first and are_latched(self.node, topic))
        if is_first or is_latched > channel.is_latched:
            channel.is_latched = is_latched
            self._channels[key] = channel
            self._open(channel)
        others = channel.readers
        channel.readers = (subscription, *others) if subscription.is_raw else (*others, subscription)
        subscription.channel, subscription.active = channel, True

    def _end(self, subscription: Subscription) -> None:
        subscription.active = False
        channel = subscription.channel
        if channel is not None:
            subscription.channel = None
            channel.readers = tuple(reader for reader in channel.readers if reader is not subscription)
            if not channel.readers:
                del self._channels[channel.key]
                self.node.destroy_subscription(channel.native)

    def _open(self, channel: _Channel) -> None:
        """Creates rclpy's subscription, or creates it again: reliable, unless there is a best-effort publisher."""
        topic, cls = channel.key
        if channel.native is not None:
            self.node.destroy_subscription(channel.native)

        def deliver(data: bytes) -> None:
            with self._lock:
                for subscription in channel.readers:
                    self.deliver(subscription, data)

        channel.is_best_effort = has_best_effort(self.node, topic)
        reliability = ReliabilityPolicy.BEST_EFFORT if channel.is_best_effort else ReliabilityPolicy.RELIABLE
        depth = _STATIC_QUEUE_SIZE if channel.is_latched else _SUBSCRIBER_QUEUE_SIZE
        # rclpy's default event handlers only log, and the executor checks each of them for every message.
        channel.native = self.node.create_subscription(
            cls,
            channel.native_name,
            deliver,
            QoSProfile(depth=depth, reliability=reliability, durability=_DURABILITY[channel.is_latched]),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )

    def _type_of(self, topic: str) -> str:
        """Returns the type of a topic, empty if it is unknown."""
        return self.topic_types().get(topic, "")

    def _new_type_of(self, subscription: Subscription) -> str:
        """Returns the type with which to subscribe now; empty if that need not change.

        Its type was not known yet, or no publisher is heard because all have another type.
        """
        topic, channel = subscription.topic, subscription.channel
        if channel is None:
            return self._type_of(topic) if subscription.active else ""
        if not subscription.follows_type or channel.native.get_publisher_count():
            return ""
        types = {canonical_type(publisher.topic_type) for publisher in self.node.get_publishers_info_by_topic(topic)}
        return "" if messages.type_name(channel.key[1]) in types else min(types, default="")

    def _check_publishers(self, now_s: float) -> None:
        """Starts subscriptions whose type is known by now; makes those best effort or volatile that must be.

        A best-effort subscription receives from both kinds of publishers, but loses messages on a bad network. So a
        subscription is reliable until a best-effort publisher (sensor-data QoS) appears. DDS has an event for that, but
        each event handler costs time for every message of the node. Likewise, a subscription that receives what was
        published before it began does not hear volatile publishers.
        """
        for subscription in self._subscriptions:
            type_name = self._new_type_of(subscription)
            if type_name:
                self._end(subscription)
                try:
                    self._start(subscription, type_name)
                except ConfigError as error:
                    self.failures.write(subscription.topic, Severity.ERROR, str(error))
        numbers = {topic: self.node.count_publishers(topic) for topic, _ in self._channels}
        self._lookup.remember(numbers)
        for channel in tuple(self._channels.values()):
            topic, _ = channel.key
            if numbers[topic] <= channel.native.get_publisher_count():
                continue
            insists = not channel.is_latched or any(reader.is_latched for reader in channel.readers)
            becomes_volatile = not insists and not are_latched(self.node, topic)
            if becomes_volatile or (not channel.is_best_effort and has_best_effort(self.node, topic)):
                channel.is_latched = channel.is_latched and not becomes_volatile
                self._open(channel)


@dataclass(eq=False)
class Subscription:
    """A subscription of the port; several may share one subscription of rclpy."""

    topic: str
    native_name: str
    callback: Callback
    field: str | None
    is_latched: bool = False
    is_raw: bool = False
    """Whether the value is the whole message as bytes, with its format."""
    follows_type: bool = False
    """Whether it takes messages of any type, that of a publisher which restarts with another one, too."""
    get: Getter = float
    """Reads the value from the bytes of a message."""
    active: bool = True
    """False once it has ended, or if the type of the topic cannot be used."""
    channel: _Channel | None = None
    """None as long as the type of the topic is not known."""


@dataclass(eq=False)
class _Channel:
    """A subscription of rclpy, replaced when the QoS changes, and its readers."""

    key: tuple[str, Any]
    """Topic and class of its messages, which arrive as bytes."""
    native_name: str
    messages: SerializedType
    """Their type, which deserializes a message at most once for all readers."""
    native: Any = None
    is_latched: bool = False
    """Whether it receives latched messages: a reader insists, or all publishers were latched when it began."""
    is_best_effort: bool = False
    readers: tuple[Subscription, ...] = ()


def _reader(subscription: Subscription, messages: SerializedType) -> Getter:
    """Returns what reads the value of a subscription from the bytes of a message; raises ConfigError."""
    if subscription.is_raw:
        raw = messages.raw_format
        return lambda data: (data, raw)
    return (lambda data: 1.0) if subscription.field is None else messages.field_getter(subscription.field)


def _native_name(name: str) -> str:
    """Returns the name in ROS 2's syntax: `~/reset` for `~reset`."""
    return f"~/{name[1:].lstrip('/')}" if name.startswith("~") else name


def _names(names_and_types: Any) -> list[str]:
    return [name for name, _ in names_and_types]
