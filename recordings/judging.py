"""Judges recordings by one or several configurations in one pass.

Each configuration has its own alert_system, and all of them run on one `Player`. Samples are also collected in chunks,
for the statistics of each signal and for plots.
"""

from __future__ import annotations

import math
import sys
from array import array
from dataclasses import dataclass, field
from typing import Any, Callable, Counter, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from robot_health_monitor.core.attachments import TICKS, SavedMonitor
from robot_health_monitor.core.config import DEFAULT_SIGNALS, Section, read_monitor
from robot_health_monitor.core.element_signals import element_config, element_signal_name, own_config
from robot_health_monitor.core.elements import Elements
from robot_health_monitor.core.middleware import resolve_name
from robot_health_monitor.core.model import Level, Status, Transition
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.outlets import Event
from robot_health_monitor.core.quality import as_float
from robot_health_monitor.core.signal_config import SignalConfig, template_name

from .middleware import Player, RecordedMiddleware, Subscription
from .saved_states import SavedStates, announced_level

CHUNK = 4096  # samples that are collected before they are processed together
_LARGEST = sys.float_info.max


class JudgedEvent(NamedTuple):
    """What an alert_system announced."""

    wall_s: float  # log time of the message or tick that caused it, since 1970
    file: str  # name of the configuration
    event: Event


class SignalStatistics:
    """Number, range, mean and longest gap of one signal's samples over a whole recording."""

    def __init__(self, config: SignalConfig) -> None:
        """Starts before the first sample."""
        self._config = config
        self._valid_min = -_LARGEST if config.valid_min is None else config.valid_min
        self._valid_max = _LARGEST if config.valid_max is None else config.valid_max
        self.samples = 0  # with the bad ones: those that are no valid number
        self.bad_samples = 0
        self.min: Optional[float] = None
        """Smallest value of the signal's statistic, in its unit (`judged_unit`); None if it was never defined."""
        self.max: Optional[float] = None
        self.mean: Optional[float] = None  # of the values of the statistic at the samples
        self.first_s: Optional[float] = None  # log time of the first sample, since 1970
        self.longest_gap_s: Optional[float] = None  # between two samples in a row; None with fewer than two
        self._last_s: Optional[float] = None
        self._ranged = 0

    def skip(self, duration_s: float) -> None:
        """Leaves a time after the last sample, in s, out of the gaps."""
        if self._last_s is not None:
            self._last_s += duration_s

    def add(self, times_s: Any, values: Any) -> Any:
        """Adds samples as they came: arrays of doubles, the log times in s since 1970.

        Returns the values in the signal's unit, an array of doubles with NaN for bad samples.
        """
        config = self._config
        with np.errstate(over="ignore", invalid="ignore"):
            numbers = values * config.scale if config.scale != 1.0 else values.copy()
            for placeholder in config.placeholders:
                tolerance = 1e-6 * np.maximum(np.abs(values), abs(placeholder))
                numbers[np.abs(values - placeholder) <= tolerance] = math.nan
            bad = ~((numbers >= self._valid_min) & (numbers <= self._valid_max))  # True for NaN
        numbers[bad] = math.nan
        self.samples += len(values)
        self.bad_samples += int(np.count_nonzero(bad))
        if config.statistic == "last":
            self.add_values(numbers)
        if self._last_s is None:
            self.first_s = float(times_s[0])
        gaps = np.diff(times_s if self._last_s is None else np.concatenate([[self._last_s], times_s]))
        if len(gaps):
            self.longest_gap_s = max(self.longest_gap_s or 0.0, float(gaps.max()))
        self._last_s = float(times_s[-1])
        return numbers

    def add_values(self, values: Any) -> None:
        """Adds values of a statistic other than `last` to the range, an array of doubles; NaN: undefined."""
        good = values[~np.isnan(values)]
        if not len(good):
            return
        smallest, largest = float(good.min()), float(good.max())
        self.min = smallest if self.min is None else min(self.min, smallest)
        self.max = largest if self.max is None else max(self.max, largest)
        self._ranged += len(good)
        weight = len(good) / self._ranged
        mean = (self.mean or 0.0) * (1.0 - weight) + float((good / len(good)).sum()) * weight
        self.mean = min(max(mean, self.min), self.max)  # rounding must not carry it beyond the samples


