"""The port over a WebSocket: nodes for a robot that is reached through its rosbridge server. Needs no ROS here."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import math
import ssl
import time
from typing import Any, Callable, Coroutine, List, Mapping, Optional, TypeVar

from robot_health_monitor.core.errors import ConfigError, LinkError, ServiceError
from robot_health_monitor.core.hints import Answer
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.mapping_node import CLOCK, CLOCK_TYPE, MappingNode
from robot_health_monitor.core.middleware import (
    Callback,
    Message,
    Middleware,
    RawCallback,
    RawFormat,
    Severity,
    split_type_name,
)
from robot_health_monitor.core.standard_messages import check_type, complete
from robot_health_monitor.core.timers import ClockTimer

from ..protocol import DEFAULT_LIMITS, Limits
from ..protocol.operations import Publish
from .cause import Cause
from .connection import LARGEST_MESSAGE_BYTES, ServerConnection
from .receivers import CaptureReceiver, ClockReceiver, FieldReceiver, Receiver
from .services import Call, PublisherLookup, find_types

_LOG_NAME = "rosbridge"
_WAKE_PERIOD_S = 0.02
"""Timers are called up to this late."""
_ANSWER_TIMEOUT_S = 30.0

T = TypeVar("T")


class RosbridgeClient:
    """The connection to one robot's rosbridge server, shared by the nodes that `node` makes."""

    def __init__(
        self,
        url: str,
        *,
        token: str = "",
        ssl_context: Optional[ssl.SSLContext] = None,
        heartbeat_s: float = 5.0,
        probation_s: float = 0.5,
        limits: Limits = DEFAULT_LIMITS,
        largest_message_bytes: int = LARGEST_MESSAGE_BYTES,
        read_only: bool = False,
        clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
        on_log: Optional[Callable[[LogLine], None]] = None,
        on_link: Optional[Callable[[bool, Cause], None]] = None,
    ) -> None:
        """Creates a client that is not connected; `run` connects.

        Args:
            url: `ws://host:port` or `wss://host:port`.
            token: presented to the server; empty: none.
            ssl_context: for `wss://`; None trusts the system's certificate authorities.
            heartbeat_s: period of pings in s; the connection is down when one is not answered within half of it.
            probation_s: how long a new connection must last before it is reported as up, in s: a server that accepts
                connections only to close them is not up.
            limits: bounds for messages that are decoded. Of larger ones only the arrival counts.
            largest_message_bytes: a message above this size ends the connection.
            read_only: nothing is published or offered on the robot.
            clock: monotonic seconds, for nodes without simulated time.
            wall_clock: seconds since 1970, for the ages of stamps.
            on_log: called with every log line; None keeps them in `log_lines`.
            on_link: called in the loop when the connection is up (with an empty cause), when it is down, and when the
                cause changes. None logs each.

        Raises:
            ConfigError: `url` is not the address of a WebSocket server.
        """
        self.log_lines: List[LogLine] = []
        self.on_log: Callable[[LogLine], None] = on_log or self.log_lines.append
        self.read_only = read_only
        self.clock = clock
        self.wall_clock = wall_clock
        self.connection = ServerConnection(
            url,
            token=token,
            ssl_context=ssl_context,
            heartbeat_s=heartbeat_s,
            probation_s=probation_s,
            limits=limits,
            largest_message_bytes=largest_message_bytes,
            on_change=on_link or self._log_link,
            on_log=self.log,
            clock=clock,
        )
        self.publishers = PublisherLookup(self.connection.calls.call)
        self.loop: Optional[asyncio.AbstractEventLoop] = None
        self._nodes: List[RosbridgeMiddleware] = []

    def node(
        self,
        name: str,
        *,
        namespace: str = "",
        parameters: Optional[Mapping[str, Any]] = None,
        remap: Optional[Mapping[str, str]] = None,
        use_sim_time: bool = False,
        outputs: Optional[Middleware] = None,
    ) -> RosbridgeMiddleware:
        """Adds a node with a base `name` in a `namespace` (`robot1`, `/fleet/robot1` or empty).

        `parameters` are nested as in the file under `ros__parameters`. `remap` maps names as the node uses them
        (relative or absolute) to others. With `use_sim_time`, its time is that of the robot's topic `/clock`. `outputs`
        publishes and offers services in its place, and is not closed here; None: the robot's server receives them,
        unless `read_only`.
        """
        namespace = namespace.strip("/")
        full_name = f"/{namespace}/{name}" if namespace else f"/{name}"
        node = RosbridgeMiddleware(self, full_name, parameters or {}, remap or {}, use_sim_time, outputs)
        self._nodes.append(node)
        return node

    async def run(self) -> None:
        """Keeps the connection up and the timers going until it is cancelled."""
        self.loop = asyncio.get_event_loop()
        for node in tuple(self._nodes):
            node.arm()
        await self.connection.run()

    def close(self) -> None:
        """Closes every node, and makes `run` end."""
        for node in tuple(self._nodes):
            node.close()
        self.connection.close()

    def forget(self, node: RosbridgeMiddleware) -> None:
        """Removes a node that has closed."""
        if node in self._nodes:
            self._nodes.remove(node)

    def log(self, severity: Severity, text: str) -> None:
        """Logs a line about the connection."""
        self.on_log(LogLine(self.clock(), _LOG_NAME, severity, text))

    def run_in_loop(self, function: Callable[[], None]) -> None:
        """Calls a function in the loop soon; does nothing before `run` and after the loop has ended."""
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):
                self.loop.call_soon_threadsafe(function)

    def run_and_wait(self, ask: Callable[[Call], Coroutine[Any, Any, T]]) -> T:
        """Returns what a coroutine function finds out by calling the server's services. Called in another thread.

        Raises ServiceError: there is no answer, no connection, or no loop.
        """
        if self.loop is None:
            raise ServiceError(f"no connection to {self.connection.address}")
        asking = ask(self.connection.calls.call)
        try:
            return asyncio.run_coroutine_threadsafe(asking, self.loop).result(_ANSWER_TIMEOUT_S)
        except LinkError as error:
            raise ServiceError(str(error)) from None
        except (concurrent.futures.TimeoutError, concurrent.futures.CancelledError, RuntimeError):
            raise ServiceError(f"{self.connection.address} does not answer") from None

    def _log_link(self, up: bool, cause: Cause) -> None:
        if up:
            self.log(Severity.INFO, f"connected to {self.connection.address}")
        else:
            self.log(Severity.WARN, f"no connection to {self.connection.address}: {cause.text}")


