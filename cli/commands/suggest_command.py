"""`robot-health suggest`: thresholds from recordings of healthy robots.

The recordings are read to measure, and replayed with what follows from that: the replay shows how long healthy values
are beyond a bound (`for_s`), which forecasts are silent, and how often the rest alerts. If that changes what is
proposed, they are replayed once more, to count the alerts.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections import Counter
from typing import Any, Dict, Iterator, Sequence

from ...core.config import BOUNDS, Section, read_monitor, read_yaml, template_name
from ...core.proposal.candidates import Candidates, Topic, absolute
from ...core.proposal.proposal import Proposed, propose
from ...core.proposal.suggestion import Signal
from ...core.proposal.thresholds_file import thresholds_text
from ...core.values import (
    ConfigError,
    JsonObject,
    Level,
    ServiceError,
    Transition,
    count_text,
    duration_text,
    list_text,
    printable,
)
from ...recordings.decoding import type_of
from ...recordings.judging import Judge, JudgedEvent
from ...recordings.middleware import Player
from ...recordings.reading import Recordings
from ...runtime.interrupts import Interrupts
from ..arguments import INTERRUPTED, Parser, add, add_recordings
from ..embedded import sections_of_nodes

Signals = Dict[str, Dict[str, Any]]
"""Settings of signals by their names."""


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Writes a thresholds.yaml to stdout, with the evidence for each value: for the arrivals of every "
        "periodic topic, the age of stamps, batteries, /diagnostics and every other number, or for the signals of "
        "--thresholds."
    )
    add_recordings(parser)
    add(parser, "--thresholds FILE", "suggest for the signals of this configuration")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Writes a thresholds.yaml on stdout, and problems of the recordings on stderr."""
    problems: list[str] = []
    try:
        study = _Study(arguments.recordings, arguments.namespace.strip("/"), problems)
        text = study.of_file(arguments.thresholds) if arguments.thresholds else study.of_recorded_topics()
    except KeyboardInterrupt:  # half a result must not look like success
        raise ServiceError(INTERRUPTED) from None
    finally:
        for problem in problems:
            sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
    sys.stdout.write(text)


class _Alerts:
    """The alerts of a replay, and how long each signal was beyond its bounds. Elements count for their template."""

    def __init__(self) -> None:
        self.total = 0
        """One that changes its level counts once."""
        self.numbers: Counter[tuple[str, Any]] = Counter()  # by signal and bound, or "STALE"
        self.longest_s: dict[str, float] = {}  # longest time beyond a bound, by signals that raised alerts
        self._since_s: dict[str, float] = {}

    def note(self, judged: JudgedEvent) -> None:
        event = judged.event
        if not isinstance(event, Transition) or event.repeat:
            return
        self._end(event.signal, judged.wall_s)
        configured = template_name(event.signal)
        self.total += event.from_level is Level.OK
        if event.to_level is Level.STALE:
            self.numbers[configured, "STALE"] += 1
        elif event.to_level is not Level.OK and event.bound is not None:
            self.numbers[configured, event.bound] += 1
            self._since_s[event.signal] = judged.wall_s

    def end_recording(self, wall_s: float) -> None:
        for signal in list(self._since_s):
            self._end(signal, wall_s)

    def of(self, signal: Signal, key: str, value: Any) -> str:
        """Returns how often a key of a signal alerts; empty if it is no key that does."""
        if key in BOUNDS:
            return count_text(self.numbers[signal.name, value], "alert")
        # A topic of several signals that falls silent is one alert, with the name of the topic.
        silent = sum(self.numbers[name, "STALE"] for name in (signal.name, signal.topic))
        return count_text(silent, "alert") if key == "stale_after_s" and value else ""

    def _end(self, signal: str, wall_s: float) -> None:
        lasted_s = wall_s - self._since_s.pop(signal, wall_s)
        configured = template_name(signal)
        self.longest_s[configured] = max(lasted_s, self.longest_s.get(configured, 0.0))


