"""Signals that come and go: each element of a field with `[*]` or a pattern, and no `reduce`, is one of its own.

The configured signal is the *template* of its elements. It has a state of its own: its value is the number of its
elements, and it is STALE while it has none. See docs/rules.md, "Each element by itself".
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import Callable, Mapping

from ..config import LONGEST_NAME, SignalConfig, is_element_name, read_signal, template_name
from ..values import BadDatum, Changes, Elements, datum_text
from .signal_monitor import SignalMonitor

Begin = Callable[[SignalMonitor], None]
"""Prepares the signal of a new element before its first sample."""

_MARK = 8
"""Digits that tell two names apart that would look the same."""
MOST_REFUSED = 1000
"""Most names beyond `max_elements` that are counted: a driver may rename itself with each message."""
LEAST_NAMES = 60
"""Fewest names of elements that are new to a template in a minute and still watched; otherwise `max_elements`."""
_MINUTE_S = 60.0
"""Also how long none of them came when an excess of elements is over."""
_SHARED_KEYS = ("topic", "type", "field", "stale_after_s", "startup_grace_s", "repeat_s")
"""Keys of a template that also hold for its own state."""


class ElementSignals:
    """The elements of one template, and its own state. Times (`now_s`) are in seconds."""

    def __init__(self, config: SignalConfig, robot: str, now_s: float) -> None:
        """Starts without elements; `config` is that of the template."""
        self.config = config
        self.own = SignalMonitor(own_config(config), robot, now_s)
        """The state of the template: the number of its elements."""
        self.signals: dict[str, SignalMonitor] = {}
        """The elements by the names of their signals, first seen first."""
        self._robot = robot
        self._is_bad = False
        """Whether the latest message was invalid as a whole."""
        self._unknown_since_s = now_s
        """Elements that come from now on were unknown at least since then."""
        self._refused: set[int] = set()
        self._refused_s = now_s
        self._admitted = 0
        """Names that were new since `_admitted_from_s`."""
        self._admitted_from_s = now_s

    def observe(self, value: object, now_s: float, begin: Begin, changes: Changes) -> list[SignalMonitor]:
        """Judges what a template received; returns the signals of its elements. `begin` is called with new ones."""
        if not isinstance(value, Elements):
            self._is_bad = True
            bad = value if isinstance(value, BadDatum) else BadDatum(f"not an array: {datum_text(value)}")
            changes.add(self.own.observe(bad, now_s))
            return []
        self._is_bad = False
        observed: list[SignalMonitor] = []
        template = self.config.name
        for element, datum in value:
            # Most names are as received.
            signal = self.signals.get(f"{template}[{element}]") or self._signal_of(element, now_s, begin)
            if signal is not None:
                changes.add(signal.observe(datum, now_s))
                observed.append(signal)
        return observed

    def _signal_of(self, element: object, now_s: float, begin: Begin) -> SignalMonitor | None:
        """Returns the signal of an element by its name as received, a new one if there is room; None if not."""
        text = element if isinstance(element, str) else datum_text(element)
        name = element_signal_name(self.config.name, text)
        signal = self.signals.get(name)
        if signal is None:
            most = self.config.max_elements
            if now_s - self._admitted_from_s >= _MINUTE_S:
                self._admitted, self._admitted_from_s = 0, now_s
            if len(self.signals) >= most or self._admitted >= max(most, LEAST_NAMES):
                self._refused_s = now_s
                if len(self._refused) < MOST_REFUSED:
                    self._refused.add(hash(text))
                return None
            self._admitted += 1
            signal = self.signals[name] = SignalMonitor(replace(self.config, name=name), self._robot, now_s)
            signal.announced_since_s = self._unknown_since_s
            begin(signal)
        return signal

    @property
    def excess(self) -> int:
        """How many elements beyond `max_elements` came lately, at most 1,000: no more are counted."""
        return len(self._refused)

    def count(self, now_s: float, changes: Changes) -> None:
        """Notes how many elements there are; without any, the template has no sample."""
        if self.signals and not self._is_bad:
            changes.add(self.own.observe(float(len(self.signals)), now_s))

    def forget_silent(self, now_s: float, changes: Changes) -> bool:
        """Ends the elements that have been silent for `forget_after_s`; returns whether there were any."""
        if self._refused and now_s - self._refused_s > _MINUTE_S:
            self._refused.clear()
        limit_s = self.config.forget_after_s
        if limit_s <= 0.0:
            return False
        silent = [name for name, each in self.signals.items() if each.staleness.silence_s(now_s) > limit_s]
        self._end(silent, now_s, changes)
        return bool(silent)

    def configure(self, config: SignalConfig, now_s: float, changes: Changes) -> None:
        """Applies a new configuration of the template. Elements of another source end; the first ones stay."""
        before, self.config = self.config, config
        if config == before:
            return
        changes.add(self.own.configure(own_config(config), now_s))
        moved = (before.topic, before.type, before.field) != (config.topic, config.type, config.field)
        self._end(list(self.signals)[0 if moved else config.max_elements :], now_s, changes)
        for name, signal in self.signals.items():
            changes.add(signal.configure(replace(config, name=name), now_s))
        self._refused.clear()

    def restart_time(self, now_s: float) -> None:
        """Time went back to `now_s`."""
        self._unknown_since_s = min(self._unknown_since_s, now_s)
        self._refused_s = min(self._refused_s, now_s)
        self._admitted_from_s = min(self._admitted_from_s, now_s)

    def restore(self, name: str, restored: SignalMonitor) -> bool:
        """Continues with a signal whose state was restored; returns whether there is room for it."""
        if name == self.config.name:
            self.own = restored
        elif len(self.signals) < self.config.max_elements:
            self.signals[name] = restored
        else:
            return False
        return True

    def _end(self, names: list[str], now_s: float, changes: Changes) -> None:
        for name in names:
            changes.add(self.signals.pop(name).end(now_s))
        if names:
            self._unknown_since_s = now_s


def element_signal_name(template: str, element: str) -> str:
    """Returns the name of an element's signal: printable, at most 120 characters, another one for every element.

    >>> element_signal_name("drivers", "motor_driver: left")
    'drivers[motor_driver: left]'
    """
    most = LONGEST_NAME - len(template) - len("[]")
    if len(element) > most or not element.isprintable():
        digits = hashlib.sha256(element.encode("utf-8", "surrogatepass")).hexdigest()[:_MARK]
        shown = "".join(letter if letter.isprintable() else "?" for letter in element[: most - _MARK - 1])
        element = f"{shown}~{digits}"
    return f"{template}[{element}]"


def own_config(config: SignalConfig) -> SignalConfig:
    """Returns how the state of a template itself is judged: it has no bounds. Of another signal, its configuration."""
    if not config.is_template:
        return config
    return read_signal(config.name, {key: getattr(config, key) for key in _SHARED_KEYS})


def config_of(name: str, configured: Mapping[str, SignalConfig]) -> SignalConfig | None:
    """Returns the configuration of a signal by its name, which may be that of an element; None if it is not watched."""
    config = configured.get(name)
    if config is not None:
        return own_config(config)
    template = configured.get(template_name(name))
    if template is None or not template.is_template or not is_element_name(name):
        return None
    return replace(template, name=name)


def unconfigured(name: str) -> SignalConfig:
    """Returns a configuration for a signal that has none, to end its alert.

    Raises ConfigError if it cannot be one.
    """
    is_element = is_element_name(name)
    return replace(read_signal(template_name(name) if is_element else name, {}), name=name)


def element_of(name: str) -> str:
    """Returns the name of the element in the name of its signal."""
    return name[len(template_name(name)) + 1 : -1]
