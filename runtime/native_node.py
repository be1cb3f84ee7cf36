"""What the adapters over rospy and rclpy share: a node whose messages are objects of generated classes.

`core/port/mapping_node.py` has what the other adapters share, whose messages are mappings.
"""

from __future__ import annotations

import abc
import time
from typing import Any, Callable, Collection

from ..core.messages import RawFormat
from ..core.port import NOTHING_CHANGED, Answer, ClockedNode, Counts, GraphCallback, Severity, Unread, Wanted
from ..core.values import ABSENT, ConfigError, JsonObject, Message, MessageError, ServiceError, printable
from .threads import StepThread

Log = Callable[[Severity, str], None]


class NativeNode(ClockedNode):
    """One node; the base of classes that implement `core.port.Middleware`."""

    parameters: Any
    """Those of the node, with the method `given`."""
    _lookup: Any
    """Looks up why a topic brings no samples, with the method `look_up`."""
    graph_period_s = 1.0
    """Time between two readings of the graph, in s."""

    def __init__(self, name: str, messages: Any, sim_time_s: float | None) -> None:
        """Connects nothing; `messages` is the module of that name of the adapter, `sim_time_s` is of `ClockedNode`."""
        super().__init__(name, clock=time.monotonic, wall_clock=time.time, sim_time_s=sim_time_s)
        self._messages = messages
        self._publishers: dict[str, tuple[Any, Any]] = {}
        """Publisher and class of its messages, by resolved topic."""
        self._subscriptions: list[Any] = []
        self._graph: StepThread | None = None

    @abc.abstractmethod
    def _resolve(self, name: str) -> str:
        """Returns the absolute name."""

    @abc.abstractmethod
    def _end(self, subscription: Any) -> None:
        """Ends a subscription."""

    @abc.abstractmethod
    def _stamp(self) -> Any:
        """Returns the present ROS time as messages have it."""

    @abc.abstractmethod
    def _count(self, wanted: Collection[Wanted]) -> Counts:
        """Returns what is wanted of the graph; called in a thread. Raises ServiceError if it cannot be read."""

    @abc.abstractmethod
    def _leave(self) -> None:
        """Leaves the middleware, as a part of `close`: nothing calls back any more."""

    def given_parameters(self) -> JsonObject:
        given: JsonObject = self.parameters.given()
        return given

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> StepThread:
        def read() -> float:
            if timer.active and not self.waiting_for_clock():
                counts: Counts | Unread
                try:
                    counts = self._count(wanted())
                except ServiceError as error:
                    counts = Unread(str(error))
                with self._lock:
                    if timer.active:
                        self.call(callback, counts, self.now_s())
            return self.graph_period_s

        timer = self._graph = StepThread("graph", read, self.log_failure)
        timer.start()
        return timer

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        self._lookup.look_up(topic, type_name, answer)

    def raw_format(self, type_name: str) -> RawFormat:
        raw: RawFormat = self._messages.raw_format(type_name)
        return raw

    def serialize(self, type_name: str, message: Message) -> tuple[bytes, RawFormat]:
        native = self._stamped(self._messages.message_class(type_name), message)
        return self._messages.serialized(native), self.raw_format(type_name)

    def publish(self, topic: str, message: Message) -> None:
        publisher, cls = self._advertised(topic)
        publisher.publish(self._stamped(cls, message))

    def deliver(self, subscription: Any, message: Any) -> None:
        """Passes on what a subscription reads of a message."""
        with self._lock:
            if subscription.active:
                try:
                    value = subscription.get(message)
                except Exception as error:
                    text = f"{subscription.topic}: a message does not match its type: {error}"
                    self.failures.write(subscription.topic, Severity.ERROR, printable(text))
                    value = ABSENT  # a message that cannot be read is a sign of life
                self.call_back(subscription, value)

    def unsubscribe(self, subscription: Any) -> None:
        with self._lock:
            if subscription in self._subscriptions:
                self._subscriptions.remove(subscription)
                self._end(subscription)

    def close(self) -> None:
        with self._lock:
            if self.closed:
                return
            self.closed = True
            self.cancel_timers()
            if self._graph is not None:
                self._graph.cancel()
            for subscription in self._subscriptions:
                subscription.active = False
            self._leave()
            self._subscriptions.clear()
            self._publishers.clear()

    def _stamped(self, cls: Any, message: Message) -> Any:
        """Returns a native message, stamped if it has no stamp."""
        native = self._messages.to_native(cls, message)
        if self._messages.native.is_stamped(cls) and "stamp" not in message.get("header", {}):
            native.header.stamp = self._stamp()
        return native

    def _advertised(self, topic: str) -> tuple[Any, Any]:
        """Returns the publisher of a topic and its class."""
        resolved = self._resolve(topic)
        if resolved not in self._publishers:
            raise MessageError(f"{self.name} has not advertised {resolved}")
        return self._publishers[resolved]


def apply_change(apply: Callable[[], str], log: Log) -> tuple[bool, str]:
    """Applies new parameters and logs the outcome; returns whether they are accepted, and what changed or why not."""
    try:
        changes = apply()
    except (ConfigError, ServiceError) as error:
        log(Severity.WARN, f"the old parameters stay in force: {error}")
        return False, str(error)
    if changes != NOTHING_CHANGED:
        log(Severity.INFO, f"parameters changed: {changes}")
    return True, changes
