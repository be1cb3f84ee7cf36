"""Hints why a topic brings no samples, as far as a middleware knows: its publishers, their type, similar topics.

`explain` makes the text; `Hints` keeps an adapter from asking too often. Adapters supply what they know of the graph.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import islice
from typing import Callable, Container, Deque, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

from ..values.formatting import list_text, printable
from ..values.names import canonical_type

INCOMPATIBLE_QOS = "its publishers are not compatible in QoS"

Answer = Callable[[Optional[str]], None]
"""Receives the text, or None; may be called in any thread."""

_PERIOD_S = 10.0
_BURST_S = 0.5
_MOST_PER_BURST = 20
"""Lookups within `_BURST_S`: a tick must not be late because hundreds of signals lack samples."""
_MOST_KNOWN = 1000
_MOST_TOPICS = 5000
"""Most topics that are compared: their names come from outside."""
_LONGEST_NAME = 100
_SHORTEST_PART = 4
"""A name shorter than this is not looked for within others: `imu` is part of many words."""
_FAR = 3
_MOST_GONE = 3


class Hints:
    """Answers of a middleware by topic and type; each is looked up at most every 10 s, and 20 at once at most."""

    def __init__(self, look_up: Callable[[str, str, Answer], None], clock: Callable[[], float]) -> None:
        """Starts without answers; `clock` returns monotonic seconds.

        `look_up` is called with the resolved topic, the configured type and what receives the answer, at once or later.
        It must not wait.
        """
        self._look_up = look_up
        self._clock = clock
        self._known: Dict[Tuple[str, str], Tuple[float, Optional[str]]] = {}
        """By topic and type: when it was looked up, and the answer."""
        self._latest_s: Deque[float] = deque(maxlen=_MOST_PER_BURST)

    def get(self, topic: str, type_name: str) -> Optional[str]:
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
            self._look_up(topic, type_name, lambda found: self._known.update({key: (now_s, found)}))
            _, text = self._known[key]
        return text


def explain(
    topic: str, type_name: str, types: Sequence[str], similar: Iterable[str], gone: Iterable[str] = ()
) -> Optional[str]:
    """Returns why a topic brings no samples; None if its publishers give no reason.

    >>> explain("/battery", "std_msgs/Float32", [], ["/battery_state"])
    'no publisher on /battery; /battery_state exists'
    >>> explain("/battery", "std_msgs/Float32", ["sensor_msgs/msg/Temperature"], [])
    '/battery is published as sensor_msgs/Temperature, configured as std_msgs/Float32'

    The topic is published with `types`; empty: it has no publisher, `gone` are the nodes that published it and are not
    there any more, and `similar` are published topics of similar names, the best first. An empty `type_name` stands for
    any type.
    """
    if not types:
        names = sorted(map(_shown, gone))[:_MOST_GONE]
        if names:
            return f"node {names[0]} is gone" if len(names) == 1 else f"nodes {list_text(names)} are gone"
        return with_similar(f"no publisher on {_shown(topic)}", similar)
    wanted = canonical_type(type_name)
    found = [canonical_type(name) for name in types]
    if not wanted or wanted in found:
        return None
    return f"{_shown(topic)} is published as {_shown(found[0])}, configured as {wanted}"


def with_similar(text: str, similar: Iterable[str]) -> str:
    """Appends the first of the topics that may be meant, if there is one."""
    other = next(iter(similar), None)
    return text if other is None else f"{text}; {_shown(other)} exists"


def similar_topics(topic: str, type_name: str, topics: Mapping[str, str], own: Container[str] = ()) -> List[str]:
    """Returns the topics that may be meant in place of one that has no publisher, the best first.

    A similar last part of the name counts, and the configured type unless it is one of std_msgs, which says nothing
    about the meaning.

    `topics` are those that exist, with their types, empty where unknown; `own` are those that the node itself uses.
    """
    namespace, base = topic.rpartition("/")[0], _base(topic)
    wanted_type = canonical_type(type_name)
    spellings = {wanted_type, wanted_type.replace("/", "/msg/")} - {""}
    tells_by_type = not wanted_type.startswith("std_msgs/")
    found: List[Tuple[int, bool, bool, str]] = []
    for other, other_type in islice(topics.items(), _MOST_TOPICS):
        distance = _distance(base, _base(other))
        has_type = other_type in spellings
        if (distance < _FAR or (tells_by_type and has_type)) and other != topic and other not in own:
            found.append((distance, not has_type, other.rpartition("/")[0] != namespace, other))
    return [other for _, _, _, other in sorted(found)]


def _base(topic: str) -> str:
    """Returns the last part of a name, without what is often written differently."""
    return topic[topic.rfind("/") + 1 :].replace("_", "").lower()


def _distance(mine: str, theirs: str) -> int:
    """Returns 0 for the same last part, 1 for a typing mistake, 2 if one is part of the other, else `_FAR`."""
    if mine == theirs:
        return 0
    shorter, longer = (mine, theirs) if len(mine) < len(theirs) else (theirs, mine)
    if len(shorter) < _SHORTEST_PART:
        return _FAR
    if len(longer) - len(shorter) <= 1 and _differ_in_one_letter(mine, theirs):
        return 1
    return 2 if shorter in longer else _FAR


def _differ_in_one_letter(a: str, b: str) -> bool:
    """Whether one letter was replaced, left out, added, or exchanged with its neighbour."""
    if a[:2] != b[:2] and a[-2:] != b[-2:] and len(a) > _SHORTEST_PART:  # most names, quickly
        return False
    begin = 0
    while begin < min(len(a), len(b)) and a[begin] == b[begin]:
        begin += 1
    a, b = a[begin:], b[begin:]
    return a[1:] == b[1:] or a[1:] == b or a == b[1:] or (a[:2] == b[1::-1] and a[2:] == b[2:])


def _shown(name: str) -> str:
    return printable(name[:_LONGEST_NAME])
