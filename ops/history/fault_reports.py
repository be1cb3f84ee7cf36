"""The faults of the history, passed on to every robot that uses it."""

from __future__ import annotations

import threading
from typing import Dict, List, Tuple

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level


class FaultReports:
    """Reports the same faults to several nodes, also to those that are added later. May be used from any thread."""

    def __init__(self) -> None:
        """Starts without faults."""
        self._lock = threading.Lock()
        self._receivers: List[Faults] = []
        self._current: Dict[str, Tuple[str, Level]] = {}

    def add(self, receiver: Faults) -> None:
        """Adds the faults of a node; does nothing if they have been added."""
        with self._lock:
            if not any(receiver is known for known in self._receivers):
                self._receivers.append(receiver)
                for part, (text, level) in self._current.items():
                    receiver.report(part, text, level)

    def remove(self, receiver: Faults) -> None:
        """Removes the faults of a node that has ended."""
        with self._lock:
            self._receivers = [known for known in self._receivers if known is not receiver]

    def report(self, part: str, text: str, level: Level = Level.ERROR) -> None:
        """Reports a fault, in place of an earlier one of the same part."""
        with self._lock:
            if self._current.get(part) != (text, level):
                self._current[part] = (text, level)
                for receiver in self._receivers:
                    receiver.report(part, text, level)

    def has(self, part: str) -> bool:
        """Returns whether a part has a fault."""
        with self._lock:
            return part in self._current

    def clear(self, part: str) -> None:
        """Reports that a part works again."""
        with self._lock:
            if self._current.pop(part, None) is not None:
                for receiver in self._receivers:
                    receiver.clear(part)
