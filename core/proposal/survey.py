"""Listens to topics on any middleware, live or recorded, and measures the signals that they can have."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Dict, List, Mapping, Set

from ..config.signal_config import BOUNDS, SignalConfig
from ..judge.signal_monitor import SignalMonitor
from ..port.middleware import Middleware
from ..values.elements import DriverStatus, Elements, with_ages
from ..values.field_path import ABSENT
from .measured import Measured

MOST_ELEMENTS = 64
"""Elements of one field that are measured."""


class Survey:
    """Measures signals. Values are those that the monitor would judge, by its own code."""

    def __init__(self) -> None:
        """Starts without signals."""
        self.measured: Dict[str, Measured] = {}
        """What was measured of each signal."""
        self.elements: Dict[str, Dict[str, Measured]] = {}
        """What was measured of each element, by its name, of signals that select several."""
        self._monitors: List[List[SignalMonitor]] = []
        self.cut: Set[str] = set()
        """Signals that have more than `MOST_ELEMENTS` elements."""

    def begin_recording(self) -> None:
        """Ends the previous recording: the time up to the next one is no gap."""
        elements = [each for of_signal in self.elements.values() for each in of_signal.values()]
        for measured in (*self.measured.values(), *elements):
            measured.begin_recording()
        for monitor in self._monitors:
            monitor.clear()

    def listen(self, node: Middleware, configs: Mapping[str, SignalConfig]) -> None:
        """Subscribes to the topics of signals.

        Raises ConfigError: a type is unknown, or has no such field.
        """
        for name, config in configs.items():
            measured = self.measured.setdefault(name, Measured(config))
            receive = self._receiver(config, measured, node)
            node.subscribe(config.topic, config.type, receive, field=config.selection)

    def _receiver(self, config: SignalConfig, measured: Measured, node: Middleware) -> Callable[[object, float], None]:
        take = self._taker(config, measured)
        elements: Dict[str, Callable[[object, float], None]] = {}

        def receive(value: object, now_s: float) -> None:
            if value is ABSENT:
                return
            value = with_ages(value, node.stamp_s)
            if type(value) is not Elements or config.reduce:
                take(value, now_s)
                return
            measured.add(now_s, None)
            for name, element in value:
                if name not in elements:
                    if len(elements) >= MOST_ELEMENTS:
                        self.cut.add(config.name)
                        continue
                    known = self.elements.setdefault(config.name, {})
                    elements[name] = self._taker(config, known.setdefault(name, Measured(config)))
                elements[name](element.level if type(element) is DriverStatus else element, now_s)

        return receive

    def _taker(self, config: SignalConfig, measured: Measured) -> Callable[[object, float], None]:
        """Returns a function that adds a datum to what is measured of a signal."""
        monitor: List[SignalMonitor] = []
        self._monitors.append(monitor)
        is_last = config.statistic == "last"

        def take(value: object, now_s: float) -> None:
            if not monitor:
                monitor.append(SignalMonitor(_unbounded(config), "", now_s))
            monitor[0].observe(value, now_s)
            measured.add(now_s, monitor[0].latest_good if is_last else monitor[0].judged)

        return take


def _unbounded(config: SignalConfig) -> SignalConfig:
    none = dict.fromkeys(BOUNDS)
    return replace(config, **none, stale_after_s=0.0, only_if=None, latch_release_if=None)  # type: ignore[arg-type]
