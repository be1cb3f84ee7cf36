"""The port over rospy: translates, and holds the lock. Health is judged in `core`.

A process has one ROS node but may hold several `Ros1Middleware`s, each a logical node with its own private names and
parameters: `/alert_system/reset` exists whether or not the three nodes are composed.

Nothing here calls the ROS master while it holds the lock, except to subscribe or unsubscribe when the configuration
changes: a master that hangs must not delay an alert.
"""

from __future__ import annotations

import contextlib
import logging
import socket
import threading
import time
from functools import lru_cache, partial
from typing import Any, Callable, Collection, Iterator, Mapping, Sequence

import genpy
import rosgraph.network
import rospy
import rospy.core
import rospy.rostime
import rospy.topics
from rosgraph_msgs.msg import Clock

from ..core.config import Parameter
from ..core.messages import RawFormat, SerializedType
from ..core.port import (
    NOT_COUNTED,
    Answer,
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
    explain,
    is_pattern,
    matching,
    similar_topic,
)
from ..core.values import (
    ABSENT,
    ConfigError,
    Getter,
    JsonObject,
    Message,
    MessageError,
    ServiceError,
    resolve_name,
    split_type_name,
    with_degree_sign,
)
from ..runtime.native_node import NativeNode
from ..runtime.threads import StepThread
from . import messages
from .master import Master, NodeChecks
from .parameters import NodeParameters, set_log_level
from .serialized import message_reader
from .services import call_in_time

_LOGGER = logging.getLogger("rosout")
"""That of rospy, whose severities are those of Python."""
_QUEUE_SIZE = 1000
"""Messages that may wait to be sent to a subscriber, then the oldest are lost. Incoming ones wait at their sender."""


_MOST_TYPES = 1000
"""Topics whose types are kept: the clients of a server may subscribe to any number of invented ones."""


