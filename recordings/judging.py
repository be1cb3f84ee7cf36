"""Judges recordings by one or several configurations in one pass.

Each configuration has its own alert_system, and all of them run on one `Player`. Samples are also collected in chunks,
for the statistics of each signal and for plots.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from robot_health_monitor.core.config import DEFAULT_SIGNALS, Section, read_monitor
from robot_health_monitor.core.middleware import resolve_name
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.outlets import Event
from robot_health_monitor.core.signal_config import SignalConfig

from .middleware import Player, RecordedMiddleware, Subscription
from .signal_statistics import SignalStatistics, as_numbers

CHUNK = 4096
"""Samples that are collected before they are processed together."""


class JudgedEvent(NamedTuple):
    """What an alert_system announced."""

    wall_s: float
    """Log time of the message or tick that caused it, in s since 1970."""
    file: str
    """Name of the configuration."""
    event: Event


class SignalSummary(NamedTuple):
    """How one configuration judged one signal."""

    file: str
    """Name of the configuration."""
    config: SignalConfig
    """Configuration of the signal."""
    topic: str
    """Its absolute topic."""
    recorded: bool
    """Whether the recordings have its topic, with its type."""
    missing: str
    """Why it was not judged: it is not recorded, or has no sample that can be read; empty if it was."""
    statistics: SignalStatistics
    """Statistics of its samples."""
    shares: Mapping[Level, float]
    """Share of the recorded time per announced level, 0 to 1; empty if it was never known."""
    unknown: float
    """Share of the recorded time before the first sample or alert, 0 to 1."""
    alerts: int
    """Number of transitions to a level other than OK, without repetitions."""


OnEvent = Callable[[JudgedEvent], None]
OnSamples = Callable[[str, SignalConfig, Any, Any, Any], None]
"""Receives the name of the configuration, the signal, log times (s since 1970) with values, and times of bad samples.

Arrays of doubles. The values are those that the bounds apply to: of the signal's statistic, in its unit, NaN while it
is undefined.
"""


class Judge:
    """Runs an alert_system for each configuration on one player."""

    def __init__(self, player: Player, on_event: OnEvent, on_samples: Optional[OnSamples] = None) -> None:
        """Prepares to judge.

        Args:
            player: plays the recordings.
            on_event: called with every transition and notice, at the time of the recording. It must not raise.
            on_samples: called with the samples of every signal, in chunks; None: not needed.
        """
        self._player = player
        self._on_event = on_event
        self._on_samples = on_samples
        self._tapes: Dict[Tuple[str, str, Optional[str]], _Tape] = {}
        self._signals: Dict[Tuple[str, str], _JudgedSignal] = {}
        player.on_gap.append(self._skip)

    def add(self, file: str, parameters: Mapping[str, Any]) -> None:
        """Adds a configuration.

        Args:
            file: its name.
            parameters: the mapping under `ros__parameters` of alert_system.

        Raises:
            ConfigError: it cannot be used, or a field is not in the recorded type. The path of the error begins below
                `ros__parameters`.
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
        system = AlertSystem(node, {"replay": lambda event: self._note(file, event)}, log_alerts=False)
        self._player.on_gap.append(system.skip)
        for name, signal in config.signals.items():
            topic = node.resolve(signal.topic)
            judged = self._signals[file, name] = _JudgedSignal(file, signal, topic, missing[name], self._player.wall_s)
            if not missing[name]:
                self._collect(node, judged, system)

    def run(self, on_progress: Optional[Callable[[float], None]] = None) -> None:
        """Plays the recordings to their end.

        Args:
            on_progress: called now and then with the fraction that has been played, 0 to 1. It may raise.
        """
        self._player.play(on_progress)
        for tape in self._tapes.values():
            tape.flush()
        for signal in self._signals.values():
            signal.finish(self._player.wall_s)

    @property
    def summaries(self) -> List[SignalSummary]:
        """One per configuration and signal, in the order of the configurations; complete after `run`."""
        return [signal.summary() for signal in self._signals.values()]

    def _skip(self, begin_s: float, end_s: float) -> None:
        """Leaves a time out of everything that is measured."""
        for tape in self._tapes.values():
            tape.flush()
        for signal in self._signals.values():
            signal.skip(begin_s, end_s)

    def _note(self, file: str, event: Event) -> None:
        if isinstance(event, Transition):
            judged = self._signals.get((file, event.signal))
            if judged is not None:
                judged.note(event, self._player.wall_s)
        self._on_event(JudgedEvent(self._player.wall_s, file, event))

    def _collect(self, node: RecordedMiddleware, judged: _JudgedSignal, system: AlertSystem) -> None:
        """Collects the samples of a signal; after alert_system's subscription, so that they have been judged."""
        config, on_samples, statistics = judged.config, self._on_samples, judged.statistics
        source = (judged.topic, config.type, config.field or None)
        if source not in self._tapes:
            self._tapes[source] = self._start_tape(node, judged, None)
        shows_samples = on_samples is not None and config.statistic == "last"

        def take(times_s: Any, values: Any) -> None:
            numbers = statistics.add(times_s, values)
            if on_samples is not None:
                good = len(times_s) if shows_samples else 0
                on_samples(judged.file, config, times_s[:good], numbers[:good], times_s[np.isnan(numbers)])

        self._tapes[source].consumers.append(take)
        if config.statistic != "last":

            def take_judged(times_s: Any, values: Any) -> None:
                statistics.add_values(values)
                if on_samples is not None:
                    on_samples(judged.file, config, times_s, values, np.empty(0))

            tape = self._start_tape(node, judged, lambda: system.monitor.judged_value(config.name))
            tape.consumers.append(take_judged)
            self._tapes[judged.file, config.name, ""] = tape

    def _start_tape(
        self, node: RecordedMiddleware, judged: _JudgedSignal, read: Optional[Callable[[], Optional[float]]]
    ) -> _Tape:
        """Collects, at each message of a signal, the number that `read` returns; None: that of the message."""
        tape = _Tape()
        collect = tape.collect if read is None else lambda _, wall_s: tape.collect(read(), wall_s)
        subscription = Subscription(node, judged.topic, collect)
        self._player.subscribe(subscription, judged.config.type, judged.config.field or None)
        return tape


