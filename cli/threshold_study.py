"""Writes thresholds from recordings of healthy robots. `suggest_command.py` calls it.

The recordings are read twice: to measure, and to replay them once with what follows from that. The replay shows how
long healthy values are beyond a bound (`for_s`), which forecasts are silent, and how often the rest alerts.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import sys
from collections import Counter
from typing import Any, Collection, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple, Union

from ..core.config.monitor_config import Section, read_monitor
from ..core.config.signal_config import BOUNDS, template_name
from ..core.config.yaml_file import read_yaml
from ..core.judge.attachments import THRESHOLDS, TICKS
from ..core.port.middleware import Middleware
from ..core.proposal.candidates import Topic
from ..core.proposal.proposal import FORECASTS, Proposal, Proposed, Signal, checked
from ..core.proposal.suggestion import suggest
from ..core.proposal.survey import Survey
from ..core.proposal.thresholds_file import thresholds_text
from ..core.values.errors import ConfigError
from ..core.values.formatting import count_text, duration_text, list_text, printable
from ..core.values.model import Level, Transition
from ..core.values.names import resolve_name
from ..recordings.decoding import type_of
from ..recordings.judging import Judge, JudgedEvent
from ..recordings.middleware import Player
from ..recordings.reading import Recordings
from .embedded import sections_of_nodes

Signals = Dict[str, Dict[str, Any]]
"""Settings of signals by their names."""


def suggest_thresholds(arguments: argparse.Namespace) -> None:
    """Writes a thresholds.yaml on stdout, and problems of the recordings on stderr."""
    study = _Study(arguments.recordings, arguments.namespace.strip("/"))
    try:
        text = study.of_file(arguments.thresholds) if arguments.thresholds else study.of_recorded_topics()
    finally:
        for problem in study.problems:
            sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
    sys.stdout.write(text)


class _Alerts:
    """The alerts of a replay, and how long each signal was beyond its bounds. Elements count for their template."""

    def __init__(self) -> None:
        self.by_bound: Counter[Tuple[str, Optional[float]]] = Counter()  # alerts by signal and bound
        self.stale: Counter[str] = Counter()
        self.changes: Counter[str] = Counter()  # of both, those that changed the level of an open alert
        self.longest_s: Dict[str, float] = {}  # longest alert by signal
        self._since_s: Dict[str, float] = {}

    def note(self, judged: JudgedEvent) -> None:
        event = judged.event
        if not isinstance(event, Transition) or event.repeat:
            return
        self._end(event.signal, judged.wall_s)
        configured = template_name(event.signal)
        is_stale = event.to_level is Level.STALE
        is_beyond = event.to_level not in (Level.OK, Level.STALE) and event.bound is not None
        self.stale[configured] += is_stale
        self.changes[configured] += (is_stale or is_beyond) and event.from_level is not Level.OK
        if is_beyond:
            self.by_bound[configured, event.bound] += 1
            self._since_s[event.signal] = judged.wall_s

    def end_recording(self, wall_s: float) -> None:
        for signal in list(self._since_s):
            self._end(signal, wall_s)

    def count(self, signal: Signal, key: str, value: Any) -> Optional[int]:
        """Returns how often a key of a signal alerts; None if it is no key that does."""
        if key in BOUNDS:
            # A suggested `for_s` is longer than every time beyond a bound.
            return 0 if "for_s" in signal.suggestion.settings else self.by_bound[signal.name, value]
        # A topic of several signals that falls silent is one alert, with the name of the topic.
        return self.stale[signal.name] + self.stale[signal.topic] if key == "stale_after_s" and value else None

    def _end(self, signal: str, wall_s: float) -> None:
        lasted_s = wall_s - self._since_s.pop(signal, wall_s)
        configured = template_name(signal)
        self.longest_s[configured] = max(lasted_s, self.longest_s.get(configured, 0.0))


class _Given:
    """The signals of a file that are recorded."""

    def __init__(self, signals: Signals, topics: Mapping[str, str]) -> None:
        self._signals = signals
        self._topics = topics  # absolute topic of each signal
        self._survey = Survey()
        self.begin_recording = self._survey.begin_recording

    def listen(self, node: Middleware, topics: Collection[str]) -> None:
        self._survey.listen(node, read_monitor(Section((), {"signals": _placed(self._signals)})).signals)

    def result(self, longest_s: Mapping[str, float], forecasts: Mapping[str, int]) -> Proposed:
        signals = []
        for name, given in self._signals.items():
            measured = self._survey.measured[name]
            found = checked(name, given, suggest(measured, longest_s.get(name)))
            signals.append(Signal(name, self._topics[name], dict(given), found, measured, is_given=True))
        return Proposed(signals)


class _Study:
    """One run of the command."""

    def __init__(self, paths: Sequence[str], namespace: str) -> None:
        self.problems: List[str] = []
        self._paths = paths
        self._namespace = namespace
        with Recordings(paths) as recordings:
            self._channels = recordings.channels
            first, last = recordings.span_ns or (0, 0)
            self._duration_s = (last - first - sum(end - begin for begin, end in recordings.gaps_ns)) / 1e9
        self._has_black_box = any(map(_is_black_box, paths))

    def of_file(self, name: str) -> str:
        """Returns the text of a file with the settings of another one, and suggestions for them."""
        file = read_yaml(name)
        section = sections_of_nodes(file)["alert_system"]
        with file.located(section.path):
            config = read_monitor(Section((), section.tree))
        node = f"/{self._namespace}/alert_system" if self._namespace else "/alert_system"
        topics = {signal: resolve_name(config.signals[signal].topic, node) for signal in section.tree["signals"]}
        recorded = {channel.topic for channel in self._channels}
        signals = {name: dict(each) for name, each in section.tree["signals"].items() if topics[name] in recorded}
        if not signals:
            wanted = ", ".join(dict.fromkeys(signal.topic for signal in config.signals.values()))
            got = list_text(sorted(recorded)) or "no topic"
            raise ConfigError(f"no signal is recorded: expected one of {wanted}, got {got}")
        others = {key: value for key, value in section.tree.items() if key != "signals"}
        unchanged = {name: each for name, each in section.tree["signals"].items() if name not in signals}
        with file.located(section.path):
            return self._text(_Given(signals, topics), others, unchanged)

    def of_recorded_topics(self) -> str:
        """Returns the text of a file for everything that is recorded."""
        proposal = Proposal(self._namespace)
        proposal.take(_topic(channel) for channel in self._channels)
        if not proposal.topics:
            raise ConfigError("no topic is recorded")
        self.problems += proposal.problems
        if self._has_black_box:
            proposal.own_topics.add(TICKS)
        return self._text(proposal, {}, {})

    def _text(self, source: Union[Proposal, _Given], others: Mapping[str, Any], unchanged: Signals) -> str:
        with self._played() as player:
            player.on_gap.append(lambda begin_s, end_s: source.begin_recording())
            source.listen(player.node("survey", {}), {channel.topic for channel in self._channels})
        trial = source.result({}, {})
        if not trial.signals:
            reasons = [f"{topic}: {reason}" for topic, reason in sorted(trial.not_watched.items())]
            raise ConfigError(f"nothing to watch: {list_text(reasons, 5)}")
        proposed, alerts = self._replay(source, trial)
        hours = duration_text(self._duration_s)
        if self._duration_s >= 3600.0:
            hours = f"{self._duration_s / 3600.0:.1f} h"
        by_name = {signal.name: signal for signal in proposed.signals}
        watched = [signal for signal in proposed.signals if not signal.is_shown_only]
        bounds = [(each, key, value) for each in watched for key, value in each.settings.items() if key in BOUNDS]
        total = sum(alerts.count(*bound) or 0 for bound in bounds) + sum(alerts.stale.values())
        total -= sum(alerts.changes[each.name] for each in by_name.values() if "for_s" not in each.suggestion.settings)
        names = [os.path.basename(os.path.abspath(path)) for path in self._paths]
        heading = [
            f"Suggested by `robot-health suggest` from {hours} of recordings: {list_text(names, 5)}",
            f"Replayed with these thresholds, the recordings raise {count_text(total, 'alert')}.",
            "The bounds are those of WARN: recordings of healthy robots do not show where errors begin.",
            "docs/statistics.md explains how each value is computed. Review before use.",
        ]

        def alerts_of(name: str, key: str, value: Any) -> str:
            count = alerts.count(by_name[name], key, value)
            return "" if count is None else f"{count_text(count, 'alert')} in {hours}; "

        return thresholds_text(heading, others, proposed, alerts_of, unchanged)

    def _replay(self, source: Union[Proposal, _Given], trial: Proposed) -> Tuple[Proposed, _Alerts]:
        """Returns what is proposed after a replay of the first proposal, and its alerts."""
        main = {signal.name: signal.settings for signal in trial.signals if not signal.is_shown_only}
        forecasts = [
            signal.name
            for signal in trial.signals
            if signal.name in main and signal.given.get("statistic") == "forecast" and not signal.is_given
        ]
        # All that may follow from the replay is tried in it, as configurations beside the first: the forecasts with
        # each of their settings.
        trials = [main]
        for option in range(1, len(FORECASTS) if forecasts else 1):
            signals = source.result({}, dict.fromkeys(forecasts, option)).signals
            trials.append({each.name: each.settings for each in signals if each.name in forecasts})
        # Those with bounds from the extremes, too, which are taken if values are beyond the others for long.
        wide = source.result(dict.fromkeys(main, math.inf), {}).signals
        trials.append(
            {each.name: each.settings for each in wide if main.get(each.name, each.settings) != each.settings}
        )
        alerts = [_Alerts() for _ in trials]
        with self._played() as player:
            judge = Judge(player, lambda judged: alerts[int(judged.file)].note(judged))
            for at, signals_of_trial in enumerate(trials):
                if signals_of_trial:
                    judge.add(str(at), {"robot_name": "recorded", "signals": _placed(signals_of_trial)})

            def end_recording(begin_s: float, end_s: float) -> None:
                for each in alerts:
                    each.end_recording(player.wall_s)

            player.on_gap.append(end_recording)
        end_recording(0.0, 0.0)
        chosen = {name: _first_silent(name, trials[:-1], alerts) for name in forecasts}
        alerts[0].by_bound |= alerts[-1].by_bound
        return source.result(alerts[0].longest_s, chosen), alerts[0]

    @contextlib.contextmanager
    def _played(self) -> Iterator[Player]:
        """Plays the recordings to what the block adds to the player."""
        with Recordings(self._paths) as recordings:
            player = Player(recordings, namespace=self._namespace)
            yield player
            player.play()
            self.problems += (problem for problem in player.problems if problem not in self.problems)


def _first_silent(name: str, trials: Sequence[Signals], alerts: Sequence[_Alerts]) -> int:
    """Returns the first setting of a forecast with which it did not alert; if there is none, it is only shown."""
    for at, signals in enumerate(trials):
        bounds = [value for key, value in signals[name].items() if key in BOUNDS] if name in signals else []
        if bounds and not any(alerts[at].by_bound[name, bound] for bound in bounds):
            return at
    return len(FORECASTS)


def _placed(signals: Signals) -> Signals:
    """Returns signals without conditions on signals that are not among them."""
    return {
        name: {
            key: value
            for key, value in settings.items()
            if not (key in ("only_if", "latch_release_if") and template_name(value["signal"]) not in signals)
        }
        for name, settings in signals.items()
    }


def _is_black_box(path: str) -> bool:
    with Recordings([path]) as recordings:
        return THRESHOLDS in recordings.attachments


def _topic(channel: Any) -> Topic:
    """Returns a topic as recorded; without a usable definition, its arrivals can be watched."""
    try:
        return Topic(channel.topic, channel.type_name, type_of(channel).definitions)
    except ConfigError:
        return Topic(channel.topic, channel.type_name, None)
