"""Judges recordings by one or several configurations in one pass.

Each configuration has its own alert_system, and all of them run on one `Player`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Callable, Mapping, NamedTuple, Sequence

from ..core.config import DEFAULT_SIGNALS, LINK, Section, SignalConfig, read_monitor, read_signal, template_name
from ..core.judge import (
    NO_SAMPLES,
    TICKS,
    Monitor,
    SampleCollector,
    SampleSummary,
    SavedMonitor,
    SignalMonitor,
    is_source,
    own_config,
)
from ..core.nodes import AlertSystem
from ..core.nodes.outlets import Event
from ..core.values import JsonObject, Level, Transition, resolve_name
from .middleware import Player

_OF_SOURCE = read_signal("source", {"field": "", "stale_after_s": 0.0})


class JudgedEvent(NamedTuple):
    """What an alert_system announced."""

    wall_s: float
    """Log time of the message or tick that caused it, in s since 1970."""
    file: str
    """Name of the configuration."""
    event: Event
    effects: Sequence[str] = ()
    """Names of the signals that an alert keeps from being announced, where it begins; more may come later."""


class JudgedSample(NamedTuple):
    """A sample of one signal as its monitor judged it."""

    wall_s: float
    """Log time in s since 1970."""
    now_s: float
    """The node's time in s, which differs from the log time with simulated time."""
    value: float | None
    """Value in the signal's unit; None for a bad sample."""
    judged: float | None
    """Value of the statistic that the bounds apply to; None for a bad sample, and while it is undefined."""


@dataclass
class SignalSummary:
    """How one configuration judged one signal; samples, shares, `unknown` and `cause` are there after `finish`.

    Times are log times minus the time that was skipped before them.
    """

    file: str  # name of the configuration
    config: SignalConfig
    topic: str  # the absolute one
    recorded: bool  # whether the recordings have its topic, with its type
    missing: str
    """Why it was not judged: it is not recorded, or has no sample that can be read; empty if it was."""
    samples: SampleSummary = NO_SAMPLES
    """All of them; the values are those of the signal's statistic, in its unit (`judged_unit`)."""
    longest_gap_s: float | None = None
    """Between two samples in a row; None with fewer than two."""
    shares: Mapping[Level, float] = field(default_factory=dict)
    """Share of the recorded time per announced level, 0 to 1; empty if it was never known."""
    unknown: float = 1.0
    """Share of the recorded time before the first sample or alert, 0 to 1."""
    alerts: int = 0  # an alert that changes its level counts once
    cause: str = ""  # the latest alert of which it was an effect, if it was not announced itself
    effects: list[str] = field(default_factory=list)  # of its latest alert

    level: Level = Level.OK  # the announced one
    since_s: float | None = None  # since when it is known that it has this level
    begun_s: float = -math.inf  # when its latest alert began
    caused: tuple[float, str] = (-math.inf, "")  # begin and name of the latest alert of which it was an effect
    _collector: SampleCollector = field(default_factory=SampleCollector)
    _last_s: float | None = None
    """When the latest sample came."""
    _lasted_s: dict[Level, float] = field(default_factory=lambda: dict.fromkeys(Level, 0.0))

    def note_sample(self, played_s: float, value: float | None, good: bool) -> None:
        """Notes a sample; with the first one it is OK, unless an alert came before."""
        self._collector.note(value, played_s, good=good)
        last_s, self._last_s = self._last_s, played_s
        if last_s is not None and (self.longest_gap_s is None or played_s - last_s > self.longest_gap_s):
            self.longest_gap_s = played_s - last_s
        if self.since_s is None:
            self.since_s = played_s

    def note(self, transition: Transition, played_s: float) -> None:
        """Notes what was announced."""
        if transition.repeat:
            return
        if self.since_s is None and is_source(transition.signal):
            self.since_s = played_s - (transition.now_s - transition.since_s)
        self._end_level(played_s)
        if transition.from_level is Level.OK:
            self.alerts += 1
            self.effects, self.begun_s = [], played_s
        self.level = transition.to_level

    def finish(self, begin_s: float, end_s: float) -> None:
        """Completes the summary of the time between two others."""
        if self.since_s is not None:
            self._end_level(end_s)
        total_s, known_s = end_s - begin_s, sum(self._lasted_s.values())
        if known_s > 0.0:
            self.shares = {level: lasted_s / total_s for level, lasted_s in self._lasted_s.items()}
        unknown = 1.0 - min(known_s / total_s, 1.0) if total_s > 0.0 else 1.0
        self.unknown = 0.0 if unknown < 1e-9 else unknown
        if known_s <= self._lasted_s[Level.OK]:
            self.cause = self.caused[1]
        (self.samples,) = self._collector.take(math.inf) or [NO_SAMPLES]
        if self.samples is NO_SAMPLES and not is_source(self.config.name):
            self.missing = self.missing or f"{self.topic} has no samples"

    def _end_level(self, played_s: float) -> None:
        self._lasted_s[self.level] += played_s - (played_s if self.since_s is None else self.since_s)
        self.since_s = played_s


