"""Calls one target: attempts, waits, and the target's fault."""

from __future__ import annotations

import math
import random
import time
from collections import Counter
from functools import partial
from typing import Any, Callable, TypeVar

from ...core.values import Clock, Level, ServiceError
from ...runtime.backoff import Backoff
from ...runtime.threads import StepThread
from ..configuration import TargetSettings
from ..store.history import History
from .notification_queue import NotificationQueue, Taken
from .sender import DeliveryError, Sender

Result = TypeVar("Result")

FIRST_RETRY_S = 1.0  # after the first failed attempt; doubles with each further one
LONGEST_RETRY_S = 300.0
MOST_REFUSALS = 5  # attempts after which a notification that the target refuses (response 4xx) is given up
MAX_TICK_AGE_S = 10.0  # age from which the monitor, which ticks each second, counts as stopped
_IDLE_S = 3600.0  # a new notification wakes the thread
_STORE_RETRY_S = 1.0
_TICK_CHECK_S = 1.0


class Delivery(StepThread):
    """Calls one target, in its thread: sends what the queue holds for it, one notification after the other.

    The target `heartbeat` is called every `every_s` instead, as long as ticks come, so that another system notices if
    they do not. Failures are faults, as `notify <name>`.
    """

    def __init__(
        self,
        settings: TargetSettings,
        sender: Sender,
        queue: NotificationQueue,
        history: History,
        clock: Clock = time.monotonic,
        chance: Clock = random.random,
    ) -> None:
        """Calls nothing yet; see `start`. `clock` gives monotonic seconds.

        Many monitors do not return to a target at the same moment: `chance` is from 0 to 1.
        """
        self.settings = settings
        self._part = f"notify {settings.name}"
        self._sender = sender
        self._queue = queue
        self._history = history
        self._faults = history.faults
        self._clock = clock
        self._backoff = Backoff(FIRST_RETRY_S, LONGEST_RETRY_S, spread=0.5, chance=chance)
        self._retry_at_s = self._not_before_s = clock()
        """The wait that the target requested ends at `_not_before_s`; nothing shortens it."""
        self._attempted_s = clock() - FIRST_RETRY_S
        self._period_s = settings.every_s if settings.type == "heartbeat" else sender.repeat_every_s
        self._repeat_at_s = clock() if self._period_s < math.inf else math.inf
        self._tick_s = -math.inf
        self._has_news = False
        self._to_finish: Taken | None = None
        """Was sent, but that is not stored yet. Nothing else is sent before that, or it would be sent twice."""
        self._refusals: Counter[int] = Counter()
        super().__init__(
            self._part,
            self.step,  # what it raises may contain a secret
            lambda error: self._faults.report(self._part, f"internal error: {type(error).__name__}"),
        )

    def has_work(self) -> bool:
        """Returns whether a notification waits, and the latest attempt did not fail."""
        name = self.settings.name
        return self._queue.waiting[name] > 0 and not self._queue.wait_s.get(name, 0.0) and not self._backoff.is_failing

    def note_news(self) -> None:
        """Call when there is a new notification: it does not wait for the end of a long retry delay. Any thread."""
        self._has_news = True
        self.wake()

    def note_tick(self) -> None:
        """Call at each tick of the monitor; returns at once."""
        self._tick_s = self._clock()

    def close(self) -> None:
        """Ends the thread, and the present attempt early, where that is possible; returns at once."""
        super().close()
        self._sender.close()

    def step(self) -> float:
        """Makes at most one attempt; returns when to call this again, in s from now."""
        try:
            return self._beat() if self.settings.type == "heartbeat" else self._deliver()
        except ServiceError:  # the history reports its own fault
            return _STORE_RETRY_S

    def _beat(self) -> float:
        now_s = self._clock()
        if now_s >= self._repeat_at_s:
            if now_s - self._tick_s > MAX_TICK_AGE_S:
                return _TICK_CHECK_S
            self._repeat_at_s = now_s + self._period_s
            if self._attempt(partial(self._sender.repeat, ())) is not None:
                self._repeat_at_s = max(min(self._repeat_at_s, self._retry_at_s), self._not_before_s)
        return max(0.0, self._repeat_at_s - self._clock())

    def _deliver(self) -> float:
        name = self.settings.name
        self._finish(self._to_finish)
        dropped = self._queue.dropped[name]
        text = f"full: {dropped} notifications dropped that later ones of the same alerts supersede"
        self._faults.report(f"{self._part}: queue", text if dropped else "", Level.WARN)
        if self._has_news:
            self._has_news = False
            self._retry_at_s = max(self._not_before_s, min(self._retry_at_s, self._attempted_s + FIRST_RETRY_S))
        now_s = self._clock()
        repeat_at_s = max(self._repeat_at_s, self._not_before_s)
        if now_s >= repeat_at_s:
            self._repeat_at_s = now_s + self._period_s
            alerts = self._run(self._queue.open_at, name)
            if alerts:
                self._attempt(partial(self._sender.repeat, alerts))
            return 0.0
        wait_s = self._retry_at_s - now_s
        if wait_s <= 0.0:
            taken = self._run(self._queue.take, name)
            if taken is not None:
                self._send(taken)
                return 0.0
            wait_s = self._queue.wait_s.get(name, 0.0) if self._queue.waiting[name] else _IDLE_S
        return max(0.0, min(now_s + wait_s, repeat_at_s) - self._clock())

    def _attempt(self, call: Callable[[], object]) -> DeliveryError | None:
        """Calls the target, and shows whether that works; returns its failure."""
        failure: DeliveryError | None = None
        try:
            call()
        except DeliveryError as error:
            failure = error
        except Exception as error:  # its text may contain a secret
            failure = DeliveryError(f"internal error: {type(error).__name__}")
        self._attempted_s = self._retry_at_s = self._clock()
        if failure is None:
            self._backoff.reset()
            self._faults.clear(self._part)
        else:
            self._not_before_s = self._attempted_s + failure.retry_after_s
            self._retry_at_s = max(self._not_before_s, self._attempted_s + self._backoff.next_s())
            level = Level.ERROR if failure.is_refused else Level.WARN
            self._faults.report(self._part, f"{self._sender.place}: {failure}", level)
        self._faults.report(f"{self._part}: url_file", self._sender.warning, Level.WARN)
        return failure

    def _run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Runs a function of the queue in the history's writer thread."""
        return self._history.run(lambda connection: function(connection, *arguments))

    def _send(self, taken: Taken) -> None:
        failure = self._attempt(partial(self._sender.send, taken.notification))
        if failure is not None and failure.is_refused:
            self._refusals[taken.id] += 1
        is_given_up = self._refusals[taken.id] >= MOST_REFUSALS
        if failure is None or is_given_up:
            del self._refusals[taken.id]
            if failure is not None:
                text = f"{failure}; given up after {MOST_REFUSALS} attempts: {taken.notification.text}"
                self._faults.report(self._part, f"{self._sender.place}: {text}", Level.ERROR)
            self._finish(taken)
        elif not failure.may_have_arrived:
            self._run(self._queue.put_back, taken)

    def _finish(self, taken: Taken | None) -> None:
        """Stores what was sent, or given up."""
        self._to_finish = taken
        if taken is not None:
            self._run(self._queue.finish, taken)
            self._to_finish = None