class _Study:
    """One run of the command."""

    def __init__(self, paths: Sequence[str], namespace: str, problems: list[str]) -> None:
        self._problems = problems
        self._paths = paths
        self._candidates = Candidates(namespace)
        with Recordings(paths) as recordings:
            self._channels = recordings.channels
            first, last = recordings.span_ns or (0, 0)
            self._duration_s = (last - first - sum(end - begin for begin, end in recordings.gaps_ns)) / 1e9

    def of_file(self, path: str) -> str:
        """Returns the text of a file with the settings of another one, and suggestions for them."""
        file = read_yaml(path)
        section = sections_of_nodes(file)["alert_system"]
        with file.located(section.path):
            config = read_monitor(Section((), section.tree))
            for name, given in section.tree["signals"].items():
                topic = absolute(config.signals[name].topic, self._candidates.namespace)
                self._candidates.signals[name] = Signal(name, topic, "given", dict(given))
            return self._text({key: value for key, value in section.tree.items() if key != "signals"})

    def of_recorded_topics(self) -> str:
        """Returns the text of a file for everything that is recorded."""
        self._candidates.add(_topic(channel) for channel in self._channels)
        return self._text({})

    def _text(self, others: JsonObject) -> str:
        candidates = self._candidates
        with self._played() as player:
            player.on_gap.append(lambda begin_s, end_s: candidates.begin_recording())
            candidates.listen(player.node("survey", {}), {channel.topic for channel in self._channels})
        proposed, alerts = self._replayed()
        lasted = duration_text(self._duration_s)
        names = [os.path.basename(os.path.abspath(path)) for path in self._paths]
        heading = [
            f"Suggested by `robot-health suggest` from {lasted} of recordings: {list_text(names, 5)}",
            f"Replayed with these thresholds, the recordings raise {count_text(alerts.total, 'alert')}.",
            "The bounds are those of WARN: recordings of healthy robots do not show where errors begin.",
            "docs/statistics.md explains how each value is computed. Review before use.",
        ]
        for signal in proposed.signals:
            signal.alerts = {key: alerts.of(signal, key, value) for key, value in signal.settings.items()}
        return thresholds_text(heading, others, proposed)

    def _replayed(self) -> tuple[Proposed, _Alerts]:
        """Returns what is proposed after a replay of the first proposal, and its alerts."""
        trial = propose(self._candidates, {})
        if not trial.signals:
            raise ConfigError(f"nothing to watch: {trial.reasons or 'no topic is recorded'}")
        alerts = self._replay(_watched(trial))
        proposed = propose(self._candidates, alerts.longest_s)
        if _watched(proposed) != _watched(trial):
            alerts = self._replay(_watched(proposed))
        return proposed, alerts

    def _replay(self, signals: Signals) -> _Alerts:
        alerts = _Alerts()
        with self._played() as player:
            if signals:
                judge = Judge(player, alerts.note)
                judge.add("suggested", {"robot_name": "recorded", "signals": signals})
            player.on_gap.append(lambda begin_s, end_s: alerts.end_recording(player.wall_s))
        alerts.end_recording(player.wall_s)
        return alerts

    @contextlib.contextmanager
    def _played(self) -> Iterator[Player]:
        """Plays the recordings to what the block adds to the player."""
        with Recordings(self._paths) as recordings:
            player = Player(recordings, namespace=self._candidates.namespace)
            yield player
            player.play()
            self._problems += (problem for problem in player.problems if problem not in self._problems)


def _watched(proposed: Proposed) -> Signals:
    return {each.name: each.settings for each in proposed.signals if not each.is_shown_only}


def _topic(channel: Any) -> Topic:
    """Returns a topic as recorded; without a usable definition, its arrivals can be watched."""
    try:
        return Topic(channel.topic, channel.type_name, type_of(channel).definitions)
    except ConfigError:
        return Topic(channel.topic, channel.type_name, None)
