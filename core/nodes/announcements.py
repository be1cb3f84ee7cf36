"""Announces transitions and notices, each once to every outlet, and publishes the whole state on /diagnostics."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Callable, Mapping

from ..judge import Continuity, Monitor
from ..port import Middleware, Severity
from ..values import ARRAY_TYPE, STATUS_TYPE, Changes, Level, Status, Transition, printable
from . import node
from .outlets import (
    Event,
    Notice,
    Outlet,
    Outlets,
    alert_message,
    event_severity,
    event_text,
    status_message,
)
from .self_monitor import SelfMonitor, SelfReport


class Announcements:
    """What alert_system announces: to the outlets that are given, then in the log, on `alerts` and on /diagnostics."""

    def __init__(
        self,
        middleware: Middleware,
        monitor: Monitor,
        outlets: Mapping[str, Outlet],
        report: SelfReport,
        *,
        log_alerts: bool,
        continuity: Continuity | None,
        silence_of: Callable[[str], str | None],
        black_box_of: Callable[[Transition], str],
    ) -> None:
        """Announces nothing yet; `report` is of `SelfMonitor`, the others of `AlertSystem`."""
        self._middleware, self._monitor, self._continuity = middleware, monitor, continuity
        self._node = node.base_name(middleware)
        self.silence_of, self._black_box_of = silence_of, black_box_of
        self.outlets = Outlets(middleware.faults)
        """Receives every transition and notice; more outlets may be added at any time."""
        for name, outlet in outlets.items():
            self.outlets.add(name, outlet)
        if log_alerts:
            self.outlets.add("log", self._log)
        self.outlets.add("alerts", self._publish_alert)
        self.outlets.add(node.DIAGNOSTICS, self._publish_change)
        alerts = middleware.advertise("alerts", STATUS_TYPE)
        report = {**report, "published_topics": lambda: alerts, "silenced": self.count_silenced}
        self.self_monitor = SelfMonitor(middleware, monitor.robot, self.outlets.emit, report)
        """Watches the node itself and makes its status."""
        middleware.advertise(node.DIAGNOSTICS, ARRAY_TYPE)
        self.set_rate = node.RateTimer(middleware, self._report, steady=True).set_rate
        """Publishes the whole state so often per second from now on, also while a simulator is paused."""

    def announce(self, changes: Changes, now_s: float) -> None:
        """Announces what a call of the monitor returned. The history has each transition before any outlet."""
        for text in changes.notices:
            self.note(text, now_s)
        for transition in changes:
            black_box = self._black_box_of(transition)
            if black_box:
                transition = replace(transition, black_box=black_box)
            if self._continuity is not None:  # no failure of a history may keep an alert from the outlets
                self._middleware.faults.guard("storing an alert", self._continuity.record, transition)
            self.outlets.emit(transition)

    def note(self, text: str, now_s: float) -> None:
        """Announces a line that is of no signal's level."""
        self.outlets.emit(Notice(now_s, Severity.INFO, text))

    def statuses(self, now_s: float) -> list[Status]:
        """Returns the whole state, as it is published on /diagnostics."""
        return [*map(self._with_silence, self._monitor.report(now_s).statuses.values()), self.self_monitor.status()]

    def status(self, signal: str) -> Status | None:
        """Returns the status of a signal, with its silence; None if it is unknown or before the first call."""
        status = self._monitor.status(signal, self._middleware.now_s())
        return None if status is None else self._with_silence(status)

    def count_silenced(self) -> int:
        """Counts the signals that are not OK and silenced."""
        silenced = [name for name in self._monitor.signals() if self.silence_of(name) is not None]
        return sum(status is not None and status.level is not Level.OK for status in map(self.status, silenced))

    def _report(self, now_s: float) -> None:
        publish = partial(node.publish_statuses, self._middleware, lambda: self.statuses(now_s))
        self._middleware.faults.guard("diagnostics", publish)

    def _log(self, event: Event) -> None:
        self._middleware.log(event_severity(event), printable(event_text(event)))

    def _publish_alert(self, event: Event) -> None:
        if isinstance(event, Transition):
            self._middleware.publish("alerts", alert_message(event, self._node, self.silence_of(event.signal)))
        elif event.part:
            status = replace(self.self_monitor.status(), message=event.text)
            self._middleware.publish("alerts", status_message(status, self._node))

    def _publish_change(self, event: Event) -> None:
        """Publishes only the status that changed: a hundred signals may change one after the other."""
        if isinstance(event, Transition):
            node.publish_statuses(self._middleware, lambda: [self._with_silence(event.status)])
        elif event.part:
            node.publish_statuses(self._middleware, lambda: [self.self_monitor.status()])

    def _with_silence(self, status: Status) -> Status:
        text = self.silence_of(status.name)
        return status if text is None else replace(status, values={**status.values, "silenced": text}, silence=text)
