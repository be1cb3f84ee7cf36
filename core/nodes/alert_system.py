"""alert_system: judges every configured signal, announces transitions, publishes its whole state."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, Callable, Dict, FrozenSet, List, Mapping, Optional, Set, Tuple, Union

from ..config.monitor_config import DEFAULT_SIGNALS, MonitorConfig, described_parameters, is_whole_file, load_config
from ..config.signal_config import LINK, SignalConfig
from ..judge.causes import causes_first
from ..judge.continuity import Continuity, SignalHistory
from ..judge.element_signals import MOST_REFUSED
from ..judge.monitor import Monitor
from ..judge.sources import is_source
from ..judge.wording import source_text
from ..messages.dialect import Message
from ..port.graph import Counts, Unread, Wanted
from ..port.middleware import Middleware, Result, Severity, Subscription, Timer
from ..values.elements import ARRAY_TYPE, STATUS_TYPE, with_ages
from ..values.errors import ConfigError, ServiceError
from ..values.faults import Fault
from ..values.field_path import ABSENT
from ..values.formatting import printable
from ..values.goals import STATUS_TOPICS, Goals
from ..values.model import Changes, Level, Sample, Status, Transition
from ..values.names import resolve_name
from . import node
from .outlets import (
    Event,
    Notice,
    Outlet,
    Outlets,
    alert_message,
    array_message,
    event_severity,
    event_text,
    status_message,
)
from .self_monitor import CHECK_PERIOD_S, EMPTY_REPORT, LONGEST_STEP_S, SelfMonitor, SelfReport

TRIGGER_TYPE = "std_srvs/Trigger"
TICK_PERIOD_S = 1.0
"""Period of `Monitor.tick`, in seconds of the node's clock."""

_MAX_LIST = 10_000  # characters
_NO_SENSOR = "battery_sensor reports that its host has no such sensor"
_NO_OUTLETS: Mapping[str, Outlet] = MappingProxyType({})