@dataclass
class SignalSummary:
    """How one configuration judged one signal."""

    file: str  # name of the configuration
    config: SignalConfig
    topic: str  # the absolute one
    recorded: bool  # whether the recordings have its topic, with its type
    missing: str
    """Why it was not judged: it is not recorded, or has no sample that can be read; empty if it was."""
    statistics: SignalStatistics
    shares: Mapping[Level, float] = field(default_factory=dict)
    """Share of the recorded time per announced level, 0 to 1; empty if it was never known."""
    unknown: float = 1.0
    """Share of the recorded time before the first sample or alert, 0 to 1."""
    alerts: int = 0  # transitions to a level other than OK, without repetitions
    status: Optional[Status] = None
    """At the end of the recordings; None before."""


OnEvent = Callable[[JudgedEvent], None]
OnSamples = Callable[[str, SignalConfig, Any, Any, Any], None]
"""Receives the configuration's name, the signal, log times (s since 1970) with values, and times of bad samples.

Arrays of doubles. The values are those that the bounds apply to, NaN while the statistic is undefined; for a forecast,
which is shown by its line, those that it follows from.
"""


class Judge:
    """Runs an alert_system for each configuration on one player."""

    def __init__(self, player: Player, on_event: OnEvent, on_samples: Optional[OnSamples] = None) -> None:
        """`on_event` receives transitions and notices with times; it must not raise. `on_samples` gets all samples."""
        self._player = player
        self._on_event = on_event
        self._on_samples = on_samples
        self._tapes: Dict[Tuple[str, str, Optional[str]], _Tape] = {}
        self._signals: Dict[Tuple[str, str], _JudgedSignal] = {}
        self._templates: Dict[Tuple[str, str], SignalConfig] = {}
        self._systems: Dict[str, AlertSystem] = {}
        player.on_gap.append(self._skip)

    def add(self, file: str, parameters: Mapping[str, Any], saved: Optional[SavedMonitor] = None) -> None:
        """Adds a configuration: its name, and the mapping under `ros__parameters` of alert_system.

        It continues from the `saved` states of its signals, which are those at the beginning.
        Raises ConfigError, with a path below that: it cannot be used, or a field is not in the recorded type.
        """
        tree = parameters if "signals" in parameters else {**parameters, "signals": DEFAULT_SIGNALS}
        config = read_monitor(Section((), tree))
        node_name = self._player.node_name("alert_system")
        missing = {
            name: self._player.why_not_recorded(resolve_name(signal.topic, node_name), signal.type)
            for name, signal in config.signals.items()
        }
        # A topic that was not recorded says nothing about the robot: its signal stays `waiting`.
        signals = {
            name: {**signal, "stale_after_s": 0.0} if missing[name] else signal
            for name, signal in tree["signals"].items()
        }
        node = self._player.node("alert_system", {**tree, "signals": signals})
        history = None if saved is None else SavedStates(saved, lambda: self._player.wall_s)
        outlets = {"replay": lambda event: self._note(file, event)}
        system = AlertSystem(node, outlets, log_alerts=False, history=history)
        if saved is not None and not self._player.why_not_recorded(TICKS, ""):
            system.tick_with(TICKS)
        self._systems[file] = system
        self._player.on_gap.append(system.skip)
        for name, signal in config.signals.items():
            reason, own = missing[name], own_config(signal)
            summary = SignalSummary(file, own, node.resolve(signal.topic), not reason, reason, SignalStatistics(own))
            judged = self._signals[file, name] = _JudgedSignal(summary, self._player.wall_s)
            if saved is not None:
                judged.begin(announced_level(saved, name))
            if signal.is_template:
                self._templates[file, name] = signal
            if not reason:
                (self._collect_elements if signal.is_template else self._collect)(node, summary, system)

    def monitor(self, file: str) -> Monitor:
        """Returns the monitor of a configuration."""
        return self._systems[file].monitor

    def run(self, on_progress: Optional[Callable[[float], None]] = None) -> None:
        """Plays the recordings to their end; calls now and then with the fraction played, 0 to 1, which may raise."""
        self._player.play(on_progress)
        for tape in self._tapes.values():
            tape.flush()
        for (file, name), signal in self._signals.items():
            signal.finish(self._player.wall_s)
            signal.summary.status = self._systems[file].status(name)

    @property
    def summaries(self) -> List[SignalSummary]:
        """One per configuration and signal, in the order of the configurations; complete after `run`.

        Those of elements follow that of their template.
        """
        order = {key: place for place, key in enumerate(self._signals)}
        keys = sorted(self._signals, key=lambda key: (order[key[0], template_name(key[1])], order[key]))
        return [self._signals[key].summary for key in keys]

    def config_of(self, file: str, signal: str) -> Optional[SignalConfig]:
        """Returns the configuration of a signal, which may be an element; None: it is not judged."""
        judged = self._find(file, signal)
        return None if judged is None else judged.summary.config

    def _find(self, file: str, name: str) -> Optional[_JudgedSignal]:
        """Returns a signal by its name; that of an element begins to be measured."""
        key, template_key = (file, name), (file, template_name(name))
        if key not in self._signals and template_key in self._templates:
            template = self._signals[template_key]
            config = element_config(self._templates[template_key], name)
            summary = SignalSummary(file, config, template.summary.topic, True, "", SignalStatistics(config))
            self._signals[key] = template.beside(summary)
        return self._signals.get(key)

    def _skip(self, begin_s: float, end_s: float) -> None:
        """Leaves a time out of everything that is measured."""
        for tape in self._tapes.values():
            tape.flush()
        for signal in self._signals.values():
            signal.skip(end_s - begin_s)

    def _note(self, file: str, event: Event) -> None:
        judged = self._find(file, event.signal) if isinstance(event, Transition) else None
        if judged is not None and isinstance(event, Transition):
            judged.note(event, self._player.wall_s)
        self._on_event(JudgedEvent(self._player.wall_s, file, event))

    def _collect(self, node: RecordedMiddleware, summary: SignalSummary, system: AlertSystem) -> None:
        """Collects the samples of a signal; after alert_system's subscription, so that they have been judged."""
        config = summary.config

        def subscribe(collect: Callable[[Any, float], None]) -> None:
            self._player.subscribe(Subscription(node, summary.topic, collect), config.type, config.field or None)

        source = (summary.topic, config.type, config.field or None)
        if source not in self._tapes:  # one for all configurations
            self._tapes[source] = _Tape()
            subscribe(self._tapes[source].collect)
        self._tapes[source].consumers.append(self._consumers(summary)[0])
        if config.statistic != "last":
            judged = self._tape(summary, of_statistic=True)
            subscribe(lambda _, wall_s: judged.collect(system.monitor.judged_value(config.name), wall_s))

    def _collect_elements(self, node: RecordedMiddleware, summary: SignalSummary, system: AlertSystem) -> None:
        """Collects the samples of the elements of a template, as `_collect`; its own are how many there are."""
        file, template, monitor = summary.file, summary.config, system.monitor
        own = self._tape(summary)

        def collect(value: Any, wall_s: float) -> None:
            own.collect(monitor.judged_value(template.name) if isinstance(value, Elements) else value, wall_s)
            for element, datum in value if isinstance(value, Elements) else ():
                name = element_signal_name(template.name, element)
                judged = self._find(file, name) if name in monitor.signals() else None
                if judged is None:  # beyond max_elements
                    continue
                self._tape(judged.summary).collect(datum, wall_s)
                if judged.summary.config.statistic != "last":
                    self._tape(judged.summary, of_statistic=True).collect(monitor.judged_value(name), wall_s)

        self._player.subscribe(Subscription(node, summary.topic, collect), template.type, template.field)

    def _tape(self, summary: SignalSummary, *, of_statistic: bool = False) -> _Tape:
        """Returns the tape of a signal: of its samples, or of the values of its statistic."""
        key = (summary.file, summary.config.name, "" if of_statistic else None)
        if key not in self._tapes:
            self._tapes[key] = _Tape()
            self._tapes[key].consumers.append(self._consumers(summary)[of_statistic])
        return self._tapes[key]

    def _consumers(self, summary: SignalSummary) -> Tuple[Callable[[Any, Any], None], Callable[[Any, Any], None]]:
        """Returns what takes the samples of a signal, and the values of its statistic if that is not `last`."""
        config, on_samples, statistics = summary.config, self._on_samples, summary.statistics
        shows_values = config.statistic in ("last", "forecast")

        def take(times_s: Any, values: Any) -> None:
            numbers = statistics.add(times_s, values)
            if on_samples is not None:
                good = len(times_s) if shows_values else 0
                on_samples(summary.file, config, times_s[:good], numbers[:good], times_s[np.isnan(numbers)])

        def take_judged(times_s: Any, values: Any) -> None:
            statistics.add_values(values)
            if on_samples is not None and not shows_values:
                on_samples(summary.file, config, times_s, values, np.empty(0))

        return take, take_judged


