"""Self-monitoring of alert_system: faults, clock, tick lateness, pauses, and the key-values of its status."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Callable, Dict, Iterable, Mapping, Optional, Tuple

from ..port.middleware import Middleware, Severity
from ..values.faults import summary_of
from ..values.formatting import duration_text, number_text
from ..values.model import Level, Status
from ..values.version import package_version
from .outlets import Notice, Outlet

MONITOR = "monitor"
"""Name of the status, which /diagnostics shows as `alert_system: monitor`."""

CHECK_PERIOD_S = 1.0
"""Period of `SelfMonitor.check`, in seconds of steady time."""

LONGEST_STEP_S = 3.0
"""If no callback looked at the time for longer, in seconds of steady time, the process was stopped."""

_RESUME_S = 5.0
"""What is found broken within this time after a pause, in seconds of steady time, broke because of it."""
_CLOCK_GRACE_S = 10.0
_CLOCK_REMINDER_S = 60.0
_MAX_LATENESS_S = 5.0
_MIN_HEALTHY_S = 3.0
"""How long a part must work before its fault is announced as ended; keeps an intermittent fault to one line."""


@dataclass(frozen=True)
class SelfReport:
    """The key-values of the status of a node: a function per key, called for each status. None: no such key."""

    version: Callable[[], str] = package_version
    uptime_s: Callable[[], float] = float
    """Since the start of the node, in s."""
    signals: Callable[[], int] = int
    """Number of watched signals."""
    samples_per_s: Callable[[], float] = float
    dropped: Callable[[], int] = int
    """Number of messages that were not judged."""
    tick_late_s: Callable[[], float] = float
    clients: Callable[[], int] = int
    """Number of clients of the server."""
    pending_notifications: Callable[[], int] = int
    published_topics: Callable[[], Optional[str]] = lambda: None
    """As `OWN_TOPICS` of core/values/elements.py."""
    simulated: Callable[[], Optional[Iterable[str]]] = lambda: None
    """Names of signals with invented values."""
    without_sensor: Callable[[], Optional[Iterable[str]]] = lambda: None
    """Names of signals that are not watched, because the host has no such sensor."""
    robots: Callable[[], Optional[int]] = lambda: None
    unreachable: Callable[[], Optional[int]] = lambda: None
    """Number of robots without a connection."""
    silenced: Callable[[], Optional[int]] = lambda: None
    """Number of signals that are not OK and silenced."""
    clients_dropped: Callable[[], Optional[int]] = lambda: None
    """Number of messages that the server dropped."""
    black_box_s: Callable[[], Optional[float]] = lambda: None
    """How far the messages of the black box in memory reach back, in s."""
    black_box_dropped: Callable[[], Optional[int]] = lambda: None
    """Number of messages that the black box dropped before their time, because its memory was full."""

    def texts(self) -> Mapping[str, str]:
        """Returns the key-values as /diagnostics shows them. A function that raises does not hide the others."""
        texts = {field.name: _text(field.name, getattr(self, field.name)) for field in fields(self)}
        return {key: text for key, text in texts.items() if text is not None}


EMPTY_REPORT = SelfReport()

_FORMATS: Mapping[str, Callable[[Any], str]] = {
    "uptime_s": "{:.0f}".format,
    "samples_per_s": number_text,
    "tick_late_s": "{:.3f}".format,
    "black_box_s": "{:.1f}".format,
    "simulated": ", ".join,
    "without_sensor": ", ".join,
}


def _text(key: str, read: Callable[[], object]) -> Optional[str]:
    try:
        value = read()
        return None if value is None else _FORMATS.get(key, str)(value)
    except Exception as error:
        return f"unknown ({type(error).__name__}: {error})"


class SelfMonitor:
    """Announces the faults of its node as notices and keeps the node's own status.

    Runs on steady time, so that it also works without /clock and while a simulator is paused.
    """

    def __init__(
        self, middleware: Middleware, robot: str, tick_period_s: float, emit: Outlet, report: SelfReport = EMPTY_REPORT
    ) -> None:
        """Starts without faults; `tick_period_s` is the expected period of `note_tick`.

        `emit` receives a notice when one of the middleware's `faults` begins or ends. `robot` is the `hardware_id` of
        the status, which shows `report` besides what is measured here.
        """
        self._middleware = middleware
        self._robot = robot
        self._tick_period_s = tick_period_s
        self._emit = emit
        self._start_s = self._checked_s = middleware.steady_s()
        self._announced: Dict[str, Level] = {}
        self._healthy_since_s: Dict[str, float] = {}
        self._clock_reminder_s = _CLOCK_GRACE_S
        self._samples = 0
        self._samples_per_s = 0.0
        self._tick_s: Optional[float] = None if middleware.waiting_for_clock() else middleware.now_s()
        self._tick_steady_s = self._start_s
        self._last_lateness_s = 0.0
        self._looked: Optional[Tuple[float, float]] = None
        self.look_due_s = math.inf
        """At a later time, in s, the process may have been stopped: call `find_pause` before anything else."""
        self._resumed_steady_s = -math.inf
        self._report = replace(
            report,
            uptime_s=lambda: middleware.steady_s() - self._start_s,
            samples_per_s=lambda: self._samples_per_s,
            tick_late_s=lambda: self._lateness_s(middleware.now_s(), middleware.steady_s()),
        )

    def find_pause(self, now_s: float, *, announce: bool = True) -> Optional[float]:
        """Returns the time of the last call, in s, if the process was stopped since; else None.

        Stopped by SIGSTOP, a debugger, a machine that swaps; not by a paused simulator: steady time goes on. Call at
        least every `CHECK_PERIOD_S` of steady time, before anything else is done with `now_s`.
        """
        steady_s, looked = self._middleware.steady_s(), self._looked
        self._looked = (now_s, steady_s)
        self.look_due_s = now_s + LONGEST_STEP_S
        if looked is None or steady_s - looked[1] <= LONGEST_STEP_S:
            return None
        self._resumed_steady_s = steady_s
        if self._tick_s is not None:
            self._tick_s, self._tick_steady_s = now_s, steady_s  # no tick could come
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
        steady_s = self._middleware.steady_s()
        self._last_lateness_s = self._lateness_s(now_s, steady_s)
        self._tick_s, self._tick_steady_s = now_s, steady_s

    def skip(self, duration_s: float) -> None:
        """Leaves a time in which no tick could come, in s, out of the time since the last tick."""
        if self._tick_s is not None:
            self._tick_s += duration_s
            self._tick_steady_s += duration_s
        if self._looked is not None:
            self._looked = (self._looked[0] + duration_s, self._looked[1] + duration_s)
            self.look_due_s += duration_s

    def check(self, samples: int) -> None:
        """Looks for faults that began or ended; call every `CHECK_PERIOD_S`, with the number of samples so far."""
        steady_s = self._middleware.steady_s()
        if steady_s > self._checked_s:
            self._samples_per_s = (samples - self._samples) / (steady_s - self._checked_s)
        self._samples, self._checked_s = samples, steady_s
        self._check_clock(steady_s - self._start_s)
        self._check_tick(steady_s)
        self._announce_faults(steady_s)

    @property
    def tick_age_s(self) -> float:
        """Time since the last tick, in s. Grows only while the node's clock and steady time both pass.

        While a simulator is paused, or before its first clock message, there are no ticks: then the time since the last
        `check` counts, which shows that the node runs.
        """
        steady_s = self._middleware.steady_s()
        since_check_s = steady_s - self._checked_s - CHECK_PERIOD_S
        return max(0.0, self._since_tick_s(self._middleware.now_s(), steady_s), since_check_s)

    def status(self) -> Status:
        """Returns the node's own status: its level is that of its worst fault."""
        faults = self._middleware.faults.current()
        values = {**self._report.texts(), **{f"fault: {part}": fault.text for part, fault in faults.items()}}
        level, message = summary_of(faults)
        return Status(MONITOR, level, message, self._robot, values)

    def _since_tick_s(self, now_s: float, steady_s: float) -> float:
        """Returns the time since the last tick, in s, by the slower clock: simulated time may run fast or be paused."""
        return 0.0 if self._tick_s is None else min(now_s - self._tick_s, steady_s - self._tick_steady_s)

    def _lateness_s(self, now_s: float, steady_s: float) -> float:
        """Returns by how much the tick is late, in s."""
        return max(0.0, self._since_tick_s(now_s, steady_s) - self._tick_period_s)

    def _check_clock(self, uptime_s: float) -> None:
        faults = self._middleware.faults
        if not self._middleware.waiting_for_clock():
            faults.clear("clock")
        elif uptime_s >= self._clock_reminder_s:
            text = f"use_sim_time is set, but /clock has been silent for {uptime_s:.0f} s: no signal is judged"
            faults.report("clock", text, Level.WARN)
            self._clock_reminder_s += _CLOCK_REMINDER_S
            self._announced.pop("clock", None)  # announces it again

    def _check_tick(self, steady_s: float) -> None:
        now_s = self._middleware.now_s()
        if self._middleware.waiting_for_clock():
            self._tick_s = None
        elif self._tick_s is None:
            self._tick_s, self._tick_steady_s = now_s, steady_s
        lateness_s = max(self._last_lateness_s, self._lateness_s(now_s, steady_s))
        if lateness_s > _MAX_LATENESS_S:
            text = f"{lateness_s:.1f} s late (period {self._tick_period_s:g} s): overloaded or suspended"
            self._middleware.faults.report("tick", text, Level.WARN)
        else:
            self._middleware.faults.clear("tick")
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
