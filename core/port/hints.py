"""Hints why a topic brings no samples, as far as a middleware knows: its publishers, their type, a similar topic.

`explain` makes the text; `Hints` keeps an adapter from asking too often. Adapters supply what they know of the graph.
"""

from __future__ import annotations

import difflib
import math
from collections import deque
from itertools import islice
from typing import Callable, Iterable, Mapping, Optional, Sequence

from ..values import Clock, canonical_type, list_text, printable

INCOMPATIBLE_QOS = "its publishers are not compatible in QoS"

Answer = Callable[[Optional[str]], None]
"""Receives the text, or None; may be called in any thread."""

_PERIOD_S = 10.0
_BURST_S = 0.5
_MOST_PER_BURST = 20
"""Lookups within `_BURST_S`: a tick must not be late because hundreds of signals lack samples."""
_MOST_KNOWN = 1000
_MOST_TOPICS = 500
"""Most topics that are compared: their names come from outside."""
_LONGEST_NAME = 100
_LONGEST_PART = 50
_SIMILAR = 0.7
"""Least similarity of names: `battery` and `battery_state` are, `battery_left` and `battery_rights` are not."""
_MOST_GONE = 3


class Hints:
    """Answers of a middleware by topic and type; each is looked up at most every 10 s, and 20 at once at most."""

    def __init__(self, look_up: Callable[[str, str, Answer], None], clock: Clock) -> None:
        """Starts without answers; `clock` returns monotonic seconds.

        `look_up` is called with the resolved topic, the configured type and what receives the answer, at once or later.
        It must not wait.
        """
        self._look_up = look_up
        self._clock = clock
        self._known: dict[tuple[str, str], tuple[float, str | None]] = {}
        """By topic and type: when it was looked up, and the answer."""
        self._latest_s: deque[float] = deque(maxlen=_MOST_PER_BURST)

    def get(self, topic: str, type_name: str) -> str | None:
        """Returns the latest answer; begins to look it up again if it is older than 10 s."""
        now_s, key = self._clock(), (topic, type_name)
        asked_s, text = self._known.get(key, (-math.inf, None))
        if not 0.0 <= now_s - asked_s < 2.0 * _PERIOD_S:
            text = None  # of an earlier silence
        is_burst = len(self._latest_s) == _MOST_PER_BURST and 0.0 <= now_s - self._latest_s[0] < _BURST_S
        if not (is_burst or 0.0 <= now_s - asked_s < _PERIOD_S):
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            self._latest_s.append(now_s)
            self._known[key] = now_s, text
            self._look_up(topic, type_name, lambda answer: self._known.update({key: (now_s, answer)}))
            _, text = self._known[key]
        return text


def explain(
    topic: str, type_name: str, types: Sequence[str], gone: Iterable[str] = (), similar: str | None = None
) -> str | None:
    """Returns why a topic brings no samples; None if its publishers give no reason.

    >>> explain("/battery", "std_msgs/Float32", [], similar="/battery_state")
    'no publisher on /battery; /battery_state exists'
    >>> explain("/battery", "std_msgs/Float32", ["sensor_msgs/msg/Temperature"])
    '/battery is published as sensor_msgs/Temperature, configured as std_msgs/Float32'

    The topic is published with `types`; if these are empty, it has no publisher, and `gone` are the nodes that
    published it and are not there any more, and `similar` is the topic that may be meant. An empty `type_name` stands
    for any type.
    """
    if not types:
        names = sorted(map(_shown, gone))[:_MOST_GONE]
        if names:
            return f"node {names[0]} is gone" if len(names) == 1 else f"nodes {list_text(names)} are gone"
        return f"no publisher on {_shown(topic)}" + (f"; {_shown(similar)} exists" if similar else "")
    wanted = canonical_type(type_name)
    published = [canonical_type(name) for name in types]
    if not wanted or wanted in published:
        return None
    return f"{_shown(topic)} is published as {_shown(published[0])}, configured as {wanted}"


def similar_topic(topic: str, type_name: str, published: Mapping[str, str]) -> str | None:
    """Returns the topic that may be meant in place of one that has no publisher; None if there is none.

    It has a similar last part of the name, else the configured type, unless that is one of std_msgs, which says nothing
    about the meaning. `published` are those that have publishers, with their types, empty where unknown.
    """
    others = {name: canonical_type(kind) for name, kind in islice(published.items(), _MOST_TOPICS) if name != topic}
    parts = {_last_part(name): name for name in others}
    for part in difflib.get_close_matches(_last_part(topic), parts, 1, _SIMILAR):
        return parts[part]
    wanted = canonical_type(type_name)
    has_meaning = wanted and not wanted.startswith("std_msgs/")
    return next((name for name, kind in others.items() if has_meaning and kind == wanted), None)


def _last_part(topic: str) -> str:
    """Returns the last part of a name, without what is often written differently."""
    return topic[topic.rfind("/") + 1 :][:_LONGEST_PART].replace("_", "").lower()


def _shown(name: str) -> str:
    return printable(name[:_LONGEST_NAME])
