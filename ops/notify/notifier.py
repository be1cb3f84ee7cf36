"""Notifications of one monitor process: a queue in the history's database and a thread per target."""

from __future__ import annotations

import time
from sqlite3 import Connection
from typing import Callable, Collection, Mapping, Sequence

from ...core.values import Clock, Transition
from ..configuration import TargetSettings
from ..store.active_silences import Silences
from ..store.database import Job
from ..store.history import History
from ..store.present_state import keep_lines
from .alertmanager import Alertmanager
from .apprise import AppriseTarget
from .command import Command
from .delivery import Delivery
from .notification_queue import NotificationQueue
from .sender import Sender
from .webhook import Webhook

CLOSE_TIMEOUT_S = 1.0  # how long `close` waits for notifications of targets that work
_CLOSE_POLL_S = 0.02

_SENDERS: Mapping[str, type[Sender]] = {
    "alertmanager": Alertmanager,
    "webhook": Webhook,
    "heartbeat": Webhook,
    "command": Command,
    "apprise": AppriseTarget,
}


class Notifier:
    """Notifies targets about transitions that the history records. Nothing here delays an alert."""

    def __init__(
        self,
        history: History,
        targets: Sequence[TargetSettings],
        silences: Silences,
        is_simulated: Callable[[str, str], bool] = lambda robot, signal: False,
        public_url: str = "",
    ) -> None:
        """Starts a thread per target. Call before the first AlertSystem starts, or its first transitions are missed.

        `history` also stores the queue; its faults have failing targets, as `notify <name>`. `is_simulated`, of a robot
        and its signal, must be cheap and may be called from any thread. `public_url` is the address of the web page,
        for links; empty if there is none.
        """
        self._history = history
        self._is_up_to_date = False
        self._watched: Collection[str] | None = None
        self._queue = NotificationQueue(targets, silences, is_simulated, history.wall_s, public_url)
        self._deliveries = [
            Delivery(settings, make_sender(settings, history.wall_s), self._queue, history) for settings in targets
        ]
        for delivery in self._deliveries:
            delivery.start()
        history.on_record.append(self._note)
        history.on_second.append(self._follow)
        if self._queue.targets:
            history.put(keep_lines)
        history.put(self._follow)

    @property
    def waiting(self) -> int:
        """How many notifications wait, over all targets."""
        return sum(self._queue.waiting.values())

    def note_tick(self) -> None:
        """Call at each tick of the monitor, for the heartbeat; returns at once."""
        for delivery in self._deliveries:
            delivery.note_tick()

    def end_unwatched(self, robots: Collection[str]) -> None:
        """Ends the notified alerts of all robots but those that are watched, such as those of an earlier run.

        Call when these are known, and when they change; returns at once.
        """
        self._watched, self._is_up_to_date = frozenset(robots), False

    def close(self) -> None:
        """Ends the threads. Targets that work are sent what waits, for at most 1 s; the rest stays in the queue."""
        until_s = time.monotonic() + CLOSE_TIMEOUT_S
        while time.monotonic() < until_s and any(delivery.has_work() for delivery in self._deliveries):
            time.sleep(_CLOSE_POLL_S)
        for delivery in self._deliveries:
            delivery.close()
        for delivery in self._deliveries:
            delivery.join(max(0.0, until_s - time.monotonic()))

    def detach(self) -> None:
        """Ends what the history calls, after `close`; runs in its thread."""
        self._history.on_record.remove(self._note)
        self._history.on_second.remove(self._follow)

    def _note(self, connection: Connection, alert_id: int, transition: Transition, wall_s: float) -> None:
        """Queues a transition; runs inside the transaction that stores it."""
        if self._queue.targets:
            self._queue.note(connection, transition, alert_id, wall_s)
            # Behind the alert: the threads of the targets compete for the processor.
            self._history.submit(Job(lambda connection: self._wake()), is_urgent=True)

    def _wake(self) -> None:
        for delivery in self._deliveries:
            if self._queue.waiting[delivery.settings.name]:
                delivery.note_news()

    def _follow(self, connection: Connection) -> None:
        """Queues what the targets do not know yet, such as because silences or robots changed; called each second."""
        if self._queue.targets and (not self._is_up_to_date or self._queue.is_reconciliation_due()):
            watched = self._watched
            self._queue.prepare(connection)
            if watched is not None:
                self._queue.end_unwatched(connection, watched, self._history.wall_s())
            self._is_up_to_date = self._watched is watched
            self._wake()


def make_sender(settings: TargetSettings, wall_time_s: Clock = time.time) -> Sender:
    """Returns the sender for a target; that of a heartbeat is used for its address only."""
    return _SENDERS[settings.type](settings, wall_time_s)
