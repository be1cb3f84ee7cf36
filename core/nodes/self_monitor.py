"""Self-monitoring of alert_system: faults, clock, tick lateness, pauses, and the key-values of its status."""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Any, Callable, Mapping

from ..port import Middleware, Severity
from ..values import Level, Status, duration_text, number_text, package_version, summary_of
from .outlets import Notice, Outlet

MONITOR = "monitor"
"""Name of the status, which /diagnostics shows as `alert_system: monitor`."""

CHECK_PERIOD_S = 1.0
"""Period of `SelfMonitor.check`, in seconds of steady time, and of the ticks of a node, in seconds of its clock."""

LONGEST_STEP_S = 3.0
"""If no callback looked at the time for longer, in seconds of steady time, the process was stopped."""

_RESUME_S = 5.0
"""What is found broken within this time after a pause, in seconds of steady time, broke because of it."""
_CLOCK_GRACE_S = 10.0
_CLOCK_REMINDER_S = 60.0
_MAX_LATENESS_S = 5.0
_NEVER = (math.inf, math.inf)
_MIN_HEALTHY_S = 3.0
"""How long a part must work before its fault is announced as ended; keeps an intermittent fault to one line."""


SelfReport = Mapping[str, Callable[[], Any]]
"""Key-values of a node's status: a function per key, called for each status; one that returns None has no key there.

version, uptime_s             since the start of the node, in s
signals, samples_per_s        number of watched signals; samples in the last second
dropped                       number of messages that were not judged
tick_late_s
clients, clients_dropped      number of clients of the server, and of messages that it dropped
pending_notifications
published_topics              as `OWN_TOPICS` of core/values/elements.py
simulated                     names of signals with invented values
without_sensor                names of signals that are not watched, because the host has no such sensor
robots, unreachable           number of robots, and of those without a connection
silenced                      number of signals that are not OK and silenced
black_box_s                   how far the messages of the black box in memory reach back, in s
black_box_dropped             number of messages that it dropped before their time, because its memory was full
"""

EMPTY_REPORT: SelfReport = MappingProxyType(
    {
        "version": package_version,
        "uptime_s": float,
        "signals": int,
        "samples_per_s": float,
        "dropped": int,
        "tick_late_s": float,
        "clients": int,
        "pending_notifications": int,
    }
)
"""The keys that every status has."""

_FORMATS: Mapping[str, Callable[[Any], str]] = {
    "uptime_s": "{:.0f}".format,
    "samples_per_s": number_text,
    "tick_late_s": "{:.3f}".format,
    "black_box_s": "{:.1f}".format,
    "simulated": ", ".join,
    "without_sensor": ", ".join,
}


def _text(key: str, read: Callable[[], object]) -> str | None:
    """Returns a key-value as /diagnostics shows it. A function that raises does not hide the others."""
    try:
        value = read()
        return None if value is None else _FORMATS.get(key, str)(value)
    except Exception as error:
        return f"unknown ({type(error).__name__}: {error})"