OnEvent = Callable[[JudgedEvent], None]
OnSample = Callable[[str, SignalConfig, JudgedSample], None]
"""Receives the configuration's name, the signal, and each of its samples."""


class Judge:
    """Runs an alert_system for each configuration on one player."""

    def __init__(self, player: Player, on_event: OnEvent, on_sample: OnSample | None = None) -> None:
        """`on_event` receives transitions and notices with times; it must not raise, nor must `on_sample`."""
        self._player = player
        self._on_event = on_event
        self._on_sample = on_sample
        self._signals: dict[tuple[str, str], SignalSummary] = {}
        self._templates: dict[tuple[str, str], SignalConfig] = {}
        self._begin_s = player.wall_s
        self._skipped_s = 0.0
        player.on_gap.append(self._skip)

    def add(self, file: str, parameters: JsonObject, saved: SavedMonitor | None = None) -> None:
        """Adds a configuration: its name, and the mapping under `ros__parameters` of alert_system.

        It continues from the `saved` states of its signals, which are those at the beginning.
        Raises ConfigError, with a path below that, if it cannot be used, or a field is not in the recorded type.
        """
        tree = parameters if "signals" in parameters else {**parameters, "signals": DEFAULT_SIGNALS}
        config = read_monitor(Section((), tree))
        signals = dict(tree["signals"])
        for name, signal in config.signals.items():
            names = [resolve_name(topic, self._player.node_name("alert_system")) for topic in signal.topics]
            if not names:
                continue
            # An action has two topics.
            topic = next((each for each in names if not self._player.why_not_recorded(each, "")), names[0])
            absent = self._player.why_not_recorded(topic, signal.type)
            missing = absent or self._player.why_unreadable(topic, signal.type, signal.selection)
            if missing:  # it says nothing about the robot: the signal stays `waiting`
                signals[name] = {**signals[name], "stale_after_s": 0.0}
            level = _announced_level(saved, name)
            since_s = None if level is Level.OK else self._begin_s
            summary = SignalSummary(file, own_config(signal), topic, not absent, missing, level=level, since_s=since_s)
            self._signals[file, name] = summary
            if signal.is_template:
                self._templates[file, name] = signal
        node = self._player.node("alert_system", {**tree, "signals": signals})
        system = AlertSystem(node, {"replay": lambda event: self._note(file, event)}, log_alerts=False)
        if saved is not None:
            states = {name: state for name, state in saved.states.items() if name != LINK}  # a recording has no link
            system.monitor.restore(states, None, self._player.wall_s, saved.time_s)
            if not self._player.why_not_recorded(TICKS, ""):
                system.tick_with(TICKS)
        node.create_timer(1.0, lambda now_s: self._note_effects(file, system.monitor))
        system.monitor.collect_samples(lambda signal: _Collector(partial(self._note_sample, file, signal)))
        self._player.on_gap.append(system.skip)

    def run(self, on_progress: Callable[[float], None] | None = None) -> None:
        """Plays the recordings to their end; calls now and then with the fraction played, 0 to 1, which may raise."""
        self._player.play(on_progress)
        for signal in self._signals.values():
            signal.finish(self._begin_s, self._played_s)

    @property
    def summaries(self) -> list[SignalSummary]:
        """One per configuration and signal, complete after `run`; those of one signal follow each other.

        They are in the order of the configurations, those of elements behind their template.
        """
        order = {name: place for place, name in enumerate(dict.fromkeys(name for _, name in self._signals))}
        keys = sorted(self._signals, key=lambda key: (order[template_name(key[1])], order[key[1]]))
        return [self._signals[key] for key in keys]

    def find(self, file: str, name: str) -> SignalSummary | None:
        """Returns a signal by its name; that of an element or a source begins to be measured. None if not judged."""
        known = self._signals.get((file, name))
        if known is not None:
            return known
        template = self._templates.get((file, template_name(name)))
        if template is not None:
            config, topic = replace(template, name=name), self._signals[file, template.name].topic
        elif is_source(name):
            config, topic = replace(_OF_SOURCE, name=name), name
        else:
            return None
        added = self._signals[file, name] = SignalSummary(file, config, topic, True, "")
        return added

    @property
    def _played_s(self) -> float:
        """The log time, in s since 1970, without what was skipped."""
        return self._player.wall_s - self._skipped_s

    def _skip(self, begin_s: float, end_s: float) -> None:
        """Leaves a time out of everything that is measured."""
        self._skipped_s += end_s - begin_s

    def _note(self, file: str, event: Event) -> None:
        effects: Sequence[str] = ()
        judged = self.find(file, event.signal) if isinstance(event, Transition) else None
        if judged is not None and isinstance(event, Transition):
            judged.note(event, self._played_s)
            effects = judged.effects if event.from_level is Level.OK else ()
        self._on_event(JudgedEvent(self._player.wall_s, file, event, effects))

    def _note_effects(self, file: str, monitor: Monitor) -> None:
        for cause, names in monitor.effects().items():
            alert = self._signals.get((file, cause))
            if alert is not None and alert.level is not Level.OK:
                alert.effects += [name for name in names if name not in alert.effects]
                for effect in filter(None, [self.find(file, name) for name in names]):
                    effect.caused = max(effect.caused, (alert.begun_s, cause))

    def _note_sample(self, file: str, signal: SignalMonitor, judged: float | None, now_s: float, good: bool) -> None:
        """Notes a sample of a signal; an element begins to be measured with its first one."""
        measured = self.find(file, signal.config.name)
        if measured is not None:
            measured.note_sample(self._played_s, judged, good)
            if self._on_sample is not None:
                value = signal.window.last() if good else None
                self._on_sample(file, measured.config, JudgedSample(self._player.wall_s, now_s, value, judged))


