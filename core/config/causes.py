"""A known cause (docs/rules.md, "One cause, one alert"): what depends on what.

core/judge/alert.py holds back what follows from a cause.
"""

from __future__ import annotations

from typing import AbstractSet, Callable, Iterable, Mapping, Sequence, TypeVar

from .signal_config import LINK, SignalConfig, template_name

Value = TypeVar("Value")


class Causes:
    """What each signal depends on, directly or not, by names: of signals, elements and sources, and `link`."""

    def __init__(self, depends_on: Mapping[str, Sequence[str]], sources: Mapping[str, str]) -> None:
        """Takes the direct causes of each signal, and its source, in the order of the configuration.

        Elements have those of their template.
        """
        self._ancestors: dict[str, tuple[str, ...]] = {}
        for name, direct in depends_on.items():
            nearest_first = list(direct)
            for cause in nearest_first:  # it grows meanwhile
                for each in (*_of_signal(cause, depends_on, ()), _of_signal(cause, sources, "")):
                    if each not in ("", name, sources.get(name), *nearest_first):
                        nearest_first.append(each)
            self._ancestors[name] = tuple(nearest_first)
        self.names = frozenset(cause for causes in self._ancestors.values() for cause in causes)
        """Every name that is a cause of another one."""

    def of(self, name: str) -> Sequence[str]:
        """Returns the causes of a signal, the nearest first."""
        return _of_signal(name, self._ancestors, ())

    def nearest(self, name: str, active: AbstractSet[str]) -> str:
        """Returns the nearest cause of a signal that is `active`; empty if none is."""
        return next((cause for cause in self.of(name) if cause in active), "")

    def first(self, names: Iterable[str]) -> list[str]:
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


def _of_signal(name: str, table: Mapping[str, Value], default: Value) -> Value:
    return table.get(name, table.get(template_name(name), default))


def causes_of(signals: Mapping[str, SignalConfig], resolved: Callable[[str], str] = str) -> Causes:
    """Returns what configured signals depend on; `resolved` returns the name of the source of a topic."""
    topics = {each.topic.lstrip("/"): resolved(each.topic) for each in signals.values()}

    def named(cause: str) -> str:
        return cause if cause == LINK or template_name(cause) in signals else topics.get(cause.lstrip("/"), cause)

    depends_on = {name: tuple(map(named, each.depends_on)) for name, each in signals.items()}
    return Causes(depends_on, {name: resolved(each.topic) for name, each in signals.items()})