class _Tape:
    """Collects numbers, and passes them on in chunks."""

    def __init__(self) -> None:
        """Starts empty."""
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
        """Passes on what has been collected."""
        if not self._times:
            return
        times_s, values = np.array(self._times, dtype=np.float64), as_numbers(self._values)
        self._times, self._values = [], []
        for consumer in self.consumers:
            consumer(times_s, values)


class _JudgedSignal:
    """One signal of one configuration: its samples, and the time that it spent on each level."""

    def __init__(self, file: str, config: SignalConfig, topic: str, missing: str, begin_s: float) -> None:
        self.file = file
        self.config = config
        self.topic = topic
        self.missing = missing
        self.statistics = SignalStatistics(config)
        self._alerts = 0
        self._skipped_s = 0.0
        # The following times are log times minus the time that was skipped before them.
        self._begin_s = self._end_s = begin_s
        self._level = Level.OK
        self._since_s: Optional[float] = None
        self._lasted_s = dict.fromkeys(Level, 0.0)
        self._first_s = math.inf
        self._sampled_s: Optional[float] = None

    def skip(self, begin_s: float, end_s: float) -> None:
        self._note_first_sample()
        self._skipped_s += end_s - begin_s
        self.statistics.skip(end_s - begin_s)

    def note(self, transition: Transition, wall_s: float) -> None:
        if transition.repeat:
            return
        now_s = wall_s - self._skipped_s
        if self._since_s is None:
            self._first_s = now_s
        else:
            self._lasted_s[self._level] += now_s - self._since_s
        self._level, self._since_s = transition.to_level, now_s
        self._alerts += transition.to_level is not Level.OK

    def finish(self, wall_s: float) -> None:
        self._note_first_sample()
        sampled_s, end_s = self._sampled_s, wall_s - self._skipped_s
        self._end_s = end_s
        if self._since_s is not None:
            self._lasted_s[self._level] += end_s - self._since_s
            if sampled_s is not None and sampled_s < self._first_s:
                self._lasted_s[Level.OK] += self._first_s - sampled_s
        elif sampled_s is not None:
            self._lasted_s[Level.OK] += end_s - sampled_s

    def _note_first_sample(self) -> None:
        if self._sampled_s is None and self.statistics.first_s is not None:
            self._sampled_s = self.statistics.first_s - self._skipped_s

    def summary(self) -> SignalSummary:
        total_s, known_s = self._end_s - self._begin_s, sum(self._lasted_s.values())
        shares = {level: lasted_s / total_s for level, lasted_s in self._lasted_s.items()} if known_s > 0.0 else {}
        unknown = 1.0 - min(known_s / total_s, 1.0) if total_s > 0.0 else 1.0
        unknown = 0.0 if unknown < 1e-9 else unknown
        missing = self.missing or ("" if self.statistics.samples else f"{self.topic} has no samples")
        return SignalSummary(
            self.file,
            self.config,
            self.topic,
            not self.missing,
            missing,
            self.statistics,
            shares,
            unknown,
            self._alerts,
        )
