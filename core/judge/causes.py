"""A known cause (docs/rules.md, "One cause, one alert"): what follows from it is judged and shown, but not announced.

Creation is suppressed, resolution never: while a signal is held, a transition to a level that is worse than the
announced one is not announced; a transition to a better one always is. A signal is held by its own source while that
is silent, and by what it depends on. `Held` says whether it is; `Causes` knows what depends on what.
"""

from __future__ import annotations

import math
from typing import AbstractSet, Callable, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Tuple, TypeVar

from ..config.signal_config import LINK, SignalConfig, template_name
from ..values.formatting import duration_text
from .rule import TIME_TOLERANCE_S

Value = TypeVar("Value")


class Held:
    """Why worse levels of one signal are not announced now. Times are in seconds."""

    __slots__ = ("_cause", "awaits_until_s", "caused_s", "ended_s", "last_cause", "settles_until_s", "silence")

    def __init__(self) -> None:
        """Holds nothing yet."""
        self.silence = ""
        """The alert of its silent source; empty while it is not silent."""
        self.awaits_until_s: Optional[float] = None
        """Messages came again: until when its own sample may come. None: it came, or they did not."""
        self._cause = ""
        self.last_cause = ""
        """The nearest of its causes by `depends_on`, or that of the latest moment with one."""
        self.caused_s: Optional[float] = None
        """Since when it has had a cause by `depends_on`; None: it had none."""
        self.ended_s = 0.0
        """When the last one ended."""
        self.settles_until_s = 0.0
        """Until when it settles after that."""

    @property
    def cause(self) -> str:
        """The nearest of its causes by `depends_on`; empty without one."""
        return self._cause

    @cause.setter
    def cause(self, cause: str) -> None:
        self._cause = self.last_cause = cause

    def ended(self, now_s: float, settles_s: float) -> None:
        """Notes that no cause by `depends_on` is left."""
        self._cause = ""
        self.ended_s, self.settles_until_s = now_s, now_s + settles_s

    @property
    def text(self) -> str:
        """What it was caused by, and for how long; empty: by nothing that it depends on."""
        if self.caused_s is None:
            return ""
        return f"was caused by {self.last_cause} for {duration_text(self.ended_s - self.caused_s)}"

    def holds(self, now_s: float) -> bool:
        """Whether worse levels are not announced."""
        if self.silence or self._cause:
            return True
        if self.awaits_until_s is not None and now_s <= self.awaits_until_s + TIME_TOLERANCE_S:
            return True
        return self.caused_s is not None and now_s < self.settles_until_s - TIME_TOLERANCE_S

    def leave_out(self, downtime_s: float) -> None:
        """Lets a time count for nothing: the robot could not be reached, or was not watched."""
        self.settles_until_s += downtime_s
        if self.awaits_until_s is not None:
            self.awaits_until_s += downtime_s

    def restart(self, now_s: float, settles_s: float) -> None:
        """Time went back to `now_s`: running waits restart."""
        self.awaits_until_s = None
        self.settles_until_s = now_s + settles_s
        if self.caused_s is not None:
            self.caused_s, self.ended_s = min(self.caused_s, now_s), min(self.ended_s, now_s)


class Causes:
    """What each signal depends on, directly or not, by names: of signals, elements and sources, and `link`."""

    def __init__(self, depends_on: Mapping[str, Sequence[str]], sources: Mapping[str, str]) -> None:
        """Takes the direct causes of each signal, and its source, in the order of the configuration.

        Elements have those of their template.
        """
        self._ancestors: Dict[str, Tuple[str, ...]] = {}
        for name, direct in depends_on.items():
            nearest_first = dict.fromkeys(direct)
            for cause in _growing(nearest_first):
                of_cause = (*_of_signal(cause, depends_on, ()), _of_signal(cause, sources, ""))
                nearest_first.update(
                    dict.fromkeys(each for each in of_cause if each not in ("", name, sources.get(name)))
                )
            self._ancestors[name] = tuple(nearest_first)
        self.names = frozenset(cause for causes in self._ancestors.values() for cause in causes)
        """Every name that is a cause of another one."""

    def of(self, name: str) -> Sequence[str]:
        """Returns the causes of a signal, the nearest first."""
        return _of_signal(name, self._ancestors, ())

    def nearest(self, name: str, active: AbstractSet[str]) -> str:
        """Returns the nearest cause of a signal that is `active`; empty: none is."""
        return next((cause for cause in self.of(name) if cause in active), "")

    def first(self, names: Iterable[str]) -> List[str]:
        """Returns names with causes before what they cause, otherwise in their order."""
        given, ordered = list(names), []
        waiting = set(given)

        def place(name: str) -> None:
            if name in waiting:
                waiting.remove(name)
                for cause in self.of(name):
                    place(cause)
                ordered.append(name)

        for name in given:
            place(name)
        return ordered


def _growing(names: Mapping[str, None]) -> Iterator[str]:
    """Yields the keys of a mapping that grows meanwhile."""
    done = 0
    while done < len(names):
        yield list(names)[done]
        done += 1


def _of_signal(name: str, table: Mapping[str, Value], default: Value) -> Value:
    return table.get(name, table.get(template_name(name), default))


def causes_first(signals: Mapping[str, SignalConfig]) -> List[str]:
    """Returns the names of configured signals, causes before what they cause, otherwise in their order."""
    return causes_of(signals, lambda topic: topic).first(signals)


def causes_of(signals: Mapping[str, SignalConfig], resolved: Callable[[str], str]) -> Causes:
    """Returns what configured signals depend on; `resolved` returns the name of the source of a topic."""
    topics = {each.topic.lstrip("/"): resolved(each.topic) for each in signals.values()}

    def named(cause: str) -> str:
        return cause if cause == LINK or template_name(cause) in signals else topics.get(cause.lstrip("/"), cause)

    depends_on = {name: tuple(map(named, each.depends_on)) for name, each in signals.items()}
    return Causes(depends_on, {name: resolved(each.topic) for name, each in signals.items()})


def settle_s(config: SignalConfig) -> float:
    """Returns how long a signal settles when its last cause has ended."""
    return max(config.for_s, config.stale_after_s)


def await_s(config: SignalConfig) -> float:
    """Returns how long a signal waits for its own sample when messages come again; infinite if it is never stale."""
    return config.stale_after_s or math.inf
