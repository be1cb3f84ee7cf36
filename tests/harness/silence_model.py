"""What is announced about silent topics and known causes: a model of docs/rules.md, written from its text alone.

It keeps everything on one axis of time in which the downtime of the link is left out, and asks each question anew
where the monitor keeps state. Signals have a bound `warn_above: 1` and no durations; there is no flapping.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any, Mapping, Sequence, Tuple

SEVERITY = {"OK": 0, "WARN": 1, "STALE": 2, "ERROR": 3}
EPSILON = 1e-6
Line = Tuple[float, str, str]
"""Time, name and level of a transition."""


@dataclass
class Signal:
    """One signal; times are on the axis without downtime."""

    name: str
    topic: str
    stale_after_s: float
    grace_s: float
    depends_on: Sequence[str]
    sample_s: float | None = None
    grace_from_s: float | None = 0.0
    is_stale: bool = False
    value: float = 0.0
    announced: str = "OK"
    held_by: str = ""  # the alert of its silent source
    awaits_from_s: float | None = None
    awaits_parted: bool = False
    cause: str = ""
    was_caused: bool = False
    settles_until_s: float = 0.0


@dataclass
class Topic:
    """One source."""

    name: str
    signals: list[Signal]
    message_s: float | None = None
    from_s: float = 0.0
    is_silent: bool = False
    anew_s: float | None = None
    """The limit since something made it count anew, from `from_s` on."""
    head: Topic | None = None
    speaks: bool = False
    announced: str = "OK"
    parted: bool = False

    def limit_s(self, signals: Sequence[Signal]) -> float:
        """Returns the smallest limit that is not 0."""
        limited = [each for each in signals if each.stale_after_s > 0.0]
        if not limited:
            return float("inf")
        stale_s = min(each.stale_after_s for each in limited)
        grace_s = min(each.grace_s for each in limited)
        if self.message_s is None:
            return grace_s
        return stale_s

    def silence(self, now_s: float) -> tuple[float, float]:
        """Returns for how long it has been silent, and its limit, both as they count now."""
        limit_s = self.limit_s(self.signals) if self.anew_s is None else self.anew_s
        return now_s - self.from_s, limit_s

    def count_anew(self, limit_s: float, now_s: float) -> None:
        """Counts a limit from now on, which never allows less than what counted before."""
        silent_s, before_s = self.silence(now_s)
        self.from_s, self.anew_s = now_s, max(limit_s, before_s - silent_s)


@dataclass
class Model:
    """The announcements of a monitor."""

    signals: list[Signal]
    lines: list[Line] = field(default_factory=list)
    now_s: float = 0.0
    downtime_s: float = 0.0
    down_since_s: float | None = None

    def __post_init__(self) -> None:
        names = dict.fromkeys(each.topic for each in self.signals)
        self.topics = [Topic(name, [each for each in self.signals if each.topic == name]) for name in names]
        self.by_name = {each.name: each for each in self.signals}
        self.topic_of = {each.name: each for each in self.topics}

    @property
    def time_s(self) -> float:
        return self.now_s - self.downtime_s

    def say(self, name: str, level: str) -> None:
        self.lines.append((self.now_s, name, level))

    # --- what is shown

    def level(self, signal: Signal) -> str:
        if self.down_since_s is not None:
            return "STALE"
        if signal.sample_s is None or signal.is_stale:
            return "STALE"
        return "WARN" if signal.value > 1.0 else "OK"

    def is_known(self, signal: Signal) -> bool:
        return self.down_since_s is None and (signal.sample_s is not None or signal.is_stale)

    # --- causes

    def is_bad(self, name: str) -> bool:
        if name in self.topic_of:
            return self.topic_of[name].is_silent
        return self.level(self.by_name[name]) in ("ERROR", "STALE")

    def nearest_cause(self, signal: Signal) -> str:
        layer, seen = list(signal.depends_on), []
        while layer:
            for name in layer:
                if self.is_bad(name):
                    return name
            seen += layer
            following: list[str] = []
            for name in layer:
                if name in self.by_name:
                    of_cause = self.by_name[name]
                    following += [*of_cause.depends_on, of_cause.topic]
            layer = [each for each in dict.fromkeys(following) if each not in (*seen, signal.name, signal.topic)]
        return ""

    def look_at_causes(self) -> None:
        for signal in self.causes_first():
            cause = self.nearest_cause(signal)
            had_cause, signal.cause = bool(signal.cause), cause
            if cause:
                signal.was_caused = True
            elif had_cause:
                signal.settles_until_s = self.time_s + signal.stale_after_s
                self.announce(signal)  # at once if it need not settle

    def causes_first(self) -> list[Signal]:
        ordered: list[Signal] = []

        def place(signal: Signal) -> None:
            for name in signal.depends_on:
                if name in self.by_name and self.by_name[name] not in ordered:
                    place(self.by_name[name])
            if signal not in ordered:
                ordered.append(signal)

        for signal in self.signals:
            place(signal)
        return ordered

    # --- announcements

    def is_held(self, signal: Signal) -> bool:
        if signal.held_by or signal.cause or signal.awaits_parted:
            return True
        if signal.awaits_from_s is not None:
            waited_s = self.time_s - signal.awaits_from_s
            if signal.stale_after_s == 0.0 or waited_s <= self.awaited_s(signal) + EPSILON:
                return True
        return signal.was_caused and self.time_s < signal.settles_until_s - EPSILON

    def awaited_s(self, signal: Signal) -> float:
        return signal.stale_after_s

    def announce(self, signal: Signal) -> None:
        if not self.is_known(signal):
            return
        level = self.level(signal)
        if self.is_held(signal):
            if SEVERITY[level] >= SEVERITY[signal.announced]:
                return
        else:
            signal.was_caused, signal.awaits_from_s = False, None
        if level != signal.announced:
            signal.announced = level
            self.say(signal.name, level)

    # --- events

    def message(self, topic_name: str, samples: Mapping[str, float]) -> None:
        topic = self.topic_of[topic_name]
        was_silent, was_head = topic.is_silent, topic.is_silent and topic.head is None
        if was_silent or topic.parted:
            for signal in topic.signals:
                if signal.held_by or signal.awaits_parted:
                    signal.held_by, signal.awaits_parted, signal.awaits_from_s = "", False, self.time_s
        topic.message_s = topic.from_s = self.time_s
        topic.is_silent, topic.anew_s, topic.head, topic.parted = False, None, None, False
        if topic.announced == "STALE":
            topic.announced = "OK"
            self.say(topic.name, "OK")
        if was_head:
            for other in self.topics:
                if other.head is topic:
                    other.head, other.is_silent, other.parted = None, False, True
                    other.count_anew(other.limit_s(other.signals), self.time_s)
                    for signal in other.signals:
                        if signal.held_by:
                            signal.held_by, signal.awaits_parted = "", True
        self.look_at_causes()
        for signal in self.causes_first():
            if signal.name in samples:
                signal.sample_s, signal.value = self.time_s, samples[signal.name]
                signal.is_stale, signal.grace_from_s, signal.awaits_from_s = False, None, None
                self.announce(signal)
                self.look_at_causes()

    def tick(self) -> None:
        if self.down_since_s is None:
            for topic in self.topics:
                silent_s, limit_s = topic.silence(self.time_s)
                if not topic.is_silent and silent_s > limit_s + EPSILON:
                    self.fall_silent(topic)
            self.look_at_causes()
        for signal in self.causes_first():
            if self.down_since_s is None and signal.stale_after_s > 0.0 and not signal.is_stale:
                signal.is_stale = self.is_too_late(signal)
            self.look_at_causes()
            self.announce(signal)
        self.look_at_causes()

    def is_too_late(self, signal: Signal) -> bool:
        if signal.sample_s is None:
            return self.time_s - (signal.grace_from_s or 0.0) > signal.grace_s + EPSILON
        late = self.time_s - signal.sample_s > signal.stale_after_s + EPSILON
        in_grace = signal.grace_from_s is not None and self.time_s - signal.grace_from_s <= signal.grace_s + EPSILON
        return late and not in_grace

    def fall_silent(self, due: Topic) -> None:
        def together(other: Topic) -> bool:
            return abs(other.from_s - due.from_s) <= 2.0 + EPSILON

        heads = [each for each in self.topics if each.is_silent and each.head is None and together(each)]
        others: list[Topic] = []
        if heads:
            due.head, due.speaks = heads[0], False
        else:
            for other in self.topics:
                silent_s, limit_s = other.silence(self.time_s)
                is_near = limit_s < float("inf") and silent_s >= 0.6 * limit_s - EPSILON
                if other is not due and not other.is_silent and is_near and together(other):
                    others.append(other)
            due.head, due.speaks = None, bool(others) or len(due.signals) > 1
        due.is_silent = True
        if due.speaks and due.announced == "OK":
            due.announced = "STALE"
            self.say(due.name, "STALE")
        for other in others:
            other.is_silent, other.head, other.speaks = True, due, False
        for topic in (due, *others):
            head = topic.head or topic
            for signal in topic.signals:
                signal.awaits_parted, signal.awaits_from_s = False, None
                speaks = topic.head is not None or topic.speaks
                signal.held_by = (head.name if head.speaks else head.signals[0].name) if speaks else ""

    def link(self, up: bool) -> None:
        if up and self.down_since_s is not None:
            lasted_s = self.now_s - self.down_since_s
            self.downtime_s += lasted_s
            self.down_since_s = None
            if lasted_s > 10.0:
                for topic in self.topics:
                    if not topic.is_silent:
                        limited = [each.grace_s for each in topic.signals if each.stale_after_s > 0.0]
                        topic.count_anew(min(limited, default=float("inf")), self.time_s)
                for signal in self.signals:
                    if not signal.is_stale:
                        signal.grace_from_s = self.time_s
                    if signal.awaits_from_s is not None:
                        # It has at least the startup grace from now on.
                        signal.awaits_from_s = max(
                            signal.awaits_from_s, self.time_s + signal.grace_s - signal.stale_after_s
                        )
            for signal in self.signals:
                self.announce(signal)
        elif not up and self.down_since_s is None:
            self.down_since_s = self.now_s
        self.look_at_causes()


def random_robot(chance: random.Random) -> dict[str, dict[str, Any]]:
    """Returns two to six signals on one to four topics, some of which depend on earlier ones or their topics."""
    topics = [f"/t{number}" for number in range(chance.randint(1, 4))]
    signals: dict[str, dict[str, Any]] = {}
    for number in range(chance.randint(2, 6)):
        known = [*signals, *dict.fromkeys(each["topic"] for each in signals.values())]
        topic = chance.choice(topics)
        causes = [each for each in chance.sample(known, min(len(known), chance.choice((0, 0, 1, 2)))) if each != topic]
        stale_after_s = chance.choice((0.0, 2.0, 5.0, 5.0, 5.0, 7.0, 20.0))
        signals[f"s{number}"] = {
            "topic": topic,
            "warn_above": 1.0,
            "stale_after_s": stale_after_s,
            "startup_grace_s": chance.choice((stale_after_s, 10.0, 30.0)),
            "depends_on": causes,
        }
    names = list(signals)
    chance.shuffle(names)  # causes may be configured behind what they cause
    return {name: signals[name] for name in names}