_Source = Tuple[str, str, str, Optional[str]]
"""Where a signal comes from: its name, topic, type, and what is read of its messages."""


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
        history: Optional[SignalHistory] = None,
        announce_pauses: bool = True,
        silence_of: Callable[[str], Optional[str]] = lambda signal: None,
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
        self._excused_since_s: Optional[float] = None
        self._begun: Optional[Tuple[float, float]] = None
        """When a restored state began to count, until the first tick: in s, and in s of steady time."""
        self._node = node.base_name(middleware)
        given = middleware.given_parameters()
        self._watches_defaults = "signals" not in given and not is_whole_file(given)
        config, unknown = self._read_config(given)
        self._config = config
        self._left_out: Mapping[str, str] = {}
        """Why signals are not watched: nothing brings samples for them."""
        self._excess: Set[str] = set()
        self._simulated_topics = ""
        self._simulated: FrozenSet[str] = frozenset()
        self.robot = config.robot_name or node.host_name()
        self.node_name = middleware.name
        self.samples = 0
        """How many samples were received since the start."""
        self.monitor = Monitor(config, self.robot)
        """Judges the signals; read it to show their state."""
        self.silence_of = silence_of
        self._black_box_of = black_box_of
        self.outlets = Outlets(middleware.faults)
        """Receives every transition and notice; more outlets may be added at any time."""
        for name, outlet in outlets.items():
            self.outlets.add(name, outlet)
        if log_alerts:
            self.outlets.add("log", self._log)
        self.outlets.add("alerts", self._publish_alert)
        self.outlets.add(node.DIAGNOSTICS, self._publish_change)
        alerts = middleware.advertise("alerts", STATUS_TYPE)
        self_report = replace(
            self_report,
            published_topics=lambda: alerts,
            signals=self._count_signals,
            simulated=lambda: filter(self.is_simulated, self._config.signals),
            without_sensor=lambda: sorted(self._without_sensor()),
            silenced=self.count_silenced,
        )
        self.self_monitor = SelfMonitor(middleware, self.robot, TICK_PERIOD_S, self.outlets.emit, self_report)
        """Watches the node itself and makes its status."""
        self._continuity = None if history is None else Continuity(self.monitor, history)
        self._subscriptions: Dict[_Source, Subscription] = {}
        self._graph_timer: Optional[Timer] = None
        self._of_graph: Mapping[str, Wanted] = {}
        """What each signal of the robot's graph counts."""
        self._topics: Mapping[str, str] = {}
        """The resolved topic of each signal."""
        described = described_parameters(config, are_default=self._watches_defaults)
        middleware.declare_parameters(described, self._reconfigure)
        middleware.advertise(node.DIAGNOSTICS, ARRAY_TYPE)
        middleware.subscribe(node.SIMULATED_SENSORS, node.STRING_TYPE, self._note_simulated, field="data", latched=True)
        middleware.exclusively(lambda: self._begin(config, unknown))  # no message comes before the states are restored
        middleware.subscribe(node.UNAVAILABLE_SENSORS, node.STRING_TYPE, self._note_unavailable, field="data")
        middleware.advertise_service("~reset", TRIGGER_TYPE, lambda _: {"success": True, "message": self._reset()})
        self._tick_timer = middleware.create_timer(TICK_PERIOD_S, self._tick)
        self.on_tick: List[Callable[[float], None]] = []
        """Called with the time of each tick, in s."""
        middleware.create_timer(CHECK_PERIOD_S, self._check, steady=True)
        self._report_timer = middleware.create_timer(1.0 / config.publish_rate, self._report)
        self._reported_steady_s = middleware.steady_s()
        if self._watches_defaults:
            middleware.log(Severity.INFO, f"no signals configured: watching {', '.join(DEFAULT_SIGNALS)}")
        for name, signal in config.signals.items():
            if name not in self._left_out:
                middleware.log(Severity.INFO, f"watching {source_text(signal, self._topics.get(name, ''))}")
        latching = [name for name, signal in config.signals.items() if signal.latch]
        if latching and (history is None or not history.is_kept):
            text = f"no history: latched alerts of an earlier run are not restored ({', '.join(latching)})"
            middleware.log(Severity.INFO, text)

    def _begin(self, config: MonitorConfig, unknown: Mapping[str, str]) -> None:
        """Subscribes, and continues from the saved states."""
        self._follow_topics(config, unknown)
        self._leave_out(unknown, self._middleware.now_s())
        if self._continuity is not None:
            now_s = self._middleware.now_s()
            self._continuity.record_configuration(config)
            self._begun = now_s, self._middleware.steady_s()
            restored = self._continuity.restore(now_s, at_first_call=self._middleware.waiting_for_clock())
            self._announce(restored, now_s)

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
    def configuration(self) -> MonitorConfig:
        """The configuration in force, with the signals that have no sensor."""
        return self._config

    def diagnostics(self, now_s: float) -> Message:
        """Returns the whole state, as it is published on /diagnostics."""
        signals = self.monitor.report(now_s).statuses.values()
        return array_message([*map(self._with_silence, signals), self.self_monitor.status()], self._node)

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

    def status(self, signal: str) -> Optional[Status]:
        """Returns the status of a signal, with its silence; None if it is unknown or before the first call."""
        status = self.monitor.status(signal, self._middleware.now_s())
        return None if status is None else self._with_silence(status)

    def _count_signals(self) -> int:
        """Counts the watched signals, with elements and without silent topics."""
        monitor = self.monitor
        return sum(not is_source(name) for name in monitor.configs()) or len(monitor.config.signals)

    def count_silenced(self) -> int:
        """Counts the signals that are not OK and silenced."""
        now_s = self._middleware.now_s()
        silenced = [name for name in self.monitor.signals() if self.silence_of(name) is not None]
        statuses = [self.monitor.status(name, now_s) for name in silenced]
        return sum(1 for status in statuses if status is not None and status.level is not Level.OK)

    def is_simulated(self, signal: str) -> bool:
        """Returns whether battery_sensor invents the values of a signal or source. May be called in any thread."""
        # All elements of an array are of one topic.
        return signal.partition("[")[0] in self._simulated or signal in map(self._topics.get, self._simulated)

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

    def _save_all(self) -> None:
        if self._continuity is not None:
            now_s = self._middleware.now_s()
            self._continuity.save(now_s)
            self._continuity.record_samples(now_s)

    def close(self) -> None:
        """Saves the state for the next run and leaves the middleware."""
        self.save_state()
        self._middleware.close()

    def _follow_topics(self, config: MonitorConfig, unknown: Mapping[str, str]) -> None:
        """Subscribes to new topics, then ends old subscriptions; one that is refused is a ConfigError and no change."""
        wanted = {
            (name, topic, signal.type, signal.selection)
            for name, signal in config.signals.items()
            if name != LINK
            for topic in signal.topics
        }
        added: Dict[_Source, Subscription] = {}
        try:
            # Signals with a type and a field first: those that only count messages can share their subscription. Of one
            # message, they are handed over in this order: causes first.
            order = {name: place for place, name in enumerate(causes_first(config.signals))}
            new = wanted - self._subscriptions.keys()
            for source in sorted(new, key=lambda key: (key[3] is None, key[2] == "", order[key[0]])):
                name, topic, type_name, field = source
                if config.signals[name].action:
                    take = partial(self._take_goals, name, Goals())
                    # The last message says which goals had ended before.
                    subscription = self._middleware.subscribe(topic, type_name, take, latched=True)
                else:
                    take = partial(self._take, name)
                    # Frames that never move are published once.
                    latched = topic.endswith("tf_static")
                    subscription = self._middleware.subscribe(topic, type_name, take, field=field, latched=latched)
                added[source] = subscription
        except ConfigError as error:
            for subscription in added.values():
                self._middleware.unsubscribe(subscription)
            raise ConfigError(error.problem, ("signals", name)) from None
        for source in self._subscriptions.keys() - wanted:
            self._middleware.unsubscribe(self._subscriptions.pop(source))
        self._subscriptions.update(added)
        self._topics = {
            key[0]: _source_name(config.signals[key[0]], subscription)
            for key, subscription in self._subscriptions.items()
        }
        self.monitor.expect_sources({config.signals[name].topic: topic for name, topic in self._topics.items()})
        self._simulated = frozenset(self._signals_on(self._simulated_topics))
        counted = {name: signal.graph for name, signal in config.signals.items() if name not in unknown}
        self._follow_graph({name: graph for name, graph in counted.items() if graph is not None})

    def _follow_graph(self, of_graph: Mapping[str, Wanted]) -> None:
        self._of_graph = of_graph
        if of_graph and self._graph_timer is None:
            self._graph_timer = self._middleware.follow_graph(lambda: set(self._of_graph.values()), self._take_graph)
        elif not of_graph and self._graph_timer is not None:
            self._graph_timer.cancel()
            self._graph_timer = None

    def _take_graph(self, counts: Union[Counts, Unread], now_s: float) -> None:
        """Judges what was counted in the robot's graph, or notes why it cannot be read."""
        others = {name: reason for name, reason in self._left_out.items() if name not in self._of_graph}
        if isinstance(counts, Unread) and not counts.is_watched:
            others.update(dict.fromkeys(self._of_graph, counts.reason))
        self._leave_out(others, now_s)
        for name, wanted in self._of_graph.items():
            if isinstance(counts, Unread):
                self.monitor.note_hint(name, counts.reason)
            elif wanted in counts:
                self._announce(self.monitor.observe_value(name, counts[wanted], now_s), now_s)

    def _take(self, name: str, value: Any, now_s: float) -> None:
        """Judges a message on the topic of a signal; it may hold no sample of it."""
        self.samples += 1
        if name in self._left_out:
            self._leave_out({other: reason for other, reason in self._left_out.items() if other != name}, now_s)
        if self._excused_since_s is not None or now_s > self.self_monitor.look_due_s:
            self._look_for_pause(now_s)
            self._excused_since_s = None
        if value is ABSENT:
            changes = self.monitor.observe_source(self._topics[name], now_s)
        else:
            if type(value) is not float:
                value = with_ages(value, self._middleware.stamp_s)
            changes = self.monitor.observe_value(name, value, now_s)
        if changes or changes.notices:
            self._announce(changes, now_s)

    def _take_goals(self, name: str, goals: Goals, message: Any, now_s: float) -> None:
        """Judges each goal of an action that ended."""
        for value in goals.take(message) or (ABSENT,):
            self._take(name, value, now_s)

    def _note_unavailable(self, metrics: Any, now_s: float) -> None:
        """Applies the list from battery_sensor: signals that no sensor will ever publish are not watched."""
        signals = self._signals_on(metrics)
        # A signal that has had a sample has a sensor: its silence is an alert.
        known = self._without_sensor()
        new = signals - known
        judgements = self.monitor.judgements(now_s) if new else {}
        unseen = {name for name in new if name not in judgements or not judgements[name].seen}
        others = {name: reason for name, reason in self._left_out.items() if name not in known}
        self._leave_out({**others, **dict.fromkeys((known & signals) | unseen, _NO_SENSOR)}, now_s)

    def _without_sensor(self) -> Set[str]:
        return {name for name, reason in self._left_out.items() if reason == _NO_SENSOR}

    def _note_simulated(self, topics: Any, now_s: float) -> None:
        """Applies the list from battery_sensor, which comes every second."""
        if topics != self._simulated_topics:
            self._simulated_topics = topics
            self._simulated = frozenset(self._signals_on(topics))

    def _signals_on(self, names: Any) -> Set[str]:
        """Returns the signals on the topics of a list from battery_sensor."""
        given = [name.strip() for name in str(names)[:_MAX_LIST].split(",")]
        topics = {resolve_name(name, self._middleware.name) for name in given if name}
        return {name for name, topic in tuple(self._topics.items()) if topic in topics}

    def _leave_out(self, left_out: Mapping[str, str], now_s: float) -> None:
        """Watches all signals but these, which have a reason each; names each signal of which that changes."""
        before, self._left_out = self._left_out, left_out
        for name in sorted(left_out.keys() - before.keys()):
            self.outlets.emit(Notice(now_s, Severity.INFO, f"{name} is not watched: {left_out[name]}"))
        for name in sorted(before.keys() - left_out.keys()):
            self.outlets.emit(Notice(now_s, Severity.INFO, f"{name} is watched again"))
        if left_out.keys() != before.keys():
            self._configure_monitor(now_s)

    def _configure_monitor(self, now_s: float) -> None:
        """Watches all signals but those that are left out."""
        self._record_samples(now_s)
        self._announce(self.monitor.configure(self._watched()), now_s)

    def _watched(self) -> MonitorConfig:
        """Returns the configuration without the signals that are left out."""
        signals = {name: signal for name, signal in self._config.signals.items() if name not in self._left_out}
        return replace(self._config, signals=signals)

    def _record_samples(self, now_s: float) -> None:
        """Stores the samples of signals that may leave the configuration."""
        if self._continuity is not None:
            self._middleware.faults.guard("storing samples", self._continuity.record_samples, now_s)

    def _look_for_pause(self, now_s: float) -> None:
        """Leaves the time out in which the process was stopped: it is no silence of the robot."""
        since_s = self.self_monitor.find_pause(now_s, announce=self._announce_pauses)
        if since_s is None and self._excused_since_s is not None:
            since_s = self._excused_since_s
            self._excused_since_s = now_s
        if since_s is not None:
            self._announce(self.monitor.skip(since_s, now_s), now_s)

    def tick_with(self, topic: str) -> None:
        """Ticks with each message on a topic, not by a timer: a black box has a message for each tick."""
        self._tick_timer.cancel()
        self._middleware.subscribe(topic, "", lambda _, now_s: self._tick(now_s), field=None)

    def _tick(self, now_s: float) -> None:
        self._look_for_pause(now_s)
        if self._begun is not None:
            (begun_s, steady_s), self._begun = self._begun, None
            if self._middleware.steady_s() - steady_s > LONGEST_STEP_S:  # a start on a busy machine is no silence
                self._announce(self.monitor.skip(begun_s, now_s), now_s)
        for note in self.on_tick:
            note(now_s)
        self.self_monitor.note_tick(now_s)
        self._middleware.faults.guard("hints", self._look_up_hints, now_s)
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

    def _look_up_hints(self, now_s: float) -> None:
        """Looks up why signals have no samples, before they are announced as STALE."""
        for config in self.monitor.without_samples(now_s):
            self.monitor.note_hint(config.name, self._middleware.why_silent(config.topics[0], config.type) or "")

    def _check(self, now_s: float) -> None:
        """Runs on steady time."""
        self._look_for_pause(now_s)
        self.self_monitor.check(self.samples)
        # Without /clock, and while a simulator is paused, the timer of the report stands still.
        overdue_s = self._middleware.steady_s() - self._reported_steady_s
        if overdue_s > 1.0 / self._config.publish_rate + CHECK_PERIOD_S:
            self._report(now_s)

    def _report(self, now_s: float) -> None:
        self._reported_steady_s = self._middleware.steady_s()
        self._middleware.faults.guard("diagnostics", self._publish_report, now_s)

    def _publish_report(self, now_s: float) -> None:
        if self._middleware.has_listeners(node.DIAGNOSTICS):
            self._middleware.publish(node.DIAGNOSTICS, self.diagnostics(now_s))

    def _announce(self, changes: Changes, now_s: float) -> None:
        for text in changes.notices:
            self.outlets.emit(Notice(now_s, Severity.INFO, text))
        effects = self.monitor.effects() if changes else {}
        for transition in changes:
            affects = len(effects.get(transition.signal, ()))
            transition = replace(transition, affects=affects, black_box=self._black_box_of(transition))
            if self._continuity is not None:  # no failure of a history may keep an alert from the outlets
                self._middleware.faults.guard("storing an alert", self._continuity.record, transition)
            self.outlets.emit(transition)

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
            self._publish_statuses(self._with_silence(event.status))
        elif event.part:
            self._publish_statuses(self.self_monitor.status())

    def _publish_statuses(self, *statuses: Status) -> None:
        self._middleware.publish(node.DIAGNOSTICS, array_message(statuses, self._node))

    def _with_silence(self, status: Status) -> Status:
        text = self.silence_of(status.name)
        return status if text is None else replace(status, values={**status.values, "silenced": text}, silence=text)

    def _reset(self) -> str:
        now_s, transitions = self._middleware.now_s(), self.monitor.reset()
        self._announce(transitions, now_s)
        if self._continuity is not None:
            self._middleware.faults.guard("storing the reset", self._continuity.record_reset, now_s)
        cleared = ", ".join(transition.signal for transition in transitions) or "nothing was latched"
        return f"reset: {cleared}"

    def _read_config(self, tree: Mapping[str, Any]) -> Tuple[MonitorConfig, Mapping[str, str]]:
        """Reads the configuration in a tree, which has changes of the default signals if the node began with none.

        Also returns why signals of the robot's graph cannot be watched here.
        """
        signals = tree.get("signals", {})
        if self._watches_defaults and isinstance(signals, Mapping):
            merged = dict(DEFAULT_SIGNALS)
            for name, given in signals.items():
                changes_default = name in merged and isinstance(given, Mapping)
                merged[name] = {**merged[name], **given} if changes_default else given
            tree = {**tree, "signals": merged}
        config = load_config(tree)
        resolved: Dict[str, SignalConfig] = {}
        unknown: Dict[str, str] = {}
        for name, signal in config.signals.items():
            if signal.graph is not None:
                key, graph_name = signal.graph
                try:
                    changed: Mapping[str, Any] = {key: self._middleware.graph_name(key, graph_name)}
                    resolved[name] = replace(signal, **changed)
                except ServiceError as error:
                    unknown[name] = str(error)
                except ConfigError as error:
                    raise ConfigError(error.problem, ("signals", name, key)) from None
        return replace(config, signals={**config.signals, **resolved}), unknown

    def _reconfigure(self, tree: Mapping[str, Any]) -> str:
        old = self._config
        config, unknown = self._read_config(tree)
        given = self._middleware.given_parameters()
        node.refuse_changes(given, tree)
        self._follow_topics(config, unknown)
        if config.publish_rate != old.publish_rate:
            self._report_timer.cancel()
            self._report_timer = self._middleware.create_timer(1.0 / config.publish_rate, self._report)
        self._config = config
        if self._continuity is not None:
            record = self._continuity.record_configuration
            self._middleware.faults.guard("storing the configuration", record, config)
        same = {name for name, signal in config.signals.items() if old.signals.get(name) == signal}
        now_s = self._middleware.now_s()
        self._left_out = {name: reason for name, reason in self._left_out.items() if name in same}
        self._leave_out({**self._left_out, **unknown}, now_s)
        self._configure_monitor(now_s)
        before = node.sections_of(old, log_level=given.get(node.LOG_LEVEL, "INFO"))
        return node.describe_changes(before, node.sections_of(config, log_level=tree.get(node.LOG_LEVEL, "INFO")))


def _source_name(config: SignalConfig, subscription: Subscription) -> str:
    """Returns the resolved topic of a signal; of an action, which has two, the resolved name."""
    ends = STATUS_TOPICS if config.action else ()
    return next(
        (subscription.topic[: -len(end)] for end in ends if subscription.topic.endswith(end)), subscription.topic
    )
