"""What all implementations of the port share: a lock, a clock, timers, and callbacks that are guarded.

The nodes of `mapping_node.py` carry messages as mappings; those of `runtime/native_node.py` are over rospy and rclpy.
"""

from __future__ import annotations

import abc
import threading
from typing import Any, Callable, Protocol

from ..values import Clock, ConfigError, Faults, ServiceError, printable
from .hints import Answer, Hints
from .log_limit import LimitedLog
from .middleware import Callback, Result, Severity
from .timers import ClockTimer, ClockTimers

_MAX_WAITING = 1000
"""Messages that wait for the first message on /clock; then the oldest are dropped."""


class Delivery(Protocol):
    """The part of a subscription that `ClockedNode.call_back` needs."""

    active: bool
    callback: Callback


class ClockedNode(abc.ABC):
    """One node; the base of classes that implement `core.port.Middleware`."""

    def __init__(
        self,
        name: str,
        *,
        clock: Clock,
        wall_clock: Clock,
        sim_time_s: float | None,
    ) -> None:
        """Creates a node that is not connected to anything, by its fully qualified name.

        `clock` returns monotonic seconds, `wall_clock` seconds since 1970. Under `use_sim_time`, the node's time is
        `sim_time_s`, which is 0 before the first message on /clock, and then what `set_sim_time` sets; else None.
        """
        self.name = name
        self.faults = Faults()
        self.closed = False
        """Whether `close` was called."""
        self._lock = threading.RLock()
        self._clock = clock
        self._wall_clock = wall_clock
        self._sim_time_s = sim_time_s
        self._steady_timers = ClockTimers()
        self._sim_timers = ClockTimers()
        self._hints = Hints(self.look_up_silence, clock)
        self.failures = LimitedLog(self.log, clock)
        """Writes what is wrong with messages, by topic: a robot may invent topics."""
        self._waiting: list[tuple[Delivery, Any]] = []
        self._clock_subscription: Delivery | None = None
        """Brings simulated time, and waits for nothing."""

    @abc.abstractmethod
    def log(self, severity: Severity, text: str) -> None: ...

    @abc.abstractmethod
    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        """Looks up why a topic brings no samples; see `Hints`."""

    def now_s(self) -> float:
        return self._clock() if self._sim_time_s is None else self._sim_time_s

    def waiting_for_clock(self) -> bool:
        return self._sim_time_s == 0.0

    def steady_s(self) -> float:
        return self._clock()

    def stamp_s(self) -> float:
        return self._wall_clock() if self._sim_time_s is None else self._sim_time_s

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

    def answer(self, handler: Callable[[Any], Result], given: Any) -> Result:
        """Calls a service's handler, or `on_change` with a proposed configuration, under the node's lock.

        Raises ServiceError if the node is closed or the function raised. A ConfigError is raised as it is.
        """
        with self._lock:
            if self.closed:
                raise ServiceError(f"{self.name} is closed")
            try:
                return handler(given)
            except ConfigError:
                raise
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
