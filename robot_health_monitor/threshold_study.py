"""Writes thresholds from recordings of healthy robots. `suggest_command.py` calls it."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections import Counter
from dataclasses import dataclass
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from robot_health_monitor.core.config import MonitorConfig, Section, read_monitor
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import count_text, duration_text, list_text, printable
from robot_health_monitor.core.middleware import resolve_name
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.proposal.candidates import Topic
from robot_health_monitor.core.proposal.proposal import Proposal, Proposed, Signal, checked
from robot_health_monitor.core.proposal.suggestion import suggest
from robot_health_monitor.core.proposal.survey import Survey
from robot_health_monitor.core.proposal.thresholds_file import thresholds_text
from robot_health_monitor.core.signal_config import BOUNDS, template_name
from robot_health_monitor.core.yaml_file import YamlFile, read_yaml
from robot_health_monitor.recordings.decoding import types_of
from robot_health_monitor.recordings.judging import Judge, JudgedEvent
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

from .embedded import sections_of_nodes


def suggest_thresholds(arguments: argparse.Namespace) -> None:
    """Writes a thresholds.yaml on stdout, and problems of the recordings on stderr."""
    study = _Study(arguments.recordings, arguments.namespace.strip("/"))
    if arguments.thresholds:
        study.take_thresholds(arguments.thresholds)
    else:
        study.take_recorded()
    try:
        text = study.run()
    finally:
        for problem in study.problems:
            sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
    sys.stdout.write(text)


@dataclass
class _Group:
    """Recordings that overlap in time, which are read together."""

    paths: List[str]
    start_ns: int
    end_ns: int


class _Alerts:
    """The alerts of a replay, and how long each signal was beyond its bounds. Elements count for their template."""

    def __init__(self) -> None:
        self.by_bound: Counter[Tuple[str, Optional[float]]] = Counter()  # alerts by signal and bound
        self.stale: Counter[str] = Counter()
        self.longest_s: Dict[str, float] = {}  # longest alert by signal
        self._since_s: Dict[str, float] = {}

    def note(self, judged: JudgedEvent) -> None:
        event = judged.event
        if not isinstance(event, Transition) or event.repeat:
            return
        self._end(event.signal, judged.wall_s)
        configured = template_name(event.signal)
        if event.to_level is Level.STALE:
            self.stale[configured] += 1
        elif event.to_level is not Level.OK and event.bound is not None:
            self.by_bound[configured, event.bound] += 1
            self._since_s[event.signal] = judged.wall_s

    def end_recording(self, wall_s: float) -> None:
        for signal in list(self._since_s):
            self._end(signal, wall_s)

    def _end(self, signal: str, wall_s: float) -> None:
        lasted_s = wall_s - self._since_s.pop(signal, wall_s)
        configured = template_name(signal)
        self.longest_s[configured] = max(lasted_s, self.longest_s.get(configured, 0.0))


class _Study:
    """One run of the command."""

    def __init__(self, paths: Sequence[str], namespace: str) -> None:
        self.problems: List[str] = []
        self._paths = list(paths)
        self._namespace = namespace
        self._groups, self._channels = self._open(paths)
        self._recorded = list_text(sorted({channel.topic for channel in self._channels})) or "no topic"
        self._duration_s = sum(group.end_ns - group.start_ns for group in self._groups) / 1e9
        self._file: Optional[YamlFile] = None
        self._section = Section((), {})
        self._given: Dict[str, Dict[str, Any]] = {}
        """Settings of each signal, as they will be written, apart from those that are suggested."""
        self._topics: Dict[str, str] = {}  # absolute topic of each signal
        self._unchanged: Dict[str, Mapping[str, Any]] = {}  # signals that are not recorded
        self._proposal = Proposal(namespace)
        self._survey = Survey()
        """Measures the signals of a file."""
        self._forecasts: Dict[str, int] = {}
        """Which of `FORECASTS` each forecast uses."""

    def _open(self, paths: Sequence[str]) -> Tuple[List[_Group], List[Any]]:
        found: List[_Group] = []
        channels: Dict[Any, None] = {}
        for path in paths:
            with Recordings([path]) as recordings:
                channels.update(dict.fromkeys(recordings.channels))
                if recordings.span_ns is not None:
                    found.append(_Group([path], *recordings.span_ns))
        groups: List[_Group] = []
        for group in sorted(found, key=lambda each: each.start_ns):
            if groups and group.start_ns <= groups[-1].end_ns:
                groups[-1].paths += group.paths
                groups[-1].end_ns = max(groups[-1].end_ns, group.end_ns)
            else:
                groups.append(group)
        return groups, list(channels)

    def take_thresholds(self, name: str) -> None:
        """Takes the signals of a file."""
        self._file = read_yaml(name)
        self._section = sections_of_nodes(self._file)["alert_system"]
        config = self._checked(self._section.tree)
        recorded = {channel.topic for channel in self._channels}
        node = f"/{self._namespace}/alert_system" if self._namespace else "/alert_system"
        for signal, settings in self._section.tree["signals"].items():
            topic = resolve_name(config.signals[signal].topic, node)
            if topic in recorded:
                self._given[signal] = dict(settings)
                self._topics[signal] = topic
            else:
                self._unchanged[signal] = settings
        if not self._given:
            wanted = ", ".join(dict.fromkeys(signal.topic for signal in config.signals.values()))
            raise ConfigError(f"no signal is recorded: expected one of {wanted}, got {self._recorded}")

    def take_recorded(self) -> None:
        """Takes every topic."""
        for path in self._paths:
            with Recordings([path]) as recordings:
                self._proposal.take(_topic(channel) for channel in recordings.channels)
        if not self._proposal.topics:
            raise ConfigError("no topic is recorded")
        self.problems += self._proposal.problems

    def run(self) -> str:
        """Returns the text of the file."""
        for group in self._groups:
            self._measure(group)
        proposed = self._proposed({})
        if not proposed.signals:
            reasons = [f"{topic}: {reason}" for topic, reason in sorted(proposed.not_watched.items())]
            raise ConfigError(f"nothing to watch: {list_text(reasons, 5)}")
        alerts = self._replay(proposed)
        longest_s = alerts.longest_s
        while True:
            self._step_forecasts(proposed, alerts)
            refined = self._proposed(longest_s)
            if _settings(refined) == _settings(proposed):
                return self._text(refined, alerts)
            proposed, alerts = refined, self._replay(refined)

    def _step_forecasts(self, proposed: Proposed, alerts: _Alerts) -> None:
        """Moves forecasts that alerted to the next of their settings; after the last, they are no more than shown."""
        for signal in proposed.signals:
            bounds = [setting.value for key, setting in signal.suggestion.settings.items() if key in BOUNDS]
            is_forecast = signal.given.get("statistic") == "forecast" and not signal.is_given
            if is_forecast and any(alerts.by_bound[signal.name, bound] for bound in bounds):
                self._forecasts[signal.name] = self._forecasts.get(signal.name, 0) + 1

    def _measure(self, group: _Group) -> None:
        with Recordings(group.paths) as recordings:
            player = Player(recordings, namespace=self._namespace)
            node = player.node("survey", {})
            with self._located():
                if self._file is None:
                    recorded = {channel.topic for channel in recordings.channels}
                    self._proposal.listen(node, recorded)
                else:
                    self._survey.listen(node, self._checked({"signals": self._placed(self._given)}).signals)
            player.play()
            self.problems += (problem for problem in player.problems if problem not in self.problems)

    def _proposed(self, longest_s: Mapping[str, float]) -> Proposed:
        if self._file is None:
            return self._proposal.result(longest_s, self._forecasts)
        signals = []
        for name, given in self._given.items():
            measured = self._survey.measured[name]
            found = checked(name, given, suggest(measured, longest_s.get(name)))
            signals.append(Signal(name, self._topics[name], dict(given), found, measured, is_given=True))
        return Proposed(signals)

    def _replay(self, proposed: Proposed) -> _Alerts:
        alerts = _Alerts()
        signals = {signal.name: signal.settings for signal in proposed.signals if not signal.is_shown_only}
        if not signals:
            return alerts
        for group in self._groups:
            with Recordings(group.paths) as recordings:
                player = Player(recordings, namespace=self._namespace)
                judge = Judge(player, alerts.note)
                with self._located():
                    judge.add("", {"robot_name": "recorded", "signals": self._placed(signals)})
                judge.run()
                alerts.end_recording(player.wall_s)
        return alerts

    def _placed(self, signals: Mapping[str, Mapping[str, Any]]) -> Dict[str, Dict[str, Any]]:
        """Returns signals without conditions on signals that are not among them."""
        return {
            name: {
                key: value
                for key, value in settings.items()
                if not (key in ("only_if", "latch_release_if") and template_name(value["signal"]) not in signals)
            }
            for name, settings in signals.items()
        }

    def _checked(self, tree: Mapping[str, Any]) -> MonitorConfig:
        with self._located():
            return read_monitor(Section((), tree))

    @contextlib.contextmanager
    def _located(self) -> Iterator[None]:
        """Gives errors of the configuration their place in its file."""
        try:
            yield
        except ConfigError as error:
            if self._file is None:
                raise
            raise self._file.locate(error.below(self._section.path)) from None

    def _text(self, proposed: Proposed, alerts: _Alerts) -> str:
        names = [os.path.basename(os.path.abspath(path)) for path in self._paths]
        hours = duration_text(self._duration_s)
        if self._duration_s >= 3600.0:
            hours = f"{self._duration_s / 3600.0:.1f} h"
        total = sum(alerts.by_bound.values()) + sum(alerts.stale.values())
        heading = [
            f"Suggested by `robot-health suggest` from {hours} of recordings: {list_text(names, 5)}",
            f"Replayed with these thresholds, the recordings raise {count_text(total, 'alert')}.",
            "The bounds are those of WARN: recordings of healthy robots do not show where errors begin.",
            "docs/statistics.md explains how each value is computed. Review before use.",
        ]

        def alerts_of(name: str, key: str, value: Any) -> str:
            if key in BOUNDS:
                return f"{count_text(alerts.by_bound[name, value], 'alert')} in {hours}; "
            return f"{count_text(alerts.stale[name], 'alert')} in {hours}; " if key == "stale_after_s" and value else ""

        others = {key: value for key, value in self._section.tree.items() if key != "signals"}
        return thresholds_text(heading, others, proposed, alerts_of, self._unchanged)


def _settings(proposed: Proposed) -> List[Dict[str, Any]]:
    return [signal.settings for signal in proposed.signals]


def _topic(channel: Any) -> Topic:
    """Returns a topic as recorded; without a usable definition, its arrivals can be watched."""
    try:
        return Topic(channel.topic, channel.type_name, types_of(channel).definitions)
    except ConfigError:
        return Topic(channel.topic, channel.type_name, None)
