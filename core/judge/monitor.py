"""The monitor of one robot: samples and time in, transitions and reports out.

It has no clock: every call takes the time. No sample and no time makes it raise.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import (
    AbstractSet,
    Callable,
    Iterable,
    KeysView,
    Mapping,
    Sequence,
)

from ..config import (
    CONDITIONS,
    LINK,
    LINK_CONFIG,
    Causes,
    MonitorConfig,
    SignalConfig,
    causes_of,
    is_element_name,
    template_name,
)
from ..values import Changes, ConfigError, Elements, Level, LinkDown, Report, Sample, Status, count_text, printable
from . import wording
from .alert import Alert
from .element_signals import ElementSignals, config_of, element_of, own_config, unconfigured
from .sample_summary import SampleCollector, SampleSummary
from .saved_state import Downtime, SavedSignal, SavedState, UnusableStateError
from .signal_monitor import SignalMonitor
from .sources import Source, Sources, is_source
from .window import Samples
from .wording import Judgement

_LARGEST = sys.float_info.max
_UNKNOWN = frozenset([""])
"""No causes: those that are active have to be found."""
_LINK_GRACE_S = 60.0
"""A restored link of which nothing is reported for this long is no longer watched."""


class Monitor:
    """Watches the signals of one robot.

    Times (`now_s`) are in seconds on any one clock. Calls return the transitions that they cause, in the order of the
    configuration; `reset`, `end` and `configure` at the time of the last call.

    Each topic that signals read is a source after `expect_sources`: silence of several signals that has one cause is
    one alert, whose name is a topic.

    The signal `link` (1.0 if the robot can be reached, else 0.0) needs no configuration. While the link is down,
    the other signals are frozen: the link is the one alert.
    """

    def __init__(self, config: MonitorConfig, robot: str = "") -> None:
        """Creates a monitor that has seen nothing; `robot` replaces the configuration's `robot_name`."""
        self.robot = robot or config.robot_name
        self.config = config
        self._watched: dict[str, SignalMonitor | ElementSignals] = {}
        """What is configured, and `link` once it was observed, by name."""
        self._signals: Mapping[str, SignalMonitor] = {}
        """All signals by name, in the order of the configuration; replaced, not changed, when elements come or go."""
        self._receivers: Mapping[str, SignalMonitor] = {}
        """Those that samples go to at once: all but templates, and signals whose source is not heard."""
        # NaN is not smaller than any time, so that the first call goes through _unusual_time.
        self._now_s = float("nan")
        self._sources = Sources(self.robot)
        self._causes = Causes({}, {})
        self._ticked: Sequence[SignalMonitor] = ()
        """All signals, causes before what they cause."""
        self._active: AbstractSet[str] = frozenset()
        """The causes that are not well."""
        self._followers: dict[str, list[SignalMonitor]] = {}
        """The signals with a condition on a signal, by its name; every cause and `link` are keys too."""
        self._link_down = False
        self._saved: tuple[Mapping[str, SavedSignal], Downtime] | None = None
        """The states of an earlier run and the time since then, until the first call."""
        self._resets = False
        """Whether latches are cleared when they are restored."""
        self._wall_offset_s = 0.0
        """The time in s since 1970 minus that of the calls, as of `take_samples`."""
        self._make_collector: Callable[[SignalMonitor], SampleCollector] | None = None
        """Returns what collects the samples of a signal; None if nothing does."""
        self._link_restored_s = math.inf
        """When the state of the link was restored, in seconds; infinite once it was observed."""

    def observe(self, sample: Sample) -> Changes:
        """Judges a sample; that of a signal that is not configured is ignored.

        The transitions are of the signal itself, of signals with a condition on it, and, for `link`, of all signals.
        """
        name, value, now_s = sample
        return self.observe_value(name, value, now_s)

    def observe_value(self, name: str, value: object, now_s: float) -> Changes:
        """As `observe` of a sample of these three; faster, for adapters with a message per call."""
        changes = Changes()
        if not self._now_s <= now_s <= _LARGEST:
            now_s = self._unusual_time(now_s, changes)
        self._now_s = now_s
        signal = self._receivers.get(name)
        if signal is None:
            signal = self._receiver(name, value, now_s, changes)
            if signal is None:
                return changes
        transition = signal.observe(value, now_s)
        if transition is not None:
            changes.append(transition)
        if name in self._followers:
            if name == LINK:
                self._follow_link(now_s, changes)
            self._follow(self._followers[name], now_s, changes)
        return self._with_effects(changes) if changes else changes

    def expect_sources(self, names: Mapping[str, str] = MappingProxyType({})) -> None:
        """Lets each topic of a watched signal be a source.

        `names` are the resolved names of topics that the configuration writes otherwise. Call it before the first call
        that has a time, and before `configure` if they change.
        """
        self._sources.expect(names)

    def observe_source(self, topic: str, now_s: float) -> Changes:
        """Notes that a message came on a topic, whatever it holds; its samples are for `observe`.

        Without `expect_sources`, it does nothing.
        """
        changes, now_s = self._advance(now_s)
        source = self._sources.get(self._sources.resolved(topic))
        if source is not None:
            if source.is_heard:
                source.staleness.arrive(now_s)
            else:
                self._hear(source, now_s, changes)
        return self._with_effects(changes)

    def set_link(self, up: bool, cause: str, now_s: float) -> Changes:
        """Judges a sample of the signal `link`: whether the robot can be reached, and why not (ignored while `up`)."""
        return self.observe_value(LINK, 1.0 if up else LinkDown(cause), now_s)

    def tick(self, now_s: float) -> Changes:
        """Advances the time."""
        changes, now_s = self._advance(now_s)
        self._tick_templates(now_s, changes)
        if self._sources and not self._link_down:
            if self._sources.tick(now_s, changes):
                self._find_receivers()
            self._look_at_causes(now_s, changes)
        for signal in self._ticked:
            changes.add(signal.tick(now_s))
            if signal.config.name in self._causes.names:
                self._look_at_causes(now_s, changes)
        self._follow(self._signals.values(), now_s, changes)
        if now_s - self._link_restored_s > _LINK_GRACE_S:
            self._link_restored_s = math.inf
            changes.add(self._signals[LINK].end(now_s))
            del self._watched[LINK]
            self._arrange()
        return self._with_effects(changes)

    def skip(self, since_s: float, until_s: float) -> Changes:
        """Leaves the time from `since_s`, or the last call, out of durations and silences: nothing is known of it.

        For the time between two recordings, or in which the process was stopped: it is no silence of the robot. Like
        downtime of the link (step 8 of docs/rules.md), but without an alert. Samples can come again from `until_s` on.
        """
        changes = Changes()
        if self._signals and self._now_s <= until_s <= _LARGEST and since_s <= until_s:
            since_s = max(since_s, self._now_s)
            for each in [self._signals[LINK]] if self._link_down else self._sources_and_signals():
                each.inhibit(since_s)
                changes.add(each.release(until_s, is_link=False))
            self._now_s = until_s
        return changes

    def report(self, now_s: float) -> Report:
        """Returns the whole state as of the last `observe` or `tick`, with ages at `now_s`. Reads only."""
        statuses = {name: wording.status(each) for name, each in self.judgements(now_s).items()}
        overall = Level.worst(status.level for status in statuses.values())
        return Report(overall, statuses, self._to_show(now_s)[0], self.robot)

    def excess_elements(self) -> Mapping[str, int]:
        """Returns how many elements beyond `max_elements` came lately, by signal; counted up to 1,000."""
        return {name: template.excess for name, template in self._templates().items() if template.excess}

    def judgements(self, now_s: float) -> Mapping[str, Judgement]:
        """Returns the state of every signal, without the texts of `report`. Reads only."""
        now_s, signals = self._to_show(now_s)
        effects = self.effects()
        judged = ((name, signal.judgement(now_s)) for name, signal in signals.items())
        return {name: each._replace(affects=len(effects.get(name, ()))) for name, each in judged}

    def causes(self) -> Mapping[str, str]:
        """Returns the nearest cause of each signal that has one, by its name."""
        return {name: signal.cause for name, signal in self._shown().items() if signal.cause}

    def effects(self) -> Mapping[str, Sequence[str]]:
        """Returns the signals that each alert keeps from being announced, directly or not, by its name."""
        effects: dict[str, list[str]] = {}
        for name, signal in self._signals.items():
            if signal.is_withheld:
                causes = {cause for cause in self._causes.of(name) if cause in self._active}
                sources = filter(None, map(self._sources.get, causes))
                for cause in sorted({signal.cause, *causes, *(source.alert for source in sources)}):
                    effects.setdefault(cause, []).append(name)
        return effects

    def _with_effects(self, changes: Changes) -> Changes:
        """Counts what each alert affects now."""
        effects = self.effects() if changes else {}
        if effects:
            changes[:] = [replace(each, affects=len(effects.get(each.signal, ()))) for each in changes]
        return changes

    @property
    def link_up(self) -> bool | None:
        """Whether the robot can be reached; None if it is not watched over a link."""
        return None if LINK not in self._signals else not self._link_down

    def status(self, signal: str, now_s: float) -> Status | None:
        """Returns the status of one signal as in `report`; None for an unknown signal or before the first call."""
        known = self._shown().get(signal)
        if known is None:
            return None
        judgement = known.judgement(self._to_show(now_s)[0])
        return wording.status(judgement._replace(affects=len(self.effects().get(signal, ()))))

    def levels(self) -> Mapping[str, tuple[Level, str]]:
        """Returns level and state of each signal, as in `report`, without the cost of texts."""
        return {name: (signal.level, signal.state) for name, signal in self._to_show(self._now_s)[1].items()}

    def without_samples(self, now_s: float) -> list[SignalConfig]:
        """Returns the signals whose topic has brought no message for half of the time allowed, while the link is up."""
        silent: list[SignalConfig] = []
        for source in self._sources:
            source.listen()
            if source.staleness.is_half_over(now_s):
                silent += [signal.config for signal in source.signals]
        return silent

    def note_hint(self, signal: str, hint: str) -> None:
        """Sets the hint of a signal without samples, until its next one (`Middleware.why_silent`); empty if unknown."""
        if signal in self._signals:
            self._signals[signal].staleness.note_hint(hint)
            source = self._sources.of_signal(signal)
            if source is not None and hint:
                source.staleness.note_hint(hint)

    def fresh_value(self, signal: str) -> float | None:
        """Returns a signal's latest value; None while there is none, or it is bad, stale or unreachable."""
        known = self._signals.get(signal)
        return None if known is None else known.latest_good

    def shown_samples(self, signal: str, limit: int = 300, since_s: float = -math.inf) -> Samples:
        """As `window_samples`, of the judged statistic: its values at ticks, at most 300, unless it is `last`."""
        known = self._signals.get(signal)
        return () if known is None else known.shown_samples(limit, since_s)

    def signals(self) -> KeysView[str]:
        """Returns the names of the signals, with `link` once it was observed; none before the first call.

        A source is among them while it is silent, unless its one signal is announced, and until its alert ends.
        """
        return self._shown().keys()

    def saved_signals(self) -> Sequence[str]:
        """Returns the names for `snapshot`: the signals, and the sources that were ever silent."""
        return [*self._signals, *(each.name for each in self._sources if each.was_silent or each.is_silent)]

    def quiet_sources(self) -> Mapping[str, Judgement]:
        """Returns the states of sources that are OK but were not once: they stay series of the metrics."""
        quiet = (each for each in self._sources if each.was_silent and not each.is_shown)
        return {each.name: each.judgement(self._now_s) for each in quiet}

    def configs(self) -> Mapping[str, SignalConfig]:
        """Returns the configuration of each of `signals()`, elements too; that of `link` is left out."""
        return {name: signal.config for name, signal in self._shown().items() if name != LINK}

    def window_samples(self, signal: str, limit: int = 300, since_s: float = -math.inf) -> Samples:
        """Returns the samples after a time in a signal's window; see `Window.samples`. Empty if it is unknown."""
        known = self._signals.get(signal)
        return () if known is None else known.window.samples(limit, since_s)

    def take_samples(self, now_s: float, wall_offset_s: float) -> Mapping[str, Sequence[SampleSummary]]:
        """Returns the periods of each signal that have ended and were not taken yet; the first call begins to collect.

        At an infinite time, the open period too: call it so before `configure` and `end`, since the samples of a signal
        that is no longer watched are gone. `wall_offset_s` is the time in s since 1970 minus that of the calls.
        """
        self._wall_offset_s = wall_offset_s
        if self._make_collector is None:
            offset_s = self._current_wall_offset_s  # one function for all signals
            self.collect_samples(lambda signal: SampleCollector(offset_s))
        collectors = ((name, signal.collector) for name, signal in self._signals.items())
        taken = ((name, each.take(now_s)) for name, each in collectors if each is not None)
        return {name: summaries for name, summaries in taken if summaries}

    def _current_wall_offset_s(self) -> float:
        return self._wall_offset_s

    def collect_samples(self, make: Callable[[SignalMonitor], SampleCollector]) -> None:
        """Passes every sample to a collector of its signal, which `make` returns, now or when an element comes."""
        self._make_collector = make
        self._arrange()

    def _collect(self, signal: SignalMonitor) -> None:
        if self._make_collector is not None and signal.collector is None:
            signal.collector = self._make_collector(signal)

    def at_rest_since_s(self, signal: str) -> float | None:
        """Returns since when a signal is OK; None unless its state depends on nothing else."""
        return self._signals[signal].at_rest_since_s if signal in self._signals else None

    def snapshot(self, signal: str, now_s: float, wall_s: float) -> SavedSignal:
        """Returns a state for `restore`, as JSON values; empty if not watched. `wall_s` is `now_s` in s since 1970."""
        known = self._signals.get(signal) or self._sources.get(signal)
        if known is None:
            return {}
        # Rounded, so that a state that has not changed is equal whenever it is saved.
        state = SavedState(now_s, {}, ahead_s=round(wall_s - now_s, 6))
        known.exchange(state)
        return {key: value for key, value in state.values.items() if value != {}}

    def restore(
        self,
        states: Mapping[str, SavedSignal],
        now_s: float | None,
        wall_s: float,
        stopped_s: float | None = None,
    ) -> Changes:
        """Continues from the snapshots of an earlier run, by signal. To be called before any other method.

        Nothing is announced again; a signal that was not OK and is no longer watched ends. A signal waits for its first
        sample; until then its durations stand still. Windows are empty. A state that cannot be used is ignored, with a
        notice. Without `now_s`, the time is that of the first call, which then returns the transitions. `wall_s` is the
        time in seconds since 1970, as is `stopped_s`: when the earlier run was last known to watch (None if until now).
        """
        downtime = Downtime(wall_s if stopped_s is None else min(stopped_s, wall_s), wall_s)
        self._saved = states, downtime
        return Changes() if now_s is None else self._advance(now_s)[0]

    def reset(self) -> Changes:
        """Clears every latch."""
        self._resets = self._saved is not None
        changes = Changes(filter(None, [signal.reset(self._now_s) for signal in self._signals.values()]))
        self._look_at_causes(self._now_s, changes)
        return changes

    def end(self) -> Changes:
        """Ends every alert, that of the link included: the robot is no longer watched."""
        changes = Changes(filter(None, [signal.end(self._now_s) for signal in self._shown().values()]))
        self._watched = {}
        self._sources.configure((), self._now_s, Changes())
        self._arrange()
        return changes

    def configure(self, config: MonitorConfig) -> Changes:
        """Applies a new configuration. Unchanged signals are not affected; alerts of removed signals end."""
        self.config = config
        changes = Changes()
        if not math.isnan(self._now_s):  # else before the first call
            self._follow_configuration(changes)
        return changes

    def _follow_configuration(self, changes: Changes) -> None:
        now_s, before, self._watched = self._now_s, self._watched, {}
        for name, config in self.config.signals.items():
            known = before.get(name)
            if config.is_template:
                known = known if isinstance(known, ElementSignals) else ElementSignals(config, self.robot, now_s)
                known.configure(config, now_s, changes)
            elif not isinstance(known, SignalMonitor):
                known = SignalMonitor(config, self.robot, now_s)
            elif known.config != config:
                changes.add(known.configure(config, now_s))
            self._watched[name] = known
        for name, each in before.items():
            if name == LINK:
                self._watched[LINK] = each
            elif self._watched.get(name) is not each:
                changes.extend(filter(None, (signal.end(now_s) for signal in _signals_in(each))))
        self._causes = causes_of(self.config.signals, self._sources.resolved)
        self._sources.configure(self.config.signals.values(), now_s, changes)
        self._arrange()
        self._inhibit_all(now_s)
        self._follow(self._signals.values(), now_s, changes)

    def _templates(self) -> Mapping[str, ElementSignals]:
        return {name: each for name, each in self._watched.items() if isinstance(each, ElementSignals)}

    def _to_show(self, now_s: float) -> tuple[float, Mapping[str, Alert]]:
        """Returns the time for ages, which is not before the last call, and the signals."""
        if not self._signals:
            now_s = now_s if -_LARGEST <= now_s <= _LARGEST else 0.0
            configs = map(own_config, self.config.signals.values())
            return now_s, {config.name: SignalMonitor(config, self.robot, now_s) for config in configs}
        return now_s if self._now_s <= now_s <= _LARGEST else self._now_s, self._shown()

    def _advance(self, now_s: float) -> tuple[Changes, float]:
        """Begins a call at a time; returns the changes that follow from it, and the time to use."""
        changes = Changes()
        if not self._now_s <= now_s <= _LARGEST:
            now_s = self._unusual_time(now_s, changes)
        self._now_s = now_s
        return changes, now_s

    def _unusual_time(self, now_s: float, changes: Changes) -> float:
        """Handles the first time, a time that went back, and an invalid time; returns the time to use."""
        if not -_LARGEST <= now_s <= _LARGEST:
            now_s = 0.0 if math.isnan(self._now_s) else self._now_s
        if math.isnan(self._now_s):
            self._start(now_s, changes)
        elif now_s < self._now_s:
            back_s = self._now_s - now_s
            changes.notices = (f"time went back by {back_s:.3f} s: windows, pending timers and staleness restart",)
            self._wall_offset_s += back_s
            for signal in self._sources_and_signals():
                signal.restart_time(now_s, back_s)
            self._arrange()
            for template in self._templates().values():
                template.restart_time(now_s)
        return float(now_s)

    def _start(self, now_s: float, changes: Changes) -> None:
        """Handles the first call: every signal begins to be watched."""
        self._now_s = now_s
        self._follow_configuration(changes)
        saved, self._saved = self._saved, None
        if saved is not None:
            self._continue(*saved, now_s, changes)
            if LINK in self._watched:
                self._link_restored_s = now_s
            self._arrange()
            if self._resets:
                changes.extend(self.reset())
        self._look_at_causes(now_s, changes)

    def _continue(self, states: Mapping[str, SavedSignal], downtime: Downtime, now_s: float, changes: Changes) -> None:
        """Continues from the states of an earlier run; what is not watched any more ends."""
        unusable: list[str] = []
        of_sources: dict[str, SavedSignal] = {}
        for name, saved in states.items():
            try:
                if is_source(name):
                    changes.add(self._sources.restore(name, saved, now_s, downtime))
                    of_sources[name] = saved
                    continue
                own = LINK_CONFIG if name == LINK else config_of(name, self.config.signals)
                signal = SignalMonitor(own or unconfigured(name), self.robot, now_s)
                signal.exchange(SavedState(now_s, saved, downtime))
            except (UnusableStateError, ConfigError) as error:
                shown = printable(str(name))[:80]
                unusable.append(f"{shown}: starts without its saved state: {printable(str(error))}")
                continue
            template = self._watched.get(template_name(name))
            if own is None or (isinstance(template, ElementSignals) and not template.restore(name, signal)):
                changes.add(signal.end(now_s))
            elif not isinstance(template, ElementSignals):
                self._watched[name] = signal
        self._sources.relate(of_sources, now_s, changes)
        if unusable:
            more = f" (and {count_text(len(unusable) - 1, 'other signal')})" if len(unusable) > 1 else ""
            changes.notices = (f"{unusable[0]}{more}",)

    def _arrange(self) -> None:
        """Puts the signals in the order of the configuration, after some were added or removed."""
        self._signals = {
            signal.config.name: signal
            for name in (*self.config.signals, LINK)
            for signal in _signals_in(self._watched.get(name))
        }
        self._sources.arrange(self._readers)
        self._find_receivers()
        self._ticked = [self._signals[name] for name in self._causes.first(self._signals)]
        self._active = _UNKNOWN
        self._followers = {cause: [] for cause in (*self._causes.names, LINK)}
        for signal in self._signals.values():
            self._collect(signal)
            for condition in filter(None, (getattr(signal.config, key) for key in CONDITIONS)):
                self._followers.setdefault(condition.signal, []).append(signal)

    def _find_receivers(self) -> None:
        signals = (
            (name, signal) for name, signal in self._signals.items() if signal is self._watched.get(name, signal)
        )
        self._receivers = {name: signal for name, signal in signals if self._sources.is_heard(name)}

    def _is_active(self, name: str) -> bool:
        """Whether a cause holds what depends on it: a signal is shown as ERROR or STALE, a source is silent."""
        source, signal = self._sources.get(name), self._signals.get(name)
        if source is not None:
            return source.is_silent
        return signal is not None and signal.level in (Level.ERROR, Level.STALE)

    def _look_at_causes(self, now_s: float, changes: Changes) -> None:
        """Holds what has a cause now, and lets settle what has none any more."""
        active = frozenset(filter(self._is_active, self._causes.names))
        if active != self._active:
            self._active = active
            for signal in self._ticked:
                self._note_cause(signal, now_s, changes)

    def _note_cause(self, signal: SignalMonitor, now_s: float, changes: Changes) -> None:
        cause = self._causes.nearest(signal.config.name, self._active)
        if cause != ("" if signal.held is None else signal.held.cause):
            changes.add(signal.note_cause(cause, now_s))

    def _shown(self) -> Mapping[str, Alert]:
        """Returns the signals, and before them the sources that are signals now."""
        shown = {each.name: each for each in self._sources if each.is_shown}
        return {**shown, **self._signals} if shown else self._signals

    def _readers(self, name: str) -> Sequence[SignalMonitor]:
        """Returns the signal of a name in the configuration; of a template its elements, or itself without any."""
        signals = _signals_in(self._watched.get(name))
        return signals[1:] or signals

    def _hear(self, source: Source, now_s: float, changes: Changes) -> None:
        """Processes a message of a source that is not heard: from now on, samples go to its signals at once."""
        self._sources.hear(source, now_s, changes)
        self._find_receivers()
        self._look_at_causes(now_s, changes)

    def _receiver(self, name: str, value: object, now_s: float, changes: Changes) -> SignalMonitor | None:
        """Returns the signal that judges a sample which does not go to it at once.

        None if it was of elements, which have judged it, or of no signal.
        """
        if name == LINK:
            signal = SignalMonitor(LINK_CONFIG, self.robot, now_s)
            self._watched[LINK] = signal
            self._arrange()
            return signal
        source = self._sources.of_signal(name)
        if source is not None and not source.is_heard:
            self._hear(source, now_s, changes)
            if name in self._receivers:
                return self._receivers[name]
        self._observe_elements(name, value, now_s, changes)
        return None

    def _observe_elements(self, name: str, value: object, now_s: float, changes: Changes) -> None:
        """Judges the elements that a template received, or the first sample of one under its full name."""
        template = self._watched.get(template_name(name))
        if not isinstance(template, ElementSignals) or not (is_element_name(name) or name in self._watched):
            return
        if name not in self._watched:
            value = Elements([(element_of(name), value)])
        number = len(template.signals)
        observed = template.observe(value, now_s, partial(self._begin, now_s=now_s, changes=changes), changes)
        if len(template.signals) > number:
            self._arrange()
        if len(template.signals) > number or template.own.staleness.waiting:
            template.count(now_s, changes)
        for signal in observed if self._followers else ():
            if signal.config.name in self._followers:
                self._follow(self._followers[signal.config.name], now_s, changes)

    def _begin(self, signal: SignalMonitor, now_s: float, changes: Changes) -> None:
        """Brings a new signal to the state of the others: the link, and its conditions on other signals."""
        self._collect(signal)
        if self._link_down:
            signal.inhibit(now_s)
        changes.add(signal.follow(self.fresh_value, now_s))
        self._note_cause(signal, now_s, changes)

    def _tick_templates(self, now_s: float, changes: Changes) -> None:
        """Ends silent elements and counts the others."""
        templates = self._templates().values()
        ended = [template.forget_silent(now_s, changes) for template in templates]
        for template in () if self._link_down else templates:
            template.count(now_s, changes)
        if any(ended):
            self._arrange()

    def _follow(self, followers: Iterable[SignalMonitor], now_s: float, changes: Changes) -> None:
        for follower in followers:
            changes.add(follower.follow(self.fresh_value, now_s))
        self._look_at_causes(now_s, changes)

    def _follow_link(self, now_s: float, changes: Changes) -> None:
        """Freezes the other signals while the link is down, whether or not its alert is held or withheld."""
        self._link_restored_s = math.inf
        up = self.fresh_value(LINK)
        down = up is None or up < 1.0
        if down is self._link_down:
            return
        self._link_down = down
        self._inhibit_all(now_s)
        for each in () if down else self._behind_link():
            changes.add(each.release(now_s, is_link=True))
        self._follow(self._signals.values(), now_s, changes)

    def _inhibit_all(self, now_s: float) -> None:
        """Freezes the signals that are not frozen yet, while the link is down."""
        for each in self._behind_link() if self._link_down else ():
            each.inhibit(now_s)

    def _behind_link(self) -> Sequence[Source | SignalMonitor]:
        return [each for each in self._sources_and_signals() if each.config.name != LINK]

    def _sources_and_signals(self) -> Sequence[Source | SignalMonitor]:
        return [*self._sources, *self._signals.values()]


def _signals_in(watched: SignalMonitor | ElementSignals | None) -> list[SignalMonitor]:
    """Returns a signal, or a template with its elements; nothing for None."""
    if isinstance(watched, ElementSignals):
        return [watched.own, *watched.signals.values()]
    return [] if watched is None else [watched]