def _announced_level(saved: SavedMonitor | None, signal: str) -> Level:
    """Returns the level of a signal that was announced last; OK if that is not known."""
    states: Any = saved.states if saved is not None else {}
    try:
        return Level[states[signal]["announced"]["level"]]
    except (KeyError, TypeError):
        return Level.OK


class _Collector(SampleCollector):
    """Passes on what a signal's monitor made of its samples."""

    def __init__(self, note_sample: Callable[[float | None, float, bool], None]) -> None:
        super().__init__()
        self._note_sample = note_sample

    def note(self, value: float | None, now_s: float, *, good: bool = True) -> None:
        """Passes on a sample with the value of the judged statistic."""
        self._note_sample(value, now_s, good)

    def note_level(self, level: Level, now_s: float) -> None:
        """Does nothing: shares of time are those of the announced levels."""


class Differences:
    """Passes on transitions that one of two configurations announced and the other did not, at the same time.

    Two transitions are the same if signal, levels and time agree. Holds the transitions of one instant only.
    """

    def __init__(self, on_difference: OnEvent) -> None:
        """Calls with each transition that only one configuration announced."""
        self._on_difference = on_difference
        self._held: list[tuple[JudgedEvent, Any]] = []
        """Those without an equal one until now, with what two transitions must agree in."""

    def add(self, judged: JudgedEvent) -> None:
        """Takes a transition; notices are ignored. Log times must not decrease."""
        event = judged.event
        if not isinstance(event, Transition):
            return
        if self._held and judged.wall_s != self._held[0][0].wall_s:
            self.flush()
        key = event.signal, event.from_level, event.to_level, event.now_s, event.repeat
        for each in self._held:
            if each[1] == key and each[0].file != judged.file:
                self._held.remove(each)
                return
        self._held.append((judged, key))

    def flush(self) -> None:
        """Passes on what is left of the last instant; call at the end."""
        for judged, _ in self._held:
            self._on_difference(judged)
        self._held.clear()
