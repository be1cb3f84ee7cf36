"""Sources (docs/rules.md, "Silence"): the topics that watched signals read. One that falls silent is one alert.

Theory of operation. Every message on a topic is a sign of life of its source: each sample of a signal that reads it,
and what `Monitor.observe_source` says. A source is *heard* from a message on, until it is *silent*: from the tick on at
which its silence is too long. Others may fall silent with it. One of them, the *head*, gives the alert its name, and
speaks for itself or, if it has a single signal and is alone, through that. The signals of all others are held
(alert.py). When the head is heard again, the others are *parted*: neither heard nor silent, until their limit has
passed once more.

A source that is heard costs nothing per sample: when its last message came follows at the tick from its signals. Only
while it is not do samples pass through `Sources.hear`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Callable, Iterable, Iterator, Mapping, Sequence

from ..config import SignalConfig, read_signal, template_name
from ..values import Changes, Level, Transition
from .alert import Alert
from .rule import TIME_TOLERANCE_S
from .saved_state import Downtime, SavedSignal, SavedState
from .signal_monitor import SignalMonitor
from .wording import Judgement

TOGETHER_S = 2.0
"""Sources whose last messages are no further apart may fall silent together."""
SHARE = 0.6
"""Part of its limit for which a source has been silent that falls silent with another one."""

_CONFIG = read_signal("source", {"field": ""})


def is_source(name: str) -> bool:
    """Whether a name is that of a source: a resolved topic."""
    return name.startswith("/")


class Source(Alert):
    """One topic that watched signals read, and the alert of its silence. Times are in seconds."""

    def __init__(self, config: SignalConfig, robot: str, now_s: float) -> None:
        """Begins to exist; the startup grace counts from `now_s`."""
        super().__init__(config, robot, now_s)
        self.signals: list[SignalMonitor] = []
        """Those that read the topic; a template only while it has no elements."""
        self.is_heard = False
        """Whether messages come; False before the first, and from a silence on."""
        self.was_silent = False
        """Whether it was ever announced, or silent with another one."""
        self.head: Source | None = None
        """The source that it is silent with, which gives the alert its name; None if that is itself."""
        self.speaks = False
        """Whether its silence is announced under its own name."""
        self.with_topics: tuple[str, ...] = ()
        """The others of its alert, when it was announced."""

    @property
    def name(self) -> str:
        """The resolved topic."""
        return self.config.name

    @property
    def is_silent(self) -> bool:
        """Whether its silence is too long."""
        return self.staleness.stale

    @property
    def is_shown(self) -> bool:
        """Whether it is a signal among the others: its alert is open, or it is silent with another one."""
        return self.is_announced or (self.is_silent and self.head is not None)

    @property
    def alert(self) -> str:
        """Name of the alert of its silence."""
        head = self.head or self
        return head.name if head.speaks or not head.signals else head.signals[0].config.name

    def judgement(self, now_s: float) -> Judgement:
        """Returns the state, as of a signal, with the number of signals and the other topics."""
        seen = 1.0 if self.staleness.seen else None
        return (
            super()
            .judgement(now_s)
            ._replace(
                latest=seen,
                judged=seen,
                good_samples=int(seen or 0),
                source_signals=len(self.signals),
                with_topics=self.with_topics,
            )
        )

    def listen(self) -> None:
        """Notes the latest message, by the samples of its signals."""
        if self.is_heard:
            seen = (each.staleness.last_seen_s for each in self.signals if each.staleness.seen)
            heard_s = max(seen, default=-math.inf)
            if heard_s > self.staleness.last_seen_s:
                self.staleness.arrive(heard_s)

    def hear(self, now_s: float) -> Transition | None:
        """Processes a message while it is not heard."""
        self.is_heard = True
        for signal in self.signals:
            signal.await_sample(now_s + (signal.config.stale_after_s or math.inf))
        self.hold("")
        self.staleness.arrive(now_s)
        self.note_sample(Level.OK, now_s)
        return self._settle(now_s)

    def part(self, now_s: float) -> None:
        """The alert that it is silent with has ended: its own limit counts from now."""
        self.head = None
        self.staleness.stale = False
        self.staleness.count_anew(self.staleness.first_limit_s, now_s)
        for each in (*self.signals, self):
            each.await_sample(math.inf)

    def fall_silent(self, now_s: float) -> Transition | None:
        """Makes it silent, with its `head` or by itself."""
        self.is_heard = False
        self.hold_signals()
        self.staleness.fall_silent()
        return self._settle(now_s)

    def hold_signals(self) -> None:
        """Holds what another name speaks for: its signals, and itself if it has a `head`; what speaks is let go."""
        self.was_silent = self.was_silent or self.speaks or self.head is not None
        is_quiet = self.head is None and not self.speaks
        for signal in self.signals:
            signal.hold("" if is_quiet else self.alert)
        self.hold("" if self.speaks else self.alert)

    def configure(self, config: SignalConfig, now_s: float) -> Transition | None:
        """Applies the limits of its signals."""
        if config == self.config:
            return None
        self._configure(config, now_s)
        return self._settle(now_s)

    def inhibit(self, now_s: float) -> None:
        """The robot cannot be reached from `now_s` on."""
        self.listen()
        super().inhibit(now_s)

    def release(self, now_s: float, *, is_link: bool) -> Transition | None:
        """Ends `inhibit`."""
        self.listen()
        self._end_downtime(now_s, is_link=is_link)
        return self._settle(now_s)

    def restart_time(self, now_s: float, back_s: float) -> None:
        """Time went back to `now_s` by `back_s`."""
        self.is_heard = False
        super().restart_time(now_s, back_s)

    def exchange(self, state: SavedState) -> None:
        """Writes the state, or continues from one; `Sources.relate` must follow."""
        super().exchange(state)
        self.was_silent = self.was_silent or state.is_saved
        silence = state.section("silence")
        self.speaks = silence.value("speaks", self.is_silent and self.speaks, False)
        silence.value("head", "" if self.head is None else self.head.name, "")
        is_silent = silence.value("is_silent", self.is_silent, False)
        silent_since_s = state.since_s("silent", self.staleness.counts_from_s if self.is_silent else None)
        if is_silent and state.is_saved:
            self.staleness.silent_since_s = silent_since_s
            self.staleness.fall_silent()


class Sources:
    """The sources of one robot."""

    def __init__(self, robot: str) -> None:
        """Starts without sources; they come with `expect`."""
        self._robot = robot
        self._names: Mapping[str, str] = {}
        self._are_expected = False
        self._by_name: dict[str, Source] = {}
        self._topic_of: dict[str, str] = {}
        """The resolved topic of each configured signal."""

    def __iter__(self) -> Iterator[Source]:
        return iter(self._by_name.values())

    def __len__(self) -> int:
        return len(self._by_name)

    def expect(self, names: Mapping[str, str]) -> None:
        """Lets every topic have a source; `names` are the resolved names of topics that are written otherwise."""
        self._names, self._are_expected = names, True

    def resolved(self, topic: str) -> str:
        """Returns the name of the source of a topic as it is configured; in no namespace if its name is not known."""
        return self._names.get(topic) or (topic if topic.startswith("/") else f"/{topic}")

    def of_signal(self, name: str) -> Source | None:
        """Returns the source of a signal or element; None if it has none."""
        return self._by_name.get(self._topic_of.get(template_name(name), ""))

    def is_heard(self, signal: str) -> bool:
        """Whether the samples of a signal can be judged at once: its source is heard, or it has none."""
        source = self.of_signal(signal)
        return source is None or source.is_heard

    def get(self, name: str) -> Source | None:
        """Returns a source by its name."""
        return self._by_name.get(name)

    def configure(self, configs: Iterable[SignalConfig], now_s: float, changes: Changes) -> None:
        """Follows the topics of the configured signals; the alert of a topic that none reads any more ends."""
        topics: dict[str, list[SignalConfig]] = {}
        for config in configs:
            if config.topic:
                topics.setdefault(self.resolved(config.topic), []).append(config)
        self._topic_of = {config.name: name for name, of_topic in topics.items() for config in of_topic}
        before, self._by_name = self._by_name, {}
        for name, of_topic in topics.items():
            source, config = before.pop(name, None), _config(name, of_topic)
            if source is not None:
                was_silent = source.is_silent
                self._by_name[name] = source
                changes.add(source.configure(config, now_s))
                if was_silent and not source.is_silent:
                    self._end(source, now_s)
            elif self._are_expected:
                self._by_name[name] = Source(config, self._robot, now_s)
        for source in before.values():
            changes.add(source.end(now_s))
            self._end(source, now_s)

    def arrange(self, signals_of: Callable[[str], Sequence[SignalMonitor]]) -> None:
        """Finds the signals of each source: `signals_of` returns those of a configured one, which may be a template."""
        for source in self:
            source.signals = []
        for name, topic in self._topic_of.items():
            if topic in self._by_name:
                self._by_name[topic].signals += signals_of(name)
        for source in self:
            if source.is_silent:
                source.hold_signals()

    def hear(self, source: Source, now_s: float, changes: Changes) -> None:
        """Processes a message of a source that is not heard."""
        changes.add(source.hear(now_s))
        self._end(source, now_s)

    def _end(self, source: Source, now_s: float) -> None:
        """Ends the silence of a source: those that are silent with it are parted."""
        source.head = None
        for other in self:
            if other.head is source:
                other.part(now_s)

    def tick(self, now_s: float, changes: Changes) -> bool:
        """Makes silent what has had no message for too long; returns whether there was any."""
        for source in self:
            source.listen()
        due = [source for source in self if source.staleness.is_due(now_s)]
        for source in due:
            if not source.is_silent:  # with an earlier one
                self._fall_silent(source, now_s, changes)
        return bool(due)

    def _fall_silent(self, due: Source, now_s: float, changes: Changes) -> None:
        due.head = next((each for each in self if each.is_silent and not each.head and _are_together(each, due)), None)
        others: list[Source] = []
        if due.head is None:
            others = [each for each in self if each is not due and _falls_with(each, due, now_s)]
        due.speaks = due.head is None and bool(others or len(due.signals) > 1)
        due.with_topics = tuple(each.name for each in others)
        for other in others:
            other.head, other.speaks, other.with_topics = due, False, ()
        for each in (due, *others):
            changes.add(each.fall_silent(now_s))

    def restore(self, name: str, state: SavedSignal, now_s: float, downtime: Downtime) -> Transition | None:
        """Continues from a snapshot; the alert of a topic that is no longer watched ends.

        Raises UnusableStateError. `relate` must follow.
        """
        known = self._by_name.get(name)
        source = Source(known.config if known else _shared_config(name, 0.0, 0.0), self._robot, now_s)
        source.exchange(SavedState(now_s, state, downtime))
        if known is None:
            return source.end(now_s)
        source.signals = known.signals
        self._by_name[name] = source
        return None

    def relate(self, states: Mapping[str, SavedSignal], now_s: float, changes: Changes) -> None:
        """Lets restored sources be silent together again; `states` are those that were restored."""
        for name, state in states.items():
            source = self._by_name.get(name)
            if source is not None and source.is_silent:
                head = self._by_name.get(state.get("silence", {}).get("head", ""))
                source.head = head if head is not None and head.is_silent else None
                changes.add(source.fall_silent(now_s))


def _config(name: str, of_topic: Sequence[SignalConfig]) -> SignalConfig:
    """Returns how a source is judged: its limits are the smallest of its signals that have any."""
    limited = [each for each in of_topic if each.stale_after_s > 0.0]
    stale_after_s = min((each.stale_after_s for each in limited), default=0.0)
    grace_s = min(each.startup_grace_s for each in limited or of_topic)
    return _shared_config(name, stale_after_s, grace_s)


@lru_cache(maxsize=10_000)
def _shared_config(name: str, stale_after_s: float, grace_s: float) -> SignalConfig:
    """Returns the same object for the same topic of many robots: each takes a kilobyte."""
    return replace(_CONFIG, name=name, topic=name, stale_after_s=stale_after_s, startup_grace_s=grace_s)


def _are_together(one: Source, other: Source) -> bool:
    apart_s = one.staleness.counts_from_s - other.staleness.counts_from_s
    return abs(apart_s) <= TOGETHER_S + TIME_TOLERANCE_S


def _falls_with(source: Source, due: Source, now_s: float) -> bool:
    """Whether a source falls silent together with one that is due."""
    staleness = source.staleness
    if source.is_silent or math.isinf(staleness.limit_s) or staleness.unreachable_since_s is not None:
        return False
    silent_s = now_s - staleness.counts_from_s
    return silent_s >= SHARE * staleness.counted_limit_s - TIME_TOLERANCE_S and _are_together(source, due)