class SelfMonitor:
    """Announces the faults of its node as notices and keeps the node's own status.

    Runs on steady time, so that it also works without /clock and while a simulator is paused.
    """

    def __init__(self, middleware: Middleware, robot: str, emit: Outlet, report: SelfReport = EMPTY_REPORT) -> None:
        """Starts without faults.

        `emit` receives a notice when one of the middleware's `faults` begins or ends. `robot` is the `hardware_id` of
        the status, which shows `report` besides what is measured here.
        """
        self._middleware = middleware
        self._robot = robot
        self._emit = emit
        self._start_s = self._checked_s = middleware.steady_s()
        self._announced: dict[str, Level] = {}
        self._healthy_since_s: dict[str, float] = {}
        self._clock_reminder_s = _CLOCK_GRACE_S
        self._samples = 0
        self._samples_per_s = 0.0
        self._tick = _NEVER if middleware.waiting_for_clock() else (middleware.now_s(), self._start_s)
        """Time of the last tick in s of the node's clock and of steady time; `_NEVER` while none can come."""
        self._last_lateness_s = 0.0
        self._looked = _NEVER
        """The same of the last call of `find_pause`."""
        self.look_due_s = math.inf
        """At a later time, in s, the process may have been stopped: call `find_pause` before anything else."""
        self._resumed_steady_s = -math.inf
        self._report = {
            **EMPTY_REPORT,
            **report,
            "uptime_s": lambda: middleware.steady_s() - self._start_s,
            "samples_per_s": lambda: self._samples_per_s,
            "tick_late_s": self._lateness_s,
        }

    def find_pause(self, now_s: float, *, announce: bool = True) -> float | None:
        """Returns the time of the last call, in s, if the process was stopped since; else None.

        Stopped by SIGSTOP, a debugger, a machine that swaps; not by a paused simulator: steady time goes on. Call at
        least every `CHECK_PERIOD_S` of steady time, before anything else is done with `now_s`.
        """
        steady_s, looked = self._middleware.steady_s(), self._looked
        self._looked = now_s, steady_s
        self.look_due_s = now_s + LONGEST_STEP_S
        if steady_s - looked[1] <= LONGEST_STEP_S:
            return None
        self._resumed_steady_s = steady_s
        self._tick = self._looked  # no tick could come
        if announce:
            text = f"the monitor was stopped for {duration_text(int(steady_s - looked[1]))}"
            self._emit(Notice(now_s, Severity.WARN, text))
        return looked[0]

    @property
    def has_just_resumed(self) -> bool:
        """Whether a pause was found in the last 5 s."""
        return self._middleware.steady_s() - self._resumed_steady_s < _RESUME_S

    def note_tick(self, now_s: float) -> None:
        """Call at each tick of the node, with the time that the tick was given."""
        self._last_lateness_s = self._lateness_s()
        self._tick = now_s, self._middleware.steady_s()

    def skip(self, duration_s: float) -> None:
        """Leaves a time in which no tick could come, in s, out of the time since the last tick."""
        self._tick = self._tick[0] + duration_s, self._tick[1] + duration_s
        self._looked = self._looked[0] + duration_s, self._looked[1] + duration_s
        self.look_due_s += duration_s

    def check(self, samples: int) -> None:
        """Looks for faults that began or ended; call every `CHECK_PERIOD_S`, with the number of samples so far."""
        steady_s = self._middleware.steady_s()
        if steady_s > self._checked_s:
            self._samples_per_s = (samples - self._samples) / (steady_s - self._checked_s)
        self._samples, self._checked_s = samples, steady_s
        self._check_clock(steady_s - self._start_s)
        self._check_tick()
        self._announce_faults(steady_s)

    @property
    def tick_age_s(self) -> float:
        """Time since the last tick, in s. Grows only while the node's clock and steady time both pass.

        While a simulator is paused, or before its first clock message, there are no ticks: then the time since the last
        `check` counts, which shows that the node runs.
        """
        since_check_s = self._middleware.steady_s() - self._checked_s - CHECK_PERIOD_S
        return max(0.0, self._since_tick_s(), since_check_s)

    def status(self) -> Status:
        """Returns the node's own status: its level is that of its worst fault."""
        faults = self._middleware.faults.current()
        values = {key: text for key, read in self._report.items() for text in [_text(key, read)] if text is not None}
        values.update((f"fault: {part}", fault.text) for part, fault in faults.items())
        level, message = summary_of(faults)
        return Status(MONITOR, level, message, self._robot, values)

    def _since_tick_s(self) -> float:
        """Returns the time since the last tick, in s, by the slower clock: simulated time may run fast or be paused."""
        return min(self._middleware.now_s() - self._tick[0], self._middleware.steady_s() - self._tick[1])

    def _lateness_s(self) -> float:
        """Returns by how much the tick is late, in s."""
        return max(0.0, self._since_tick_s() - CHECK_PERIOD_S)

    def _check_clock(self, uptime_s: float) -> None:
        faults = self._middleware.faults
        if not self._middleware.waiting_for_clock():
            faults.clear("clock")
        elif uptime_s >= self._clock_reminder_s:
            text = f"use_sim_time is set, but /clock has been silent for {uptime_s:.0f} s: no signal is judged"
            faults.report("clock", text, Level.WARN)
            self._clock_reminder_s += _CLOCK_REMINDER_S
            self._announced.pop("clock", None)  # announces it again

    def _check_tick(self) -> None:
        if self._middleware.waiting_for_clock():
            self._tick = _NEVER
        elif self._tick == _NEVER:
            self._tick = self._middleware.now_s(), self._middleware.steady_s()
        lateness_s = max(self._last_lateness_s, self._lateness_s())
        text = f"{lateness_s:.1f} s late (period {CHECK_PERIOD_S:g} s): overloaded or suspended"
        self._middleware.faults.report("tick", text if lateness_s > _MAX_LATENESS_S else "", Level.WARN)
        self._last_lateness_s = 0.0

    def _announce_faults(self, steady_s: float) -> None:
        faults = self._middleware.faults.current()
        for part, fault in faults.items():
            self._healthy_since_s.pop(part, None)
            announced = self._announced.get(part)
            if announced is None or fault.level.severity > announced.severity:
                self._announced[part] = fault.level
                severity = Severity.WARN if fault.level is Level.WARN else Severity.ERROR
                self._emit(Notice(self._middleware.now_s(), severity, f"{part}: {fault.text}", part))
        for part in [part for part in self._announced if part not in faults]:
            if steady_s - self._healthy_since_s.setdefault(part, steady_s) >= _MIN_HEALTHY_S:
                del self._announced[part], self._healthy_since_s[part]
                self._emit(Notice(self._middleware.now_s(), Severity.INFO, f"{part} works again", part))
