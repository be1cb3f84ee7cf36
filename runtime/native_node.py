"""What the adapters over rospy and rclpy share: a node whose messages are objects of generated classes.

`core/port/mapping_node.py` has what the other adapters share, whose messages are mappings.
"""

from __future__ import annotations

import abc
import threading
import time
from typing import Any, Callable, Collection, Dict, List, Mapping, Optional, Tuple, Union

from ..core.messages.dialect import Message
from ..core.messages.native_messages import NativeMessages
from ..core.port.graph import Counts, GraphCallback, Unread, Wanted
from ..core.port.hints import Answer, Hints
from ..core.port.log_limit import LimitedLog
from ..core.port.middleware import NOTHING_CHANGED, Result, Severity
from ..core.values.errors import ConfigError, MessageError, ServiceError
from ..core.values.faults import Faults
from .threads import StepThread

Log = Callable[[Severity, str], None]


class NativeNode(abc.ABC):
    """One node; the base of classes that implement `core.middleware.Middleware`."""

    parameters: Any
    """Those of the node, with the method `given`."""
    graph_period_s = 1.0
    """Time between two readings of the graph, in s."""
    _timer_class: Any
    """Class of timers: by node, period in s, callback, and whether they are on steady time."""

    def __init__(
        self,
        name: str,
        messages: NativeMessages,
        look_up: Callable[[str, str, Answer], None],
        simulated_s: Optional[Callable[[], float]],
    ) -> None:
        """Connects nothing; `look_up` is for `Hints`, `simulated_s` gives the time under `use_sim_time`."""
        self.name = name
        self.faults = Faults()
        self._messages = messages
        self._simulated = simulated_s is not None
        self._clock = simulated_s or time.monotonic
        self._lock = threading.RLock()
        self._closed = False
        self._publishers: Dict[str, Tuple[Any, Any]] = {}
        """Publisher and class of its messages, by resolved topic."""
        self._subscriptions: List[Any] = []
        self._timers: List[Any] = []
        self._hints = Hints(look_up, time.monotonic)
        self._failures = LimitedLog(self.log, time.monotonic)
        """Writes what is wrong with messages, by topic: a robot may invent topics."""

    @abc.abstractmethod
    def log(self, severity: Severity, text: str) -> None: ...

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

    def given_parameters(self) -> Mapping[str, Any]:
        given: Mapping[str, Any] = self.parameters.given()
        return given

    def follow_graph(self, wanted: Callable[[], Collection[Wanted]], callback: GraphCallback) -> ThreadTimer:
        def read() -> float:
            if timer.active and not self.waiting_for_clock():
                counts: Union[Counts, Unread]
                try:
                    counts = self._count(wanted())
                except ServiceError as error:
                    counts = Unread(str(error))
                self._call_timer(timer, lambda now_s: callback(counts, now_s))
            return self.graph_period_s

        timer = ThreadTimer("graph", read, self._log_failure)
        timer.start()
        self._keep_timer(timer)
        return timer

    def now_s(self) -> float:
        return self._clock()

    def waiting_for_clock(self) -> bool:
        return self._simulated and self._clock() == 0.0

    def steady_s(self) -> float:
        return time.monotonic()

    def stamp_s(self) -> float:
        return self._clock() if self._simulated else time.time()

    def publish(self, topic: str, message: Message) -> None:
        publisher, cls = self._advertised(topic)
        publisher.publish(self._stamped(cls, message))

    def create_timer(self, period_s: float, callback: Callable[[float], None], *, steady: bool = False) -> Any:
        return self._keep_timer(self._timer_class(self, period_s, callback, steady or not self._simulated))

    def _keep_timer(self, timer: Any) -> Any:
        with self._lock:
            self._timers = [*(known for known in self._timers if known.active), timer]
        return timer

    def unsubscribe(self, subscription: Any) -> None:
        with self._lock:
            if subscription in self._subscriptions:
                self._subscriptions.remove(subscription)
                self._end(subscription)

    def close(self) -> None:
        with self._lock:
            if self._closed:
                return
            self._closed = True
            for timer in self._timers:
                timer.cancel()
            for subscription in self._subscriptions:
                subscription.active = False
            self._leave()
            self._timers.clear()
            self._subscriptions.clear()
            self._publishers.clear()

    def exclusively(self, function: Callable[[], Result]) -> Result:
        with self._lock:
            return function()

    def _stamped(self, cls: Any, message: Message) -> Any:
        """Returns a native message, stamped if it has no stamp."""
        native = self._messages.to_native(cls, message)
        if self._messages.is_stamped(cls) and "stamp" not in message.get("header", {}):
            native.header.stamp = self._stamp()
        return native

    def _advertised(self, topic: str) -> Tuple[Any, Any]:
        """Returns the publisher of a topic and its class."""
        resolved = self._resolve(topic)
        if resolved not in self._publishers:
            raise MessageError(f"{self.name} has not advertised {resolved}")
        return self._publishers[resolved]

    def _call_timer(self, timer: Any, callback: Callable[[float], None]) -> None:
        with self._lock:
            if timer.active:
                try:
                    callback(self._clock())
                except Exception as error:
                    self._log_failure(error)

    def _log_failure(self, error: Exception) -> str:
        """Logs an exception of a callback as one line, which it returns."""
        text = failure_text(error)
        self.log(Severity.ERROR, text)
        return text


class ThreadTimer(StepThread):
    """A timer with a thread. Implements `core.port.middleware.Timer`."""

    cancel = StepThread.close


def failure_text(error: Exception) -> str:
    """Returns the log line about an exception of a callback."""
    return " ".join(f"{type(error).__name__} in a callback: {error}".split())


def apply_change(apply: Callable[[], str], log: Log) -> Tuple[bool, str]:
    """Applies new parameters and logs the outcome; returns whether they are accepted, and what changed or why not."""
    try:
        changes = apply()
    except (ConfigError, ServiceError) as error:
        reason = str(error)
    except Exception as error:
        reason = failure_text(error)
        log(Severity.ERROR, reason)
    else:
        if changes != NOTHING_CHANGED:
            log(Severity.INFO, f"parameters changed: {changes}")
        return True, changes
    log(Severity.WARN, f"the old parameters stay in force: {reason}")
    return False, reason
