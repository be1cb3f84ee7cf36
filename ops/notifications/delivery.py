"""Delivers the notifications of one target: attempts, waits, and the target's fault."""

from __future__ import annotations

import random
import time
from collections import Counter
from typing import Callable, Optional

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level
from robot_health_monitor.runtime.backoff import Backoff

from .database import QueueDatabase
from .notification_queue import NotificationQueue, Taken
from .sender import DeliveryError, Sender

FIRST_RETRY_S = 1.0
"""Wait after the first failed attempt, in s. It doubles with each further one."""

LONGEST_RETRY_S = 300.0
"""Longest wait between two attempts, in s."""

MOST_REFUSALS = 5
"""Attempts after which a notification that the target refuses (response 4xx) is given up."""

_IDLE_S = 3600.0  # a new notification wakes the thread
_STORE_TIMEOUT_S = 5.0
_STORE_RETRY_S = 1.0


class Delivery:
    """Sends what the queue holds for one target, one notification after the other. Used by one thread."""

    def __init__(
        self,
        target: str,
        sender: Sender,
        queue: NotificationQueue,
        database: QueueDatabase,
        faults: Faults,
        clock: Callable[[], float] = time.monotonic,
        chance: Callable[[], float] = random.random,
    ) -> None:
        """Sends nothing yet; see `step`.

        Args:
            target: its name.
            sender: delivers a notification.
            queue: holds the notifications.
            database: runs the functions of `queue`.
            faults: receives failures, as `notify <target>`.
            clock: monotonic seconds.
            chance: a random number from 0 to 1, so that many monitors do not return to a target at the same moment.
        """
        self.sender = sender
        self._target = target
        self._queue = queue
        self._database = database
        self._faults = faults
        self._part = f"notify {target}"
        self._clock = clock
        self._backoff = Backoff(FIRST_RETRY_S, LONGEST_RETRY_S, spread=0.5, chance=chance)
        self._retry_at_s = clock()
        self._not_before_s = clock()
        """The wait that the target requested ends then; nothing shortens it."""
        self._attempted_s = clock() - FIRST_RETRY_S
        self._repeat_at_s = clock()
        self._has_news = False
        self._to_finish: Optional[Taken] = None
        self._refusals: Counter[int] = Counter()

    def note_news(self) -> None:
        """Call when there is a new notification: it does not wait for the end of a long retry delay. Any thread."""
        self._has_news = True

    @property
    def is_failing(self) -> bool:
        """Whether the latest attempt failed."""
        return self._backoff.is_failing

    def step(self) -> float:
        """Makes at most one attempt.

        Returns:
            When to call this again, in s from now.
        """
        try:
            self._finish()
            if self._has_news:
                self._has_news = False
                self._retry_at_s = max(self._not_before_s, min(self._retry_at_s, self._attempted_s + FIRST_RETRY_S))
            now_s = self._clock()
            if self.sender.repeat_every_s is not None and now_s >= max(self._repeat_at_s, self._not_before_s):
                self._repeat_at_s = now_s + self.sender.repeat_every_s
                self._repeat()
                return 0.0
            if now_s < self._retry_at_s:
                return self._wait_s(self._retry_at_s)
            taken = self._database.run(lambda connection: self._queue.take(connection, self._target), _STORE_TIMEOUT_S)
            if taken is None:
                self._report_dropped()
                return 0.0 if self._queue.waiting(self._target) else self._wait_s(now_s + _IDLE_S)
            self._send(taken)
            return 0.0
        except ServiceError:  # the history reports its own fault
            return _STORE_RETRY_S

    def _wait_s(self, until_s: float) -> float:
        if self.sender.repeat_every_s is not None:
            until_s = min(until_s, max(self._repeat_at_s, self._not_before_s))
        return max(0.0, until_s - self._clock())

    def _repeat(self) -> None:
        alerts = self._database.run(lambda connection: self._queue.open_at(connection, self._target), _STORE_TIMEOUT_S)
        if not alerts:
            return
        try:
            self.sender.repeat(alerts)
        except DeliveryError as error:
            self._note_failure(error)
        else:
            self._note_success()

    def _send(self, taken: Taken) -> None:
        error = self._attempt(taken)
        if error is not None:
            self._note_failure(error)
            if error.is_refused:
                self._refusals[taken.id] += 1
            if self._refusals[taken.id] >= MOST_REFUSALS:
                del self._refusals[taken.id]
                text = (
                    f"{self.sender.place}: {error}; given up after {MOST_REFUSALS} attempts: {taken.notification.text}"
                )
                self._faults.report(self._part, text, Level.ERROR)
                self._to_finish = taken
                self._finish()
            elif not error.may_have_arrived:
                self._database.run(lambda connection: self._queue.put_back(connection, taken), _STORE_TIMEOUT_S)
        else:
            self._refusals.pop(taken.id, None)
            self._note_success()
            self._to_finish = taken
            self._finish()

    def _attempt(self, taken: Taken) -> Optional[DeliveryError]:
        try:
            self.sender.send(taken.notification)
        except DeliveryError as error:
            return error
        except Exception as error:  # its text may contain a secret
            return DeliveryError(f"internal error: {type(error).__name__}")
        return None

    def _finish(self) -> None:
        """Stores what was sent. Nothing else is sent before that, or it would be sent twice."""
        taken = self._to_finish
        if taken is not None:
            self._database.run(lambda connection: self._queue.finish(connection, taken), _STORE_TIMEOUT_S)
            self._to_finish = None

    def _note_success(self) -> None:
        self._backoff.reset()
        self._retry_at_s = self._attempted_s = self._clock()
        self._faults.clear(self._part)
        self._report_warning()

    def _note_failure(self, error: DeliveryError) -> None:
        self._attempted_s = self._clock()
        self._not_before_s = self._attempted_s + error.retry_after_s
        self._retry_at_s = max(self._not_before_s, self._attempted_s + self._backoff.next_s())
        level = Level.ERROR if error.is_refused else Level.WARN
        self._faults.report(self._part, f"{self.sender.place}: {error}", level)
        self._report_warning()
        self._report_dropped()

    def _report_warning(self) -> None:
        part = f"{self._part}: url_file"
        if self.sender.warning:
            self._faults.report(part, self.sender.warning, Level.WARN)
        else:
            self._faults.clear(part)

    def _report_dropped(self) -> None:
        part = f"{self._part}: queue"
        dropped = self._queue.dropped(self._target)
        if dropped:
            text = f"full: {dropped} notifications dropped that later ones of the same alerts supersede"
            self._faults.report(part, text, Level.WARN)
        else:
            self._faults.clear(part)