class _Tape:
    """Collects numbers, and passes them on in chunks."""

    def __init__(self) -> None:
        self.consumers: List[Callable[[Any, Any], None]] = []
        """Each gets the times and values of a chunk, as arrays of doubles."""
        self._times: List[float] = []
        self._values: List[Any] = []

    def collect(self, value: Any, wall_s: float) -> None:
        """Adds a number, with its log time in seconds since 1970."""
        self._values.append(value)
        self._times.append(wall_s)
        if len(self._times) >= CHUNK:
            self.flush()

    def flush(self) -> None:
        if not self._times:
            return
        times_s, values = np.array(self._times, dtype=np.float64), as_numbers(self._values)
        self._times, self._values = [], []
        for consumer in self.consumers:
            consumer(times_s, values)


def as_numbers(values: Sequence[Any]) -> Any:
    """Returns values as an array of doubles; NaN for what is not a number."""
    try:
        numbers = array("d", values)
    except (TypeError, OverflowError, ValueError):
        numbers = array("d", [as_float(value) for value in values])
    return np.frombuffer(numbers, dtype=np.float64)


class _JudgedSignal:
    """Measures the time that one signal of one configuration spends on each level.

    Times are log times minus the time that was skipped before them.
    """

    def __init__(self, summary: SignalSummary, begin_s: float) -> None:
        self.summary = summary
        self._skipped_s = 0.0
        self._begin_s = begin_s
        self._level = Level.OK
        self._since_s: Optional[float] = None
        self._lasted_s = dict.fromkeys(Level, 0.0)
        self._alerted_s = math.inf  # time of the first alert
        self._sampled_s = math.inf  # time of the first sample

    def begin(self, level: Level) -> None:
        """Begins with a level that was announced before."""
        if level is not Level.OK:
            self._level, self._since_s = level, self._begin_s

    def beside(self, summary: SignalSummary) -> _JudgedSignal:
        """Returns another signal that is measured from the same time on."""
        other = _JudgedSignal(summary, self._begin_s)
        other._skipped_s = self._skipped_s
        return other

    def skip(self, duration_s: float) -> None:
        self._note_first_sample()
        self._skipped_s += duration_s
        self.summary.statistics.skip(duration_s)

    def note(self, transition: Transition, wall_s: float) -> None:
        if transition.repeat:
            return
        now_s = wall_s - self._skipped_s
        if self._since_s is None:
            self._alerted_s = now_s
        else:
            self._lasted_s[self._level] += now_s - self._since_s
        self._level, self._since_s = transition.to_level, now_s
        self.summary.alerts += transition.to_level is not Level.OK

    def finish(self, wall_s: float) -> None:
        """Completes the summary."""
        self._note_first_sample()
        end_s = wall_s - self._skipped_s
        if self._since_s is not None:
            self._lasted_s[self._level] += end_s - self._since_s
        self._lasted_s[Level.OK] += max(0.0, min(self._alerted_s, end_s) - self._sampled_s)
        total_s, known_s = end_s - self._begin_s, sum(self._lasted_s.values())
        if known_s > 0.0:
            self.summary.shares = {level: lasted_s / total_s for level, lasted_s in self._lasted_s.items()}
        unknown = 1.0 - min(known_s / total_s, 1.0) if total_s > 0.0 else 1.0
        self.summary.unknown = 0.0 if unknown < 1e-9 else unknown
        if not self.summary.statistics.samples:
            self.summary.missing = self.summary.missing or f"{self.summary.topic} has no samples"

    def _note_first_sample(self) -> None:
        first_s = self.summary.statistics.first_s
        if self._sampled_s == math.inf and first_s is not None:
            self._sampled_s = first_s - self._skipped_s


