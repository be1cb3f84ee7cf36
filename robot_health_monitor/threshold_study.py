"""Writes thresholds from recordings of healthy robots. `suggest_command.py` calls it."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import sys
from collections import Counter
from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from robot_health_monitor.core.config import MonitorConfig, Section, read_monitor
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import count_text, duration_text, list_text, printable
from robot_health_monitor.core.middleware import resolve_name
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.signal_config import BOUNDS, read_signal
from robot_health_monitor.core.yaml_file import YamlFile, read_yaml
from robot_health_monitor.recordings.judging import Judge, JudgedEvent
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings
from robot_health_monitor.recordings.sources import FRACTIONS, SUPPORTED_PACKAGES, list_sources
from robot_health_monitor.recordings.suggestion import Measured, Setting, Suggestion, suggest

from .embedded import sections_of_nodes

_ORDER = ("warn_below", "warn_above", "hysteresis", "for_s", "stale_after_s")
_OF_BOUNDS = ("hysteresis", "for_s")  # keys that refer to the bounds: they are not suggested for bounds that were given
_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_/.]*\Z")
_COLUMN = 36  # column of the comments


def suggest_thresholds(arguments: argparse.Namespace) -> None:
    """Writes a thresholds.yaml on stdout, and problems of the recordings on stderr."""
    study = _Study(arguments.recordings, arguments.namespace.strip("/"))
    if arguments.thresholds:
        study.take_thresholds(arguments.thresholds)
    else:
        study.take_recorded()
    text = study.run()
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
    """The alerts of a replay, and how long each signal was beyond its bounds."""

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
        if event.to_level is Level.STALE:
            self.stale[event.signal] += 1
        elif event.to_level is not Level.OK and event.bound is not None:
            self.by_bound[event.signal, event.bound] += 1
            self._since_s[event.signal] = judged.wall_s

    def end_recording(self, wall_s: float) -> None:
        for signal in list(self._since_s):
            self._end(signal, wall_s)

    def _end(self, signal: str, wall_s: float) -> None:
        lasted_s = wall_s - self._since_s.pop(signal, wall_s)
        self.longest_s[signal] = max(lasted_s, self.longest_s.get(signal, 0.0))


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
        self._notes: Dict[str, str] = {}
        self._measured: Dict[str, Measured] = {}

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
        """Takes every number of the standard messages."""
        sources, problems = list_sources(self._channels, self._namespace)
        self.problems += problems
        for source in sources:
            self._given[source.name] = dict(source.settings)
            self._topics[source.name] = source.topic
        if not sources:
            expected = "topics with messages of std_msgs or sensor_msgs"
            raise ConfigError(f"no signal is recorded: expected {expected}, got {self._recorded}")

    def run(self) -> str:
        """Returns the text of the file."""
        self._measure()
        suggestions = {name: self._suggest(name) for name in self._measured}
        self._drop_useless(suggestions)
        alerts = self._replay(suggestions)
        refined = {name: self._suggest(name, alerts.longest_s.get(name, 0.0)) for name in suggestions}
        if refined != suggestions:
            alerts = self._replay(refined)
        return self._text(refined, alerts)

    def _measure(self) -> None:
        judging = (*BOUNDS, "hysteresis", "for_s", "error_for_s")
        signals = {
            name: {**{key: value for key, value in settings.items() if key not in judging}, "stale_after_s": 0.0}
            for name, settings in self._given.items()
        }
        config = self._checked({"signals": self._placed(signals)})
        self._measured = {name: Measured(signal) for name, signal in config.signals.items()}

        def take(file: str, signal: Any, times_s: Any, values: Any, bad_times_s: Any) -> None:
            self._measured[signal.name].add(times_s, values)

        for group in self._groups:
            for measured in self._measured.values():
                measured.begin_recording()
            self._judge(group, signals, lambda judged: None, take, self.problems)
        for name, settings in self._given.items():
            self._convert_fraction(name, settings)

    def _suggest(self, name: str, longest_excursion_s: Optional[float] = None) -> Suggestion:
        """Returns what is suggested for a signal beside what was given: that stays as it is."""
        found = suggest(self._measured[name], longest_excursion_s)
        given = dict(self._given[name])
        has_bounds = any(key in given for key in BOUNDS)
        settings: Dict[str, Setting] = {}
        seen, left_out = dict(found.seen), list(found.left_out)
        for key in _ORDER:
            if key not in found.settings:
                continue
            try:
                if key in given or (key in _OF_BOUNDS and has_bounds):
                    seen[key] = found.settings[key]
                    continue
                read_signal(name, {**given, key: found.settings[key].value})
            except ConfigError as error:
                left_out.append(f"no {key}: {error.problem}")
            else:
                given[key] = found.settings[key].value
                settings[key] = found.settings[key]
        if has_bounds and all(reason.startswith("no bounds") for reason in left_out):
            left_out = []  # there are bounds
        return Suggestion(settings, seen, left_out)

    def _convert_fraction(self, name: str, settings: Dict[str, Any]) -> None:
        """Gives a field that is 0 to 1 by definition the unit %, whichever range the driver uses."""
        if self._file is not None or (settings["type"], settings["field"]) not in FRACTIONS:
            return
        measured = self._measured[name]
        if not measured.values.count or measured.values.min < 0.0 or measured.values.max > 100.0:
            return
        scale, seen = 1.0, "exceed 1, although the definition says 0 to 1"
        if measured.values.max <= 1.0:
            scale, seen = 100.0, "are 0 to 1"
        settings.update({"scale": scale, "unit": "%", "valid_min": 0.0, "valid_max": 100.0})
        self._notes[name] = f"scale: the recorded values {seen}"
        config = self._checked({"signals": self._placed({name: settings})})
        measured.scale(scale, config.signals[name])

    def _drop_useless(self, suggestions: Dict[str, Suggestion]) -> None:
        """Drops fields without bounds of a topic that has others, and its arrivals unless all fields are dropped."""
        if self._file is not None:
            return
        with_bounds = {self._topics[name] for name, suggestion in suggestions.items() if suggestion.has_bounds}
        numbers = Counter(self._topics.values())
        for name, topic in self._topics.items():
            field = self._given[name]["field"]
            if numbers[topic] == 1:
                continue
            if suggestions[name].has_bounds or (not field and topic not in with_bounds):
                continue
            suggestion = suggestions.pop(name)
            if field:
                self._notes[topic] = self._notes.get(topic, "") + f"{field}: {suggestion.left_out[0]}\n"
            del self._given[name]

    def _replay(self, suggestions: Mapping[str, Suggestion]) -> _Alerts:
        alerts = _Alerts()
        signals = {
            name: {**self._given[name], **{key: setting.value for key, setting in suggestion.settings.items()}}
            for name, suggestion in suggestions.items()
        }
        for group in self._groups:
            alerts.end_recording(self._judge(group, signals, alerts.note, None, []))
        return alerts

    def _judge(
        self,
        group: _Group,
        signals: Mapping[str, Mapping[str, Any]],
        on_event: Callable[[JudgedEvent], None],
        on_samples: Any,
        problems: List[str],
    ) -> float:
        """Replays a group; returns the time of its end, in s since 1970."""
        with Recordings(group.paths) as recordings:
            player = Player(recordings, namespace=self._namespace)
            judge = Judge(player, on_event, on_samples)
            parameters = {"robot_name": "recorded", "signals": self._placed(signals)}
            with self._located():
                judge.add("", parameters)
            judge.run()
            problems += (problem for problem in player.problems if problem not in problems)
            return player.wall_s

    def _placed(self, signals: Mapping[str, Mapping[str, Any]]) -> Dict[str, Dict[str, Any]]:
        """Returns signals without conditions on signals that are not among them."""
        return {
            name: {
                key: value
                for key, value in settings.items()
                if not (key in ("only_if", "latch_release_if") and value["signal"] not in signals)
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

    # The text

    def _text(self, suggestions: Mapping[str, Suggestion], alerts: _Alerts) -> str:
        names = [os.path.basename(os.path.abspath(path)) for path in self._paths]
        hours = duration_text(self._duration_s)
        if self._duration_s >= 3600.0:
            hours = f"{self._duration_s / 3600.0:.1f} h"
        total = sum(alerts.by_bound.values()) + sum(alerts.stale.values())
        lines = [
            f"# Suggested by `robot-health suggest` from {hours} of recordings: {list_text(names, 5)}",
            f"# Replayed with these thresholds, the recordings raise {count_text(total, 'alert')}.",
            "# The bounds are those of WARN: recordings of healthy robots do not show where errors begin.",
            "# docs/statistics.md explains how each value is computed. Review before use.",
            "alert_system:",
            "  ros__parameters:",
        ]
        for key, value in self._section.tree.items():
            if key != "signals":
                lines.append(f"    {key}: {_yaml(value)}")
        lines.append("    signals:")
        for name, settings in self._given.items():
            lines += self._signal(name, settings, suggestions[name], alerts, hours)
        watched = self._topics.values()
        left_out = {each.topic: each.type_name for each in self._channels if each.topic not in watched}
        if left_out and self._file is None:
            lines.append("    # Recorded, but not watched by this file:")
            lines += [f"    #   {topic} ({kind}){_hint(kind)}" for topic, kind in sorted(left_out.items())]
        for name, unchanged in self._unchanged.items():
            lines += [f"      {name}:", "        # not recorded: unchanged"]
            lines += [f"        {key}: {_yaml(value)}" for key, value in unchanged.items()] or ["        {}"]
        return "".join(f"{printable(line)}\n" for line in lines)

    def _signal(
        self, name: str, settings: Mapping[str, Any], suggestion: Suggestion, alerts: _Alerts, hours: str
    ) -> List[str]:
        measured = self._measured[name]
        invalid = f", {measured.bad_samples:,} of them invalid" if measured.bad_samples else ""
        samples = f"{count_text(measured.samples, 'sample')} in {duration_text(measured.duration_s)}{invalid}"
        lines = [f"      {name}:", f"        # {samples}"]
        if name in self._notes:
            lines.append(f"        # {self._notes[name]}")

        def add(text: str, key: str, comment: str) -> None:
            unit = "s" if key.endswith("_s") else str(settings.get("unit", ""))
            lines.append(f"        {text}".ljust(_COLUMN) + "# " + "; ".join(filter(None, [unit, comment])))

        def alerts_of(key: str, value: Any) -> str:
            if key in BOUNDS:
                return f"{count_text(alerts.by_bound[name, value], 'alert')} in {hours}; "
            return f"{count_text(alerts.stale[name], 'alert')} in {hours}; " if key == "stale_after_s" and value else ""

        for key, value in settings.items():
            evidence = alerts_of(key, value).rstrip("; ")
            if key in suggestion.seen:
                other, why = suggestion.seen[key]
                evidence += f"{'; ' * bool(evidence)}suggested: {_yaml(other)}; {why}"
            if evidence:
                add(f"{key}: {_yaml(value)}", key, f"given; {evidence}")
            else:
                lines.append(f"        {key}: {_yaml(value)}")
        for key in _ORDER:
            if key in suggestion.settings:
                value, evidence = suggestion.settings[key]
                add(f"{key}: {_yaml(value)}", key, f"{alerts_of(key, value)}{evidence}")
            elif key in suggestion.seen and key not in settings:
                value, evidence = suggestion.seen[key]
                add(f"# {key}: {_yaml(value)}", key, evidence)
        lines += [f"        # {reason}" for reason in suggestion.left_out]
        topic = self._topics[name]
        is_last = [each for each in self._given if self._topics[each] == topic][-1] == name
        if is_last and topic in self._notes:
            lines += [f"      # {topic}, {note}" for note in self._notes[topic].splitlines()]
        return lines


def _yaml(value: Any) -> str:
    """Returns a value as YAML on one line."""
    if isinstance(value, float):
        text = repr(value)
        return text if "." in text else text.replace("e", ".0e")  # YAML reads 1e-05 as text
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_yaml(key)}: {_yaml(element)}" for key, element in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_yaml, value))}]"
    if isinstance(value, str) and _PLAIN.match(value) and value.lower() not in _NOT_TEXT:
        return value
    return json.dumps(value, default=str)


_NOT_TEXT = ("y", "n", "yes", "no", "on", "off", "true", "false", "null")


def _hint(type_name: str) -> str:
    if type_name == "diagnostic_msgs/DiagnosticArray":
        return ': watch its statuses by name, field status["NAME"].level; docs/signals.md'
    if type_name.partition("/")[0] in SUPPORTED_PACKAGES:
        return ": has no numbers that can be watched, or is a topic of the middleware"
    return ": only std_msgs and sensor_msgs are suggested for"
