"""The port over a bridge: nodes for a robot that is reached over a WebSocket. Needs no ROS here.

A subclass adds what its protocol has: where subscriptions are sent, and what the server knows of silent topics.
"""

from __future__ import annotations

import abc
import asyncio
import math
import time
from functools import partial
from typing import (
    Any,
    Callable,
    ClassVar,
    Collection,
    Generic,
    Mapping,
    NamedTuple,
    TypeVar,
)

from ...core.port import (
    CLOCK,
    CLOCK_TYPE,
    Callback,
    ClockTimer,
    LocalBus,
    LogLine,
    MappingNode,
    Middleware,
    NodeInfo,
    RawCallback,
    Severity,
)
from ...core.values import Clock, JsonObject, Message, full_name
from .cause import Cause
from .connection import BridgeConnection
from .receivers import BridgeReceiver

_WAKE_PERIOD_S = 0.02
"""Timers are called up to this late."""

Node = TypeVar("Node", bound="BridgeNode")


class KnownTopic(NamedTuple):
    """One topic of the robot."""

    topic: str
    type_name: str
    """`package/Type`; empty where the server does not know it."""
    definition: str = ""
    """The definition of the type with those that it contains, as from `gendeps --cat`; empty if the server has none."""
    form: str = "msg"
    """The format of the definition, whose name ends with `msg` or `idl`."""


class BridgeClient(abc.ABC, Generic[Node]):
    """The connection to one robot's server, shared by the nodes that `node` makes."""

    connection: BridgeConnection
    connection_class: ClassVar[type[BridgeConnection]]
    node_class: type[Node]
    log_name: ClassVar[str]
    """Node of log lines about the connection."""

    def __init__(
        self,
        url: str,
        *,
        clock: Clock = time.monotonic,
        on_log: Callable[[LogLine], None],
        on_link: Callable[[bool, Cause], None],
        **options: Any,
    ) -> None:
        """Creates a client that is not connected; `run` connects.

        Args:
            url: address of the server.
            clock: monotonic seconds, for nodes without simulated time.
            on_log: called with every log line.
            on_link: called in the loop when the connection is up (with an empty cause), when it is down, and when the
                cause changes.
            options: those of the connection, which are described at `BridgeConnection` and its subclass.

        Raises:
            ConfigError: `url` is not the address of such a server.
        """
        self.on_log = on_log
        self.clock = clock
        self._nodes: list[Node] = []
        self.connection = self.connection_class(url, on_change=on_link, on_log=self.log, clock=clock, **options)

    @abc.abstractmethod
    async def known_topics(self) -> list[KnownTopic]:
        """Returns the topics that the server knows. Raises ServiceError if it does not say, LinkError if it is down."""

    async def known_nodes(self, topics: Collection[str]) -> Mapping[str, NodeInfo]:
        """Returns the nodes that the server knows, with those of these topics that they publish.

        Raises as `known_topics`.
        """
        return {}

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: JsonObject | None = None,
        remap: Mapping[str, str] | None = None,
        use_sim_time: bool = False,
        outputs: Middleware | None = None,
    ) -> Node:
        """Adds a node with a base `name` in a `namespace` (`robot1`, `/fleet/robot1` or empty).

        `parameters` are nested as in the file under `ros__parameters`. `remap` maps names as the node uses them
        (relative or absolute) to others. With `use_sim_time`, its time is that of the robot's topic `/clock`. `outputs`
        publishes and offers services in its place, since the robot is only read, and is not closed here; if it is
        None, they reach nothing.
        """
        outputs = outputs or LocalBus().node(name, namespace=namespace, remap=remap)
        node = self.node_class(self, full_name(name, namespace), parameters or {}, remap or {}, use_sim_time, outputs)
        self._nodes.append(node)
        return node

    async def run(self) -> None:
        """Keeps the connection up and the timers going until it is cancelled."""
        self.connection.enter_loop()
        for node in self._nodes:
            node.arm()
        await self.connection.run()

    def close(self) -> None:
        """Closes every node, and makes `run` end."""
        for node in self._nodes:
            node.close()
        self.connection.close()

    def log(self, severity: Severity, text: str) -> None:
        """Logs a line about the connection."""
        self.on_log(LogLine(self.clock(), self.log_name, severity, text))


