"""The port over a WebSocket: nodes on a robot that only its rosbridge server can reach; no ROS installed here."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import threading
import time
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.field_path import ABSENT, mapping_getter
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Message, Severity, resolve_name, split_type_name
from robot_health_monitor.core.parameters import Parameter, flatten, unflatten
from robot_health_monitor.core.timers import ClockTimer, ClockTimers

from ..protocol.definitions import check_message
from .connection import Link

CLOCK = "/clock"
CLOCK_TYPE = "rosgraph_msgs/Clock"


class RosbridgeClient:
    """A robot, seen through its rosbridge server; nodes are made with `node`."""

    def __init__(
        self,
        url: str,
        *,
        token: str = "",
        ssl_context: Optional[ssl.SSLContext] = None,
        heartbeat_s: float = 5.0,
        read_only: bool = False,
        clock: Callable[[], float] = time.monotonic,
        on_log: Optional[Callable[[LogLine], None]] = None,
        on_link: Optional[Callable[[bool], None]] = None,
    ) -> None:
        """Makes a client that is not connected; `run` connects it.

        Args:
            url: `ws://host:port` or `wss://host:port`.
            token: shown to the server; empty: none.
            ssl_context: for `wss://`; None trusts the system's certificate authorities.
            heartbeat_s: period of pings in s.
            read_only: what the nodes publish and offer stays here: a robot that is only watched is not disturbed.
            clock: seconds that never go back, for nodes without simulated time.
            on_log: called with every log line; None keeps them in `log_lines`.
            on_link: called in the loop with True when the link is up and with False when it is down.
        """
        self.url = url
        self.log_lines: List[LogLine] = []
        self.on_log: Callable[[LogLine], None] = on_log or self.log_lines.append
        self.on_link: Callable[[bool], None] = on_link or (lambda up: None)
        self.read_only = read_only
        self.clock = clock
        self.link = Link(
            url,
            token=token,
            ssl_context=ssl_context,
            heartbeat_s=heartbeat_s,
            on_change=self._note_link,
            on_problem=lambda text: self.on_log(LogLine(self.clock(), "rosbridge", Severity.WARN, text)),
        )
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
    ) -> RosbridgeMiddleware:
        """Adds a node.

        Args:
            name: base name, `alert_system`.
            namespace: `robot1`, `/fleet/robot1` or empty.
            parameters: its configuration, nested as in the file under `ros__parameters`.
            remap: names as the node uses them (relative or absolute) to the names to use instead.
            use_sim_time: its time is that of the robot's topic `/clock`.
        """
        namespace = namespace.strip("/")
        full_name = f"/{namespace}/{name}" if namespace else f"/{name}"
        node = RosbridgeMiddleware(self, full_name, parameters or {}, remap or {}, use_sim_time)
        self._nodes.append(node)
        return node

    async def run(self) -> None:
        """Keeps the link up and the timers going until it is cancelled."""
        self.loop = asyncio.get_event_loop()
        for node in tuple(self._nodes):
            node.arm()
        await self.link.run()

    def close(self) -> None:
        """Closes every node and, for the one that runs it, the link."""
        for node in tuple(self._nodes):
            node.close()
        self.link.close()

    def forget(self, node: RosbridgeMiddleware) -> None:
        """Leaves out a node that has closed."""
        if node in self._nodes:
            self._nodes.remove(node)

    def _note_link(self, up: bool) -> None:
        if up:
            self.on_log(LogLine(self.clock(), "rosbridge", Severity.INFO, f"connected to {self.url}"))
        self.on_link(up)

    def run_in_loop(self, function: Callable[[], None]) -> None:
        """Has a function called in the loop soon; before `run`, and after the loop's end, not at all."""
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):
                self.loop.call_soon_threadsafe(function)


