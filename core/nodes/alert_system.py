"""alert_system: judges every configured signal, announces transitions, publishes its whole state.

watched_signals.py   which signals are watched, and what brings their samples
this file            judging: samples, ticks, pauses, states for a restart
announcements.py     the outlets, the topic `alerts`, /diagnostics
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any, Callable, Mapping

from ..config import DEFAULT_SIGNALS, MonitorConfig, described_parameters, is_whole_file
from ..judge import MOST_REFUSED, Continuity, Monitor, SignalHistory, is_source, source_text
from ..port import Middleware, Result, Severity
from ..values import ABSENT, Fault, JsonObject, Level, Sample, Transition, with_ages
from . import node
from .announcements import Announcements
from .outlets import Outlet
from .self_monitor import CHECK_PERIOD_S, EMPTY_REPORT, SelfReport
from .watched_signals import WatchedSignals, read_config

TRIGGER_TYPE = "std_srvs/Trigger"
TICK_PERIOD_S = 1.0
"""Period of `Monitor.tick`, in seconds of the node's clock."""

_NO_OUTLETS: Mapping[str, Outlet] = MappingProxyType({})


class AlertSystem:
    """Judges every configured signal and emits each transition once to every outlet.

    The outlets: those given, then the log, the topic `alerts` and /diagnostics. The whole state is published on
    /diagnostics every second, with a status of the node itself.
    """

    def __init__(
        self,
        middleware: Middleware,
        outlets: Mapping[str, Outlet] = _NO_OUTLETS,
        *,
        log_alerts: bool = True,
        history: SignalHistory | None = None,
        announce_pauses: bool = True,
        silence_of: Callable[[str], str | None] = lambda signal: None,
        black_box_of: Callable[[Transition], str] = lambda transition: "",
        self_report: SelfReport = EMPTY_REPORT,
    ) -> None:
        """Starts watching; raises ConfigError if the configuration cannot be used.

        Args:
            middleware: the node's connection.
            outlets: further receivers of events, by name. They come before the standard outlets.
            log_alerts: write events to the middleware's log. False where an outlet shows them.
            history: gives the states to continue from, and stores each transition before any outlet receives it.
            announce_pauses: emit a notice after the process was stopped. False where another part does so.
            silence_of: returns the text of the silence of a signal, None without one. Must be fast.
            black_box_of: returns the name of the file that records a transition, empty if none does. Must be fast.
            self_report: what the node's own status shows of other parts of the process.
        """
        self._middleware = middleware
        self._announce_pauses = announce_pauses
        self._excused_since_s: float | None = None
        given = middleware.given_parameters()
        self._watches_defaults = "signals" not in given and not is_whole_file(given)
        config, unknown = read_config(middleware, given, adds_defaults=self._watches_defaults)
        self._excess: set[str] = set()
        self.robot = config.robot_name or node.host_name()
        self.node_name = middleware.name
        self.samples = 0
        """How many samples were received since the start."""
        self.monitor = Monitor(config, self.robot)
        """Judges the signals; read it to show their state."""
        self._continuity = None if history is None else Continuity(self.monitor, history)
        self.announcements = Announcements(
            middleware,
            self.monitor,
            outlets,
            {
                **self_report,
                "signals": self._count_signals,
                "simulated": lambda: filter(self.watched.is_simulated, self.configuration.signals),
                "without_sensor": lambda: sorted(self.watched.without_sensor),
            },
            log_alerts=log_alerts,
            continuity=self._continuity,
            silence_of=silence_of,
            black_box_of=black_box_of,
        )
        self.outlets = self.announcements.outlets
        """Receives every transition and notice; more outlets may be added at any time."""
        self.silence_of = silence_of
        self.self_monitor = self.announcements.self_monitor
        self._announce = self.announcements.announce
        self.watched = WatchedSignals(middleware, self.monitor, self._take, self.announcements.note, self._configure)
        described = described_parameters(tuple(config.signals), are_default=self._watches_defaults)
        middleware.declare_parameters(described, self._reconfigure)
        note_simulated, note_unavailable = self.watched.note_simulated, self.watched.note_unavailable
        middleware.subscribe(node.SIMULATED_SENSORS, node.STRING_TYPE, note_simulated, field="data", latched=True)
        middleware.exclusively(lambda: self._begin(unknown))  # no message comes before the states are restored
        middleware.subscribe(node.UNAVAILABLE_SENSORS, node.STRING_TYPE, note_unavailable, field="data")
        middleware.advertise_service("~reset", TRIGGER_TYPE, lambda _: {"success": True, "message": self._reset()})
        self._tick_timer = middleware.create_timer(TICK_PERIOD_S, self._tick)
        self.on_tick: list[Callable[[float], None]] = []
        """Called with the time of each tick, in s."""
        middleware.create_timer(CHECK_PERIOD_S, self._check, steady=True)
        self.announcements.set_rate(config.publish_rate)
        if self._watches_defaults:
            middleware.log(Severity.INFO, f"no signals configured: watching {', '.join(DEFAULT_SIGNALS)}")
        for name, signal in config.signals.items():
            if name not in self.watched.left_out:
                middleware.log(Severity.INFO, f"watching {source_text(signal, self.watched.topics.get(name, ''))}")

    def _begin(self, unknown: Mapping[str, str]) -> None:
        """Subscribes, and continues from the saved states."""
        now_s, config = self._middleware.now_s(), self.configuration
        self.watched.follow(config, unknown)
        self.watched.change_to(config, unknown, now_s)
        if self._continuity is not None:
            self._continuity.record_configuration(config)
            self.self_monitor.find_pause(now_s)  # from now on: a start on a busy machine is no silence
            restored = self._continuity.restore(now_s, at_first_call=self._middleware.waiting_for_clock())
            self._announce(restored, now_s)

    @property
    def configuration(self) -> MonitorConfig:
        """The configuration in force, with the signals that are left out."""
        return self.watched.config

    def observe(self, sample: Sample) -> None:
        """Judges a sample that does not come from a topic, such as that of the signal `link`."""
        self.samples += 1
        self._look_for_pause(sample.now_s)
        self._announce(self.monitor.observe(sample), sample.now_s)

    def observe_link(self, up: bool, cause: str = "") -> None:
        """Judges the signal `link`: whether the robot can be reached, and if not, why, empty if that is unknown."""
        now_s = self._middleware.now_s()
        self._look_for_pause(now_s)
        self._excused_since_s = None
        self._announce(self.monitor.set_link(up, cause, now_s), now_s)

    def excuse_link(self) -> bool:
        """Returns whether a connection to the robot broke because this process was stopped; call when it breaks.

        That is no fault of the robot: call `observe_link` only after the next attempt to connect. Until then, or until
        a sample, the time counts for nothing.
        """
        now_s = self._middleware.now_s()
        self._look_for_pause(now_s)
        if not self.self_monitor.has_just_resumed:
            return False
        self._excused_since_s = now_s
        return True

    def skip(self, since_s: float, until_s: float) -> None:
        """Leaves a time out of durations and silences, as `Monitor.skip`. No ticks were due in it."""
        self.self_monitor.skip(until_s - since_s)
        self._announce(self.monitor.skip(since_s, until_s), until_s)

    @property
    def tick_age_s(self) -> float:
        """Time since the last tick, in s; see `SelfMonitor.tick_age_s`. May be read in any thread."""
        return self.self_monitor.tick_age_s

    def read(self, function: Callable[[Monitor, float], Result]) -> Result:
        """Calls `function(monitor, now_s)` while nothing changes the monitor. For code in other threads."""
        return self._middleware.exclusively(lambda: function(self.monitor, self._middleware.now_s()))

    def own_faults(self) -> Mapping[str, Fault]:
        """Returns the present faults of the node itself, by part. May be called in any thread."""
        return self._middleware.faults.current()

    def reset(self) -> str:
        """Clears latched alerts, as the service `~reset`; returns its message. May be called in any thread."""
        return self._middleware.exclusively(self._reset)

    def stop_watching(self) -> None:
        """Ends every open alert with a transition to OK, `no longer watched`; `close` must follow."""
        now_s = self._middleware.now_s()
        self._record_samples(now_s)
        self._announce(self.monitor.end(), now_s)
        if self._continuity is not None:
            self._continuity.forget()

    def save_state(self) -> None:
        """Saves the state for the next run. For processes that close all their middlewares at once."""
        self._middleware.exclusively(self._save_all)

    def close(self) -> None:
        """Saves the state for the next run and leaves the middleware."""
        self.save_state()
        self._middleware.close()

    def tick_with(self, topic: str) -> None:
        """Ticks with each message on a topic, not by a timer: a black box has a message for each tick."""
        self._tick_timer.cancel()
        self._middleware.subscribe(topic, "", lambda _, now_s: self._tick(now_s), field=None)

    def _take(self, name: str, value: Any, now_s: float) -> None:
        """Judges a message on the topic of a signal; it may hold no sample of it."""
        self.samples += 1
        if name in self.watched.left_out:
            self.watched.take_in(name, now_s)
        if self._excused_since_s is not None or now_s > self.self_monitor.look_due_s:
            self._look_for_pause(now_s)
            self._excused_since_s = None
        if value is ABSENT:
            changes = self.monitor.observe_source(self.watched.topics[name], now_s)
        else:
            if type(value) is not float:
                value = with_ages(value, self._middleware.stamp_s)
            changes = self.monitor.observe_value(name, value, now_s)
        if changes or changes.notices:
            self._announce(changes, now_s)

    def _look_for_pause(self, now_s: float) -> None:
        """Leaves the time out in which the process was stopped: it is no silence of the robot."""
        since_s = self.self_monitor.find_pause(now_s, announce=self._announce_pauses)
        if since_s is None and self._excused_since_s is not None:
            since_s = self._excused_since_s
            self._excused_since_s = now_s
        if since_s is not None:
            self._announce(self.monitor.skip(since_s, now_s), now_s)

    def _tick(self, now_s: float) -> None:
        self._look_for_pause(now_s)
        for note in self.on_tick:
            note(now_s)
        self.self_monitor.note_tick(now_s)
        self._middleware.faults.guard("hints", self.watched.look_up_hints, now_s)
        self._announce(self.monitor.tick(now_s), now_s)
        self._report_excess()
        if self._continuity is not None:
            self._middleware.faults.guard("storing the state", self._continuity.save, now_s)

    def _report_excess(self) -> None:
        """Reports as faults which signals have more elements than `max_elements`."""
        faults, excess = self._middleware.faults, self.monitor.excess_elements()
        for name in self._excess - excess.keys():
            faults.clear(f"elements of {name}")
        self._excess = set(excess)
        for name, number in excess.items():
            most = self.monitor.config.signals[name].max_elements
            more = "" if number < MOST_REFUSED else "at least "
            text = f"{more}{most + number} elements, the first {most} are watched (max_elements)"
            faults.report(f"elements of {name}", text, Level.WARN)

    def _check(self, now_s: float) -> None:
        """Runs on steady time."""
        self._look_for_pause(now_s)
        self.self_monitor.check(self.samples)

    def _count_signals(self) -> int:
        """Counts the watched signals, with elements and without silent topics."""
        monitor = self.monitor
        return sum(not is_source(name) for name in monitor.configs()) or len(monitor.config.signals)

    def _configure(self, config: MonitorConfig, now_s: float) -> None:
        """Judges the signals of a configuration from now on."""
        self._record_samples(now_s)
        self._announce(self.monitor.configure(config), now_s)

    def _record_samples(self, now_s: float) -> None:
        """Stores the samples of signals that may leave the configuration."""
        if self._continuity is not None:
            self._middleware.faults.guard("storing samples", self._continuity.record_samples, now_s)

    def _save_all(self) -> None:
        if self._continuity is not None:
            now_s = self._middleware.now_s()
            self._continuity.save(now_s)
            self._continuity.record_samples(now_s)

    def _reset(self) -> str:
        now_s, transitions = self._middleware.now_s(), self.monitor.reset()
        self._announce(transitions, now_s)
        if self._continuity is not None:
            self._middleware.faults.guard("storing the reset", self._continuity.record_reset, now_s)
        cleared = ", ".join(transition.signal for transition in transitions) or "nothing was latched"
        return f"reset: {cleared}"

    def _reconfigure(self, tree: JsonObject) -> str:
        old = self.configuration
        config, unknown = read_config(self._middleware, tree, adds_defaults=self._watches_defaults)
        given = self._middleware.given_parameters()
        node.refuse_changes(given, tree)
        self.watched.follow(config, unknown)
        self.announcements.set_rate(config.publish_rate)
        if self._continuity is not None:
            record = self._continuity.record_configuration
            self._middleware.faults.guard("storing the configuration", record, config)
        self.watched.change_to(config, unknown, self._middleware.now_s())
        before = node.sections_of(old, log_level=given.get(node.LOG_LEVEL, "INFO"))
        return node.describe_changes(before, node.sections_of(config, log_level=tree.get(node.LOG_LEVEL, "INFO")))
