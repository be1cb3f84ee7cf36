"""Faults of the monitor itself: what keeps a part of it from working, so that it is reported and never silent.

Every part that can fail (a middleware, a server, an outlet) reports to the `Faults` of its node. alert_system shows
them: a log line when one begins or ends, and the status `alert_system: monitor` on /diagnostics.
"""

from __future__ import annotations

import threading
from typing import Any, Callable, Mapping, NamedTuple

from .formatting import printable
from .model import Level

_MAX_PARTS = 100
PARAMETERS_FAULT = "parameters"
"""Part of the fault that the node does not run with the parameters that it was given."""
OTHER_PARTS = "other parts"
"""Part under which the faults of parts beyond the limit are reported, as one."""


class Fault(NamedTuple):
    """One fault that has not ended."""

    level: Level
    """WARN if the part works with restrictions, ERROR if it does not work."""
    text: str
    """One line: what does not work and why."""


def summary_of(faults: Mapping[str, Fault]) -> tuple[Level, str]:
    """Returns level and text of the worst fault; OK and `no faults` without any."""
    if not faults:
        return Level.OK, "no faults"
    part, worst = max(faults.items(), key=lambda item: item[1].level.severity)
    return worst.level, f"{part}: {worst.text}"


class Faults:
    """The faults of one node, by part, or those that belong to no single node. May be used from any thread.

    Bounded to 100 parts; the faults of further ones are one fault, which ends when any part works again. A part that
    still fails then reports again.
    """

    def __init__(self) -> None:
        """Starts without faults."""
        self._lock = threading.Lock()
        self._faults: dict[str, Fault] = {}
        self._receivers: list[Faults] = []

    def add(self, receiver: Faults) -> None:
        """Passes on these faults, present and later ones, to a node that shows them."""
        with self._lock:
            self._receivers.append(receiver)
            for part, fault in self._faults.items():
                receiver.report(part, fault.text, fault.level)

    def report(self, part: str, text: str, level: Level = Level.ERROR) -> None:
        """Reports a fault in one line, in place of an earlier one of its part, such as `clock` or `outlet alerts`.

        An empty text is as `clear`.
        """
        if not text:
            self.clear(part)
            return
        text = printable(" ".join(text.split()))
        with self._lock:
            for receiver in self._receivers:
                receiver.report(part, text, level)
            if part not in self._faults and len(self._faults) >= _MAX_PARTS:
                part, text = OTHER_PARTS, f"more than {_MAX_PARTS} faults, the last one of {part}: {text}"
            self._faults[part] = Fault(level, text)

    def clear(self, part: str) -> None:
        """Reports that a part works again; does nothing if it had no fault."""
        if part in self._faults:
            with self._lock:
                self._faults.pop(part, None)
                self._faults.pop(OTHER_PARTS, None)
                for receiver in self._receivers:
                    receiver.clear(part)

    def current(self) -> Mapping[str, Fault]:
        """Returns a copy of the faults, by part, oldest first."""
        with self._lock:
            return dict(self._faults)

    def guard(self, part: str, function: Callable[..., object], *arguments: Any) -> None:
        """Calls a function of a part: an exception becomes the part's fault, which its next success clears."""
        try:
            function(*arguments)
        except Exception as error:
            self.report(part, f"{type(error).__name__}: {error}")
        else:
            self.clear(part)