class Differences:
    """Passes on transitions that one configuration announced and another did not, at the same time.

    Two transitions are the same if signal, levels and time agree. Holds the transitions of one instant only.
    """

    def __init__(self, files: Sequence[str], on_difference: OnEvent) -> None:
        """Compares configurations by their names; calls with each transition that not every one announced."""
        self._files = tuple(files)
        self._on_difference = on_difference
        self._held: List[Tuple[JudgedEvent, Any]] = []  # with what two transitions must agree in

    def add(self, judged: JudgedEvent) -> None:
        """Takes a transition; notices are ignored. Log times must not decrease."""
        event = judged.event
        if not isinstance(event, Transition):
            return
        if self._held and judged.wall_s != self._held[0][0].wall_s:
            self.flush()
        self._held.append((judged, (event.signal, event.from_level, event.to_level, event.now_s, event.repeat)))

    def flush(self) -> None:
        """Compares the transitions of the last instant; call at the end."""
        held, self._held = self._held, []
        counts = {file: Counter(key for judged, key in held if judged.file == file) for file in self._files}
        seen: Counter[Tuple[str, Any]] = Counter()
        for judged, key in held:
            seen[judged.file, key] += 1
            if seen[judged.file, key] > min(count[key] for count in counts.values()):
                self._on_difference(judged)