class Ros1Middleware(NativeNode):
    """One logical node of this process; implements `core.port.middleware.ServedMiddleware`.

    Call `rospy.init_node` first.
    """

    graph_period_s = 2.0

    def __init__(self, name: str = "") -> None:
        """Creates the node.

        Args:
            name: name of the logical node, below the process's namespace unless it begins with `/`; if empty, that
                of the process, which `__name:=` may have changed.
        """
        self._master = Master(rospy.get_name())
        self._node_checks = NodeChecks(self._master)
        super().__init__(
            resolve_name(name or rospy.get_name(), rospy.get_name()),
            messages,
            None if rospy.rostime.is_wallclock() else 0.0,
        )
        self._lookup = PublisherLookup(self._master, self._last_publishers)
        self._timers: StepThread | None = None
        self._clock_subscriber: Any = None
        if self._sim_time_s is not None:
            self._clock_subscriber = rospy.Subscriber(
                "/clock", Clock, lambda native: self.set_sim_time(native.clock.to_sec())
            )
            if self.waiting_for_clock():  # the latest message may have come before this subscription
                self.set_sim_time(rospy.get_time())
        self.parameters = NodeParameters(self._master, self.name)
        self._type_of = lru_cache(maxsize=_MOST_TYPES)(SerializedType)
        """All subscriptions to a topic share the type, which deserializes each message once."""
        self._services: list[Any] = []

    def declare_parameters(self, parameters: Sequence[Parameter], on_change: OnChange) -> None:
        """Advertises `~reload`, which reads the parameters again; its response is what changed.

        ROS 1 does not declare parameters. The defaults are not written to the parameter server, which outlives the
        node: the next one would take them for its configuration.
        """

        def apply(proposed: JsonObject) -> str:
            changes = self.answer(on_change, proposed)
            if self.name == rospy.get_name():  # the log level is one for the process
                set_log_level(proposed)
            return changes

        self.given_parameters()
        self._serve("~reload", "std_srvs/Trigger", lambda request: self.parameters.reload(apply, self.faults, self.log))

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> str:
        resolved = self._resolve(topic)
        if resolved not in self._publishers:
            cls = messages.message_class(type_name)
            shared = rospy.topics.get_topic_manager().get_publisher_impl(rospy.resolve_name(resolved))
            if shared is not None and shared.data_class is not cls:  # rospy does not check that
                other, own = shared.data_class._type, cls._type
                raise ConfigError(f"{resolved}: expected {other}, the type that this process publishes, got {own}")
            publisher = rospy.Publisher(resolved, cls, queue_size=_QUEUE_SIZE, tcp_nodelay=True, latch=latched)
            self._publishers[resolved] = publisher, cls
        return str(self._publishers[resolved][0].resolved_name)

    def has_listeners(self, topic: str) -> bool:
        publisher, _ = self._advertised(topic)
        return bool(publisher.get_num_connections())

    def subscribe(
        self, topic: str, type_name: str, callback: Callback, *, field: str | None = "", latched: bool = False
    ) -> Subscription:
        mapped = rospy.resolve_name(self._resolve(topic))
        if field is None:
            return self._subscribe(topic, "", lambda native: 1.0, callback)
        if type_name:
            self._type_of(mapped, messages.raw_format(type_name)).field_getter(field)  # raises

        def getter_of(raw: RawFormat) -> Getter:
            return self._type_of(mapped, raw).field_getter(field)

        read = message_reader(mapped, type_name, getter_of, partial(self.failures.write, mapped))
        return self._subscribe(topic, type_name, read, callback)

    def subscribe_raw(self, topic: str, type_name: str, callback: RawCallback) -> Subscription:
        if type_name and split_type_name(type_name) is None:
            raise ConfigError(f"expected a type such as std_msgs/Float32, got {type_name!r}")
        mapped = rospy.resolve_name(self._resolve(topic))
        log = partial(self.failures.write, mapped)
        read = message_reader(mapped, type_name, lambda raw: lambda data: (data, raw), log)

        def take(item: Any, now_s: float) -> None:
            if item is not ABSENT:
                callback(item, now_s)

        subscription = self._subscribe(topic, "", read, take)
        subscription.move_first()
        return subscription

    def _subscribe(self, topic: str, type_name: str, get: Getter, callback: Callback) -> Subscription:
        """Subscribes; `get` reads what is passed on."""
        subscription = Subscription(self._resolve(topic), type_name, get, callback, self.deliver)
        with self._lock:
            self._subscriptions.append(subscription)
        return subscription

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> ClockTimer:
        timer = super().create_timer(period_s, callback, steady=steady)
        with self._lock:
            if self._timers is None:
                self._timers = StepThread("timers", self._run_timers, self.log_failure)
                self._timers.start()
        self._timers.wake()
        return timer

    def _run_timers(self) -> float:
        self.run_steady_timers()
        return self.next_steady_s() - self.steady_s()

    def now_s(self) -> float:
        # Messages on /clock may wait for the lock, which rospy's own time does not.
        return self._clock() if self._sim_time_s is None else float(rospy.get_time())

    def topic_types(self) -> Mapping[str, str]:
        types = self._master.topic_types()
        return {topic: type_name for topic, type_name in types.items() if type_name != rospy.AnyMsg._type}

    def why_silent(self, topic: str, type_name: str) -> str | None:
        return self._hints.get(rospy.resolve_name(self._resolve(topic)), type_name)

    def graph_name(self, key: str, name: str) -> str:
        if key == "lifecycle":
            raise ConfigError("ROS 1 has no lifecycle nodes")
        resolved = self._resolve(name)
        return resolved if is_pattern(name) else str(rospy.resolve_name(resolved))

    def _count(self, wanted: Collection[Wanted]) -> Counts:
        publishers, subscribers, services = self._master.system_state()
        nodes = {node for kind in (publishers, subscribers, services) for _, users in kind for node in users}
        watched = matching(wanted, "node", nodes)
        for kind, endpoints in (("publishers", dict(publishers)), ("subscribers", dict(subscribers))):
            watched.update(node for topic in matching(wanted, kind, endpoints) for node in endpoints[topic])
        own = rospy.get_name()
        gone = self._node_checks.gone(watched - {own}) | {NOT_COUNTED}

        def others(endpoints: Sequence[tuple[str, list[str]]], own_topics: set[str]) -> Iterator[str]:
            for topic, users in endpoints:
                for user in users:
                    if user not in gone and not (user == own and topic in own_topics):
                        yield topic

        return count(
            wanted,
            nodes - gone,
            others(publishers, {publisher.resolved_name for publisher, _ in tuple(self._publishers.values())}),
            others(subscribers, {subscription.topic for subscription in tuple(self._subscriptions)}),
        )

    def graph(self) -> Graph:
        """See `ServedMiddleware.graph`; the master does not know the types of services."""
        state = self._master.system_state()
        nodes: dict[str, list[list[str]]] = {}
        for kind, entries in enumerate(state):
            for name, users in entries:
                for user in users:
                    nodes.setdefault(user, [[], [], []])[kind].append(name)
        return Graph(
            self.topic_types(),
            {service: "" for service, _ in state[2]},
            {name: NodeInfo(*lists) for name, lists in nodes.items()},
        )

    def call_service(self, service: str, type_name: str, request: Message, timeout_s: float) -> Message:
        """See `ServedMiddleware.call_service`."""
        resolved = rospy.resolve_name(self._resolve(service))
        deadline_s = time.monotonic() + timeout_s
        try:
            address = self._master.find_service(resolved)
            if address is None:
                raise ServiceError("no such service")
            return call_in_time(resolved, address, type_name, request, deadline_s)
        except MessageError as error:
            raise MessageError(f"{resolved}: {error}") from None
        except (ServiceError, ConfigError) as error:
            raise ServiceError(f"{resolved}: {error}") from None
        except (TimeoutError, socket.timeout):  # one class from Python 3.10 on
            raise ServiceError(f"{resolved}: no response within {timeout_s:g} s") from None
        except (OSError, ValueError, genpy.MessageException, rosgraph.network.ROSHandshakeException) as error:
            raise ServiceError(f"{resolved}: the call failed: {error}") from None

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        self._serve(service, type_name, partial(self.answer, handler))

    def log(self, severity: Severity, text: str) -> None:
        stream = "stdout" if severity < Severity.WARN else "stderr"
        self.faults.guard(f"log on {stream}", _LOGGER.log, severity, with_degree_sign(text))

    def _leave(self) -> None:
        if self._timers is not None:
            self._timers.close()
        # A process that shuts down unregisters everything with one call. A call per topic would take long, and fail
        # with a warning each if the master is down.
        if not rospy.core.is_shutdown_requested():
            for subscription in self._subscriptions:
                subscription.end()
            if self._clock_subscriber is not None:
                _unregister(self._clock_subscriber)
            for publisher, _ in self._publishers.values():
                _unregister(publisher)
            for service in self._services:
                service.shutdown("node closed")

    def _serve(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        """Advertises a service whose handler is called without the lock, and logs what it raises itself."""
        cls = messages.service_class(type_name)

        def answer(request: Any) -> Any:
            try:
                return messages.to_native(cls._response_class, handler(messages.to_mapping(request)))
            except Exception as error:
                reason = str(error) if isinstance(error, ServiceError) else self.log_failure(error)
                raise rospy.ServiceException(reason) from error

        self._services.append(rospy.Service(self._resolve(service), cls, answer))

    def _end(self, subscription: Subscription) -> None:
        subscription.end()

    def _stamp(self) -> Any:
        return rospy.Time.now()

    def _last_publishers(self, topic: str) -> set[str]:
        """Returns the nodes whose messages on a topic came last. May be called in any thread."""
        headers = [each.header for each in tuple(self._subscriptions) if each.topic == topic]
        return {str(header["callerid"]) for header in headers if "callerid" in header}

    def _resolve(self, name: str) -> str:
        """Returns the absolute name. It is not remapped: rospy remaps every name that it gets."""
        return resolve_name(name, self.name)


class Subscription:
    """A rospy subscriber. It may still call back when it has ended: `active` says whether to deliver."""

    def __init__(
        self, topic: str, type_name: str, get: Getter, callback: Callback, deliver: Callable[[Subscription, Any], None]
    ) -> None:
        """Subscribes; `deliver` receives this object and each message as bytes, in a thread of its publisher.

        All subscriptions of a process to a topic share one connection, and the class of the first subscription:
        messages of /clock have the class with which rospy itself reads them. `type_name` is for the master only.
        """
        self.active = True
        self.get, self.callback = get, callback
        self.header: Mapping[str, str] = {}
        """That of the connection which brought the latest message."""

        def receive(native: Any, subscription: Subscription) -> None:
            subscription.header = native._connection_header
            deliver(subscription, native)

        shared = rospy.topics.get_topic_manager().get_subscriber_impl(rospy.resolve_name(topic))
        cls = messages.bytes_class(type_name) if shared is None else shared.data_class
        self._subscriber = rospy.Subscriber(topic, cls, receive, self, tcp_nodelay=True)
        self.topic: str = self._subscriber.resolved_name

    def move_first(self) -> None:
        """Makes rospy call this one before the others: its time must not include that which an alert takes."""
        impl = self._subscriber.impl
        with impl.c_lock:
            impl.callbacks = sorted(impl.callbacks, key=lambda callback: callback[1] is not self)

    def end(self) -> None:
        """Unsubscribes."""
        self.active = False
        _unregister(self._subscriber)


def _unregister(topic: Any) -> None:
    """Unregisters a publisher or subscriber, and closes what rospy leaves open with the last one of a topic.

    The `Poller` of a topic refers to itself: its epoll descriptor would stay until the garbage collector finds it.
    """
    impl = topic.impl
    topic.unregister()
    if impl is not None and impl.closed:
        with impl.c_lock:  # it is held while a connection is added, which is refused from now on
            impl.connection_poll.poller.close()


class PublisherLookup:
    """Asks the master in a thread, which ends when it has answered: neither a callback nor a tick waits for it."""

    def __init__(self, master: Master, last_publishers: Callable[[str], Collection[str]]) -> None:
        """Asks nothing yet.

        `last_publishers` returns the nodes whose messages on a topic came last; it is called in the thread.
        """
        self._master = master
        self._last_publishers = last_publishers
        self._lock = threading.Lock()
        self._questions: list[tuple[str, str, Answer]] = []
        """Those that no thread has taken yet; the first one starts a thread."""

    def look_up(self, topic: str, type_name: str, answer: Answer) -> None:
        """Answers later: why a topic brings no samples; None if nothing is known. See `core.hints.Hints`."""
        with self._lock:
            self._questions.append((topic, type_name, answer))
            if len(self._questions) == 1:
                threading.Thread(target=self._ask, name="publisher lookup", daemon=True).start()

    def _ask(self) -> None:
        published: dict[str, str] | None = None
        with contextlib.suppress(ServiceError):
            publishers, _, _ = self._master.system_state()
            types = self._master.topic_types()
            published = {topic: types.get(topic, "") for topic, nodes in publishers if nodes}
        with self._lock:
            questions, self._questions = self._questions, []
        for topic, type_name, answer in questions:
            text: str | None = None
            if published is not None:
                with contextlib.suppress(ServiceError):
                    gone = [node for node in self._last_publishers(topic) if self._master.answers(node) is False]
                    actual = [published[topic]] if topic in published and not gone else []
                    text = explain(topic, type_name, actual, gone, similar_topic(topic, type_name, published))
            answer(text)