class RosbridgeMiddleware(MappingNode):
    """One node for a robot behind rosbridge; implements `core.middleware.Middleware`."""

    def __init__(
        self,
        client: RosbridgeClient,
        name: str,
        parameters: Mapping[str, Any],
        remap: Mapping[str, str],
        use_sim_time: bool,
        outputs: Optional[Middleware] = None,
    ) -> None:
        """Use `RosbridgeClient.node`."""
        clocks = {"clock": client.clock, "wall_clock": client.wall_clock}
        super().__init__(name, parameters, remap, **clocks, use_sim_time=use_sim_time)
        self._client = client
        self._connection = client.connection
        self._outputs = outputs
        self._services: List[str] = []
        self._subscriptions: List[Receiver] = []
        self._wake: Optional[asyncio.TimerHandle] = None
        self._on_first_clock: List[Callable[[], None]] = []
        self._clock_receiver = ClockReceiver(self)
        if use_sim_time:
            self._connection.subscriptions.add(CLOCK, CLOCK_TYPE, self._clock_receiver)

    @property
    def limits(self) -> Limits:
        """Bounds for messages that are decoded."""
        return self._connection.limits

    @property
    def dropped(self) -> int:
        """Messages of current subscriptions that were too large to be read."""
        return sum(receiver.dropped for receiver in tuple(self._subscriptions))

    def advertise(self, topic: str, type_name: str, *, latched: bool = False) -> str:
        if self._outputs is not None:
            return self._outputs.advertise(topic, type_name, latched=latched)
        resolved = self.resolve(topic)
        check_type(type_name)
        with self._lock:
            if resolved not in self._advertised:
                self._advertised[resolved] = type_name
                if not self._client.read_only:
                    self._connection.advertise(resolved, type_name)
        return resolved

    def publish(self, topic: str, message: Message) -> None:
        if self._outputs is not None:
            self._outputs.publish(topic, message)
            return
        resolved = self.require_advertised(topic)
        complete(self._advertised[resolved], message)  # raises MessageError
        if not self._client.read_only:
            self._connection.send(Publish(resolved, message))

    def has_listeners(self, topic: str) -> bool:
        if self._outputs is not None:
            return self._outputs.has_listeners(topic)
        self.require_advertised(topic)
        return not self._client.read_only

    def subscribe(
        self, topic: str, type_name: str, callback: Callback, *, field: Optional[str] = "", latched: bool = False
    ) -> FieldReceiver:
        subscription = FieldReceiver(self, self.limits.message_bytes, self.resolve(topic), type_name, field, callback)
        with self._lock:
            self._subscriptions.append(subscription)
            self._connection.subscriptions.add(subscription.topic, type_name, subscription)
        return subscription

    def subscribe_raw(self, topic: str, type_name: str, callback: RawCallback) -> CaptureReceiver:
        subscription = CaptureReceiver(self, self.limits.message_bytes, self.resolve(topic), type_name, callback)
        with self._lock:
            self._subscriptions.append(subscription)
            self._connection.subscriptions.add(subscription.topic, type_name, subscription)
        return subscription

    def raw_format_of(self, topic: str, type_name: str) -> Optional[RawFormat]:
        return self._connection.subscriptions.formats.get(topic)

    def topic_types(self) -> Mapping[str, str]:
        return self._client.run_and_wait(find_types)

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        own = {*self._advertised, *(subscription.topic for subscription in tuple(self._subscriptions))}
        self._client.run_in_loop(lambda: self._client.publishers.look_up(topic, type_name, own, answer))

    def unsubscribe(self, subscription: Any) -> None:
        with self._lock:
            if subscription in self._subscriptions:
                subscription.end()
                self._subscriptions.remove(subscription)
                self._connection.subscriptions.remove(subscription.topic, subscription)

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        if self._outputs is not None:
            self._outputs.advertise_service(service, type_name, lambda request: self.answer(handler, request))
            return
        if split_type_name(type_name) is None:
            raise ConfigError(f"expected a type such as std_srvs/Trigger, got {type_name!r}")
        resolved = self.resolve(service)
        with self._lock:
            self._services.append(resolved)
            if not self._client.read_only:
                self._connection.offer(resolved, type_name, lambda request: self.answer(handler, request))

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> ClockTimer:
        timer = super().create_timer(period_s, callback, steady=steady)
        self._client.run_in_loop(self.arm)
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
            self._waiting.clear()
            self._on_first_clock.clear()
            for subscription in tuple(self._subscriptions):
                self.unsubscribe(subscription)
            for topic in self._advertised:
                self._connection.unadvertise(topic)
            for service in self._services:
                self._connection.withdraw(service)
            if self._sim_time_s is not None:
                self._connection.subscriptions.remove(CLOCK, self._clock_receiver)
        self._client.forget(self)

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
        if self._client.loop is None:
            return
        if self._wake is not None:
            self._wake.cancel()
            self._wake = None
        next_s = self.next_steady_s()
        if next_s is not None:
            loop = self._client.loop
            due_s = loop.time() + max(0.0, next_s - self.steady_s())
            # The nodes of many robots wake the process together.
            self._wake = loop.call_at(math.ceil(due_s / _WAKE_PERIOD_S) * _WAKE_PERIOD_S, self._on_wake)

    def _on_wake(self) -> None:
        self._wake = None
        self.run_steady_timers()
        self.arm()