class BridgeNode(MappingNode):
    """One node for a robot behind a bridge; implements `core.port.middleware.Middleware`."""

    def __init__(
        self,
        client: BridgeClient[Any],
        name: str,
        parameters: JsonObject,
        remap: Mapping[str, str],
        use_sim_time: bool,
        outputs: Middleware,
    ) -> None:
        """Use `BridgeClient.node`."""
        super().__init__(name, parameters, remap, clock=client.clock, wall_clock=time.time, use_sim_time=use_sim_time)
        self._client = client
        self._outputs = outputs
        self._receivers = client.connection.receivers
        self._subscriptions: list[BridgeReceiver] = []
        self._wake: asyncio.TimerHandle | None = None
        self._on_first_clock: list[Callable[[], None]] = []
        if use_sim_time:
            self._clock_subscription = self._receiver(CLOCK, CLOCK_TYPE, "", self.take_clock)
            self._receivers.add(self._clock_subscription)

    @abc.abstractmethod
    def _receiver(
        self, topic: str, type_name: str, field: str | None, callback: Callback, *, is_raw: bool = False
    ) -> Any:
        """Returns what receives the messages of a resolved topic; `is_raw`: as bytes."""

    @property
    def dropped(self) -> int:
        """Messages of current subscriptions that were too large to be read."""
        return sum(receiver.dropped for receiver in tuple(self._subscriptions))

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> str:
        return self._outputs.advertise(topic, type_name, latched=latched)

    def publish(self, topic: str, message: Message) -> None:
        self._outputs.publish(topic, message)

    def has_listeners(self, topic: str) -> bool:
        return self._outputs.has_listeners(topic)

    def subscribe(
        self, topic: str, type_name: str, callback: Callback, *, field: str | None = "", latched: bool = False
    ) -> Any:
        return self._begin(self._receiver(self.resolve(topic), type_name, field, callback))

    def subscribe_raw(self, topic: str, type_name: str, callback: RawCallback) -> Any:
        return self._begin(self._receiver(self.resolve(topic), type_name, None, callback, is_raw=True))

    def _begin(self, receiver: Any) -> Any:
        with self._lock:
            self._subscriptions.append(receiver)
            self._receivers.add(receiver)
        return receiver

    def unsubscribe(self, subscription: Any) -> None:
        with self._lock:
            if subscription in self._subscriptions:
                subscription.end()
                self._subscriptions.remove(subscription)
                self._receivers.remove(subscription)

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        self._outputs.advertise_service(service, type_name, partial(self.answer, handler))

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> ClockTimer:
        timer = super().create_timer(period_s, callback, steady=steady)
        self._client.connection.run_in_loop(self.arm)
        return timer

    def log(self, severity: Severity, text: str) -> None:
        line = LogLine(self.steady_s(), self.name, severity, text)
        self.faults.guard("log", self._client.on_log, line)

    def close(self) -> None:
        with self._lock:
            if self.closed:
                return
            self.closed = True
            self.cancel_timers()
            for subscription in tuple(self._subscriptions):
                self.unsubscribe(subscription)
            if self._clock_subscription is not None:
                self._receivers.remove(self._clock_subscription)

    def set_sim_time(self, now_s: float) -> None:
        """See `MappingNode.set_sim_time`; also makes the calls that waited in `call_with_time`."""
        with self._lock:
            super().set_sim_time(now_s)
            if self._on_first_clock and not self.waiting_for_clock():
                callbacks, self._on_first_clock = self._on_first_clock, []
                for callback in callbacks:
                    self.call(callback)

    def call_with_time(self, callback: Callable[[], None]) -> None:
        """Calls back at once; under `use_sim_time` not before the first message on /clock."""
        with self._lock:
            if self.waiting_for_clock():
                self._on_first_clock.append(callback)
            else:
                self.call(callback)

    def arm(self) -> None:
        """Schedules the next check of the timers. Called in the loop."""
        loop = self._client.connection.loop
        if loop is None:
            return
        if self._wake is not None:
            self._wake.cancel()
            self._wake = None
        next_s = self.next_steady_s()
        if next_s < math.inf:
            due_s = loop.time() + max(0.0, next_s - self.steady_s())
            # The nodes of many robots wake the process together.
            self._wake = loop.call_at(math.ceil(due_s / _WAKE_PERIOD_S) * _WAKE_PERIOD_S, self._on_wake)

    def _on_wake(self) -> None:
        self._wake = None
        self.run_steady_timers()
        self.arm()
