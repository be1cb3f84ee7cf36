"""Hints why a topic brings no samples, as far as a middleware knows: its publishers and their type.

`explain` makes the text; `Hints` keeps an adapter from asking too often. Adapters supply what they know of the graph.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Callable, Deque, Dict, Iterable, Optional, Sequence, Tuple

from ..values.formatting import list_text, printable
from ..values.names import canonical_type

Answer = Callable[[Optional[str]], None]
"""Receives the text, or None; may be called in any thread."""

_PERIOD_S = 10.0
_BURST_S = 0.5
_MOST_PER_BURST = 20
"""Lookups within `_BURST_S`: a tick must not be late because hundreds of signals lack samples."""
_MOST_KNOWN = 1000
_LONGEST_NAME = 100
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


def explain(topic: str, type_name: str, types: Sequence[str], gone: Iterable[str] = ()) -> Optional[str]:
    """Returns why a topic brings no samples; None if its publishers give no reason.

    >>> explain("/battery", "std_msgs/Float32", [])
    'no publisher on /battery'
    >>> explain("/battery", "std_msgs/Float32", ["sensor_msgs/msg/Temperature"])
    '/battery is published as sensor_msgs/Temperature, configured as std_msgs/Float32'

    The topic is published with `types`; if these are empty, it has no publisher, and `gone` are the nodes that
    published it and are not there any more. An empty `type_name` stands for any type.
    """
    if not types:
        names = sorted(map(_shown, gone))[:_MOST_GONE]
        if names:
            return f"node {names[0]} is gone" if len(names) == 1 else f"nodes {list_text(names)} are gone"
        return f"no publisher on {_shown(topic)}"
    wanted = canonical_type(type_name)
    found = [canonical_type(name) for name in types]
    if not wanted or wanted in found:
        return None
    return f"{_shown(topic)} is published as {_shown(found[0])}, configured as {wanted}"


def _shown(name: str) -> str:
    return printable(name[:_LONGEST_NAME])