class _Subscription:
    def __init__(self, node: RosbridgeMiddleware, topic: str, type_name: str, field: Optional[str]) -> None:
        self.topic = topic
        self._node = node
        self._type_name = type_name
        self._field = field
        self._get: Callable[[Any], Any] = (lambda message: 1.0) if field is None else mapping_getter(field)
        # rosbridge writes NaN and infinities as null in JSON. A path with an index reads as None beyond the end.
        self._null_is_nan = bool(field) and "[" not in str(field)
        self._failed = False
        self.active = True
        self.callback: Callable[[Any, float], None] = lambda value, now_s: None

    def deliver(self, message: Mapping[str, Any]) -> None:
        """Takes a message from the link."""
        try:
            value = self._get(message)
        except (KeyError, TypeError, AttributeError):
            self._say_missing(message)
            return
        if value is ABSENT:
            return
        if value is None and self._null_is_nan:
            value = float("nan")
        self._node.call_back(self, value)

    def _say_missing(self, message: Mapping[str, Any]) -> None:
        if not self._failed:
            self._failed = True
            known_as = f"{self.topic} ({self._type_name})" if self._type_name else self.topic
            there_are = ", ".join(message)
            self._node.log(Severity.ERROR, f"{known_as} has no field {self._field}; there are {there_are}")


