"""Code shared by the adapters that carry messages as mappings: the in-process one and the rosbridge client.

`MappingNode` implements the part of the port that needs no transport: names, parameters, clocks, timers, guarded
callbacks and the reading of fields. A subclass adds publishing, subscribing, services and `log`.
"""

from __future__ import annotations

import abc
import threading
from typing import Any, Callable, Collection, Dict, List, Mapping, Optional, Protocol, Sequence, Tuple

from ..config.parameters import Parameter
from ..messages.dialect import Message
from ..messages.mapping_field import MISSING, MappingField
from ..messages.raw_messages import RawFormat, json_bytes, json_format
from ..messages.standard_messages import check_type, complete, definition, is_stamped
from ..values.elements import Stamp
from ..values.errors import ConfigError, MessageError, ServiceError
from ..values.faults import Faults
from ..values.field_path import ABSENT, mapping_getter
from ..values.formatting import printable
from ..values.names import resolve_name
from .graph import GraphCallback, Wanted
from .hints import Answer, Hints
from .log_limit import LimitedLog
from .middleware import Callback, OnChange, RawCallback, Result, Severity, Timer
from .timers import ClockTimer, ClockTimers

CLOCK = "/clock"
CLOCK_TYPE = "rosgraph_msgs/Clock"

_MAX_WAITING = 1000
"""Messages that wait for the first message on /clock; then the oldest are dropped."""

_MAX_RESOLVED = 1000
_MAX_FIELDS_SHOWN = 20
_MAX_TEXT = 200


class Delivery(Protocol):
    """The part of a subscription that `MappingNode.call_back` needs."""

    active: bool
    callback: Callback


class _Logging:
    """A subscription that logs once why messages cannot be read."""

    topic: str
    _node: MappingNode
    _has_failed = False

    def _log_once(self, text: str) -> None:
        if not self._has_failed:
            self._has_failed = True
            self._node.failures.write(self.topic, Severity.ERROR, printable(text))


class MappingSubscription(_Logging, MappingField):
    """A subscription that reads one field from messages that are mappings. Implements `middleware.Subscription`."""

    def __init__(self, node: MappingNode, topic: str, type_name: str, field: Optional[str], callback: Callback) -> None:
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
        self._log_once(f"{shown} {lacks} {self._field}; available: {available}")


class RawSubscription(_Logging):
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
        found = self._node.raw_format_of(self.topic, self._type_name)
        if found is None or found.message_encoding != "json":
            return
        try:
            item = json_bytes(message), found
        except (MessageError, TypeError, ValueError, RecursionError) as error:
            self._log_once(f"{self.topic}: a message is not recorded: {error}")
            return
        self._node.call_back(self, item)