class RosbridgeMiddleware:
    """One node on a robot behind rosbridge; implements `core.middleware.Middleware`."""

    def __init__(
        self,
        client: RosbridgeClient,
        name: str,
        parameters: Mapping[str, Any],
        remap: Mapping[str, str],
        use_sim_time: bool,
    ) -> None:
        """Use `RosbridgeClient.node`."""
        self.name = name
        self._client = client
        self._link = client.link
        self._given = parameters
        self._on_change: Optional[Callable[[Mapping[str, Any]], str]] = None
        self._remap = {resolve_name(old, name): resolve_name(new, name) for old, new in remap.items()}
        self._lock = threading.RLock()
        self.closed = False
        """Whether `close` was called."""
        self._advertised: Dict[str, str] = {}
        self._services: List[str] = []
        self._subscriptions: List[_Subscription] = []
        self.faults = Faults()
        self._timers = ClockTimers()
        self._steady_timers = ClockTimers()
        self._wake: Optional[asyncio.TimerHandle] = None
        self._sim_time_s: Optional[float] = None
        if use_sim_time:
            self._sim_time_s = 0.0
            self._link.subscribe(CLOCK, CLOCK_TYPE, self._take_clock)

    def now_s(self) -> float:
        return self._client.clock() if self._sim_time_s is None else self._sim_time_s

    def waiting_for_clock(self) -> bool:
        return self._sim_time_s == 0.0

    def steady_s(self) -> float:
        return self._client.clock()

    def given_parameters(self) -> Mapping[str, Any]:
        return self._given

    def declare_parameters(
        self, parameters: Sequence[Parameter], on_change: Callable[[Mapping[str, Any]], str]
    ) -> None:
        self._on_change = on_change

    def set_parameter(self, name: str, value: object) -> None:
        """Proposes one changed value, by its dotted name.

        Raises:
            ConfigError: the node refuses it; the old one stays.
        """
        with self._lock:
            tree = unflatten({**dict(flatten(self._given)), name: value})
            if self._on_change is not None:
                try:
                    self._on_change(tree)
                except ConfigError:
                    raise
                except Exception as error:
                    raise ConfigError(self._log_failure(error)) from error
            self._given = tree

    def advertise(self, topic: str, type_name: str) -> None:
        resolved = self._resolve(topic)
        _require_type(type_name)
        with self._lock:
            if resolved not in self._advertised:
                self._advertised[resolved] = type_name
                if not self._client.read_only:
                    self._link.advertise(resolved, type_name)

    def publish(self, topic: str, message: Message) -> None:
        resolved = self._require_advertised(topic)
        check_message(self._advertised[resolved], message)
        if not self._client.read_only:
            self._link.publish(resolved, message)

    def has_listeners(self, topic: str) -> bool:
        self._require_advertised(topic)
        return not self._client.read_only

    def subscribe(
        self, topic: str, type_name: str, callback: Callable[[Any, float], None], *, field: Optional[str] = ""
    ) -> _Subscription:
        if type_name:
            _require_type(type_name)
        subscription = _Subscription(self, self._resolve(topic), type_name, field)
        subscription.callback = callback
        with self._lock:
            self._subscriptions.append(subscription)
            self._link.subscribe(subscription.topic, type_name, subscription.deliver)
        return subscription

    def unsubscribe(self, subscription: Any) -> None:
        with self._lock:
            subscription.active = False
            if subscription in self._subscriptions:
                self._subscriptions.remove(subscription)
                self._link.unsubscribe(subscription.topic, subscription.deliver)

    def advertise_service(self, service: str, type_name: str, handler: Callable[[Message], Message]) -> None:
        def answer(request: Message) -> Message:
            with self._lock:
                try:
                    return handler(request)
                except Exception as error:
                    raise ValueError(self._log_failure(error)) from error

        resolved = self._resolve(service)
        with self._lock:
            self._services.append(resolved)
            if not self._client.read_only:
                self._link.advertise_service(resolved, type_name, answer)

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> ClockTimer:
        is_steady = steady or self._sim_time_s is None
        with self._lock:
            timer = ClockTimer(period_s, callback, self.steady_s() if is_steady else self.now_s())
            (self._steady_timers if is_steady else self._timers).add(timer)
        self._client.run_in_loop(self.arm)
        return timer

    def log(self, severity: Severity, text: str) -> None:
        self._client.on_log(LogLine(self.now_s(), self.name, severity, text))

    def close(self) -> None:
        with self._lock:
            if self.closed:
                return
            self.closed = True
            self._timers.cancel_all()
            self._steady_timers.cancel_all()
            for subscription in tuple(self._subscriptions):
                self.unsubscribe(subscription)
            for topic in self._advertised:
                self._link.unadvertise(topic)
            for service in self._services:
                self._link.unadvertise_service(service)
            if self._sim_time_s is not None:
                self._link.unsubscribe(CLOCK, self._take_clock)
        self._client.forget(self)

    def call(self, callback: Callable[..., None], *arguments: Any) -> None:
        """Calls back under the node's lock, unless the node is closed; an exception becomes a log line."""
        with self._lock:
            if self.closed:
                return
            try:
                callback(*arguments)
            except Exception as error:
                self._log_failure(error)

    def call_back(self, subscription: _Subscription, value: Any) -> None:
        """Gives a subscription's value to the node, with the time."""
        with self._lock:
            if subscription.active:
                self.call(subscription.callback, value, self.now_s())

    def arm(self) -> None:
        """Has the timers looked at when the next one is due. Called in the loop."""
        if self._client.loop is None:
            return
        if self._wake is not None:
            self._wake.cancel()
            self._wake = None
        with self._lock:
            next_s = self._steady_timers.next_s()
        if next_s is not None:
            self._wake = self._client.loop.call_later(max(0.0, next_s - self.steady_s()), self._on_wake)

    def _on_wake(self) -> None:
        self._wake = None
        self._run_due(self._steady_timers, self.steady_s())
        self.arm()

    def _run_due(self, timers: ClockTimers, due_s: float) -> None:
        with self._lock:
            for timer in timers.take_due(due_s):
                if not timer.cancelled:
                    self.call(timer.callback, self.now_s())

    def _take_clock(self, message: Mapping[str, Any]) -> None:
        stamp = message.get("clock")
        if not isinstance(stamp, Mapping):
            return
        seconds = stamp.get("secs", stamp.get("sec", 0))
        nanoseconds = stamp.get("nsecs", stamp.get("nanosec", 0))
        if isinstance(seconds, (int, float)) and isinstance(nanoseconds, (int, float)):
            with self._lock:
                self._sim_time_s = seconds + nanoseconds / 1e9
                self._run_due(self._timers, self._sim_time_s)

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


def _require_type(type_name: str) -> None:
    if split_type_name(type_name) is None:
        raise ConfigError(f"found the type {type_name!r}, allowed is package/Type, for instance std_msgs/Float32")