class MappingNode(abc.ABC):
    """One node; the base of classes that implement `core.middleware.Middleware`."""

    def __init__(
        self,
        name: str,
        parameters: Mapping[str, Any],
        remap: Mapping[str, str],
        *,
        clock: Callable[[], float],
        wall_clock: Callable[[], float],
        use_sim_time: bool = False,
    ) -> None:
        """Creates a node that is not connected to anything, by its fully qualified name.

        `remap` maps names as the node uses them (relative or absolute) to the names to use instead. `clock` returns
        monotonic seconds, `wall_clock` seconds since 1970. With `use_sim_time`, the node's time is what `set_sim_time`
        sets, and 0 before that.
        """
        self.name = name
        self.faults = Faults()
        self.closed = False
        """Whether `close` was called."""
        self._lock = threading.RLock()
        self._clock = clock
        self._wall_clock = wall_clock
        self._given = parameters
        self._on_change: Optional[OnChange] = None
        self._remap = {resolve_name(old, name): resolve_name(new, name) for old, new in remap.items()}
        self._resolved: Dict[str, str] = {}
        self._advertised: Dict[str, str] = {}
        self._sim_time_s: Optional[float] = 0.0 if use_sim_time else None
        self._steady_timers = ClockTimers()
        self._sim_timers = ClockTimers()
        self._hints = Hints(self.look_up_silence, self.steady_s)
        self.failures = LimitedLog(self.log, self.steady_s)
        """Writes what is wrong with messages, by topic: a robot may invent topics."""
        self._waiting: List[Tuple[Delivery, Any]] = []
        self._clock_subscription: Optional[Delivery] = None
        """Brings simulated time, and waits for nothing."""

    @abc.abstractmethod
    def log(self, severity: Severity, text: str) -> None: ...

    @abc.abstractmethod
    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        """Looks up why a topic brings no samples; see `Hints`."""

    def why_silent(self, topic: str, type_name: str) -> Optional[str]:
        return self._hints.get(self.resolve(topic), type_name)

    def graph_name(self, key: str, name: str) -> str:
        raise ServiceError("the robot's graph is not known here")

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> Timer:
        raise ServiceError("the robot's graph is not known here")

    def now_s(self) -> float:
        return self._clock() if self._sim_time_s is None else self._sim_time_s

    def waiting_for_clock(self) -> bool:
        return self._sim_time_s == 0.0

    def steady_s(self) -> float:
        return self._clock()

    def stamp_s(self) -> float:
        return self._wall_clock() if self._sim_time_s is None else self._sim_time_s

    def given_parameters(self) -> Mapping[str, Any]:
        return self._given

    def declare_parameters(self, parameters: Sequence[Parameter], on_change: OnChange) -> None:
        self._on_change = on_change

    def set_parameters(self, tree: Mapping[str, Any]) -> str:
        """Proposes a new configuration, nested, as `ros2 param set` and `~reload` do elsewhere; returns what changed.

        Raises ConfigError if the node rejects it; the old values stay in force.
        """
        with self._lock:
            try:
                changes = "" if self._on_change is None else self._on_change(tree)
            except ConfigError:
                raise
            except Exception as error:
                raise ConfigError(self.log_failure(error)) from error
            self._given = tree
            return changes

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> ClockTimer:
        with self._lock:
            on_sim_time = not steady and self._sim_time_s is not None
            timer = ClockTimer(period_s, callback, self.now_s() if on_sim_time else self.steady_s())
            (self._sim_timers if on_sim_time else self._steady_timers).add(timer)
        return timer

    def next_steady_s(self) -> float:
        """Returns when the next timer on steady time is due, in s; infinity without such timers."""
        with self._lock:
            return self._steady_timers.next_s()

    def run_steady_timers(self) -> None:
        """Calls the timers that are due on steady time."""
        self._run_due(self._steady_timers, self.steady_s())

    def take_clock(self, message: Message, arrived_s: float = 0.0) -> None:
        """Processes a message of /clock, as a callback; call for every one of them under `use_sim_time`."""
        now_s = read_clock(message)
        if now_s is not None:
            self.set_sim_time(now_s)

    def set_sim_time(self, now_s: float) -> None:
        """Sets simulated time, which may go back; calls the timers that are due, first the messages that waited for it.

        As in ROS, a time of 0 is no time: messages wait again.
        """
        with self._lock:
            if self._sim_time_s is None or now_s < 0.0:
                return
            was_waiting, self._sim_time_s = self._sim_time_s == 0.0, now_s
            if now_s == 0.0:
                return
            if was_waiting:
                self._sim_timers.restart(now_s)
                while self._waiting:
                    self.call_back(*self._waiting.pop(0))
            self._run_due(self._sim_timers, now_s)

    def type_of(self, topic: str) -> str:
        """Returns the type of a topic by its resolved name, empty if it is not known."""
        return ""

    def raw_format_of(self, topic: str, type_name: str) -> Optional[RawFormat]:
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

    def serialize(self, type_name: str, message: Message) -> Tuple[bytes, RawFormat]:
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

    def call(self, callback: Callable[..., object], *arguments: Any) -> None:
        """Calls back under the node's lock, unless the node is closed; an exception becomes a log line."""
        with self._lock:
            if not self.closed:
                try:
                    callback(*arguments)
                except Exception as error:
                    self.log_failure(error)

    def exclusively(self, function: Callable[[], Result]) -> Result:
        with self._lock:
            return function()

    def call_back(self, subscription: Delivery, value: Any) -> None:
        """Passes a value to a subscription's callback, with the time; waits for /clock under `use_sim_time`."""
        with self._lock:
            if self._sim_time_s == 0.0 and subscription is not self._clock_subscription:
                self._waiting = [*self._waiting[1 - _MAX_WAITING :], (subscription, value)]
            elif subscription.active:
                self.call(subscription.callback, value, self.now_s())

    def answer(self, handler: Callable[[Message], Message], request: Message) -> Message:
        """Calls a service's handler under the node's lock; raises ServiceError if the node is closed or it raised."""
        with self._lock:
            if self.closed:
                raise ServiceError(f"{self.name} is closed")
            try:
                return handler(request)
            except Exception as error:
                raise ServiceError(self.log_failure(error)) from error

    def log_failure(self, error: Exception) -> str:
        """Logs an exception of a callback as one line, which it returns."""
        text = printable(" ".join(f"{type(error).__name__} in a callback: {error}".split()))
        self.log(Severity.ERROR, text)
        return text

    def cancel_timers(self) -> None:
        """Cancels all timers; part of `close`."""
        self._steady_timers.cancel_all()
        self._sim_timers.cancel_all()

    def _run_due(self, timers: ClockTimers, due_s: float) -> None:
        with self._lock:
            for timer in timers.take_due(due_s):
                if not timer.cancelled:
                    self.call(timer.callback, self.now_s())


def read_clock(message: Message) -> Optional[float]:
    """Returns the time of a rosgraph_msgs/Clock in s, with the stamp of ROS 1 or ROS 2; None if it is not valid."""
    stamp = _clock_of(message) if "clock" in message else None
    return float(stamp) if type(stamp) is Stamp else None


_clock_of = mapping_getter("clock")
