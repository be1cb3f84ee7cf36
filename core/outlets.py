"""Outlets: everything that receives what the monitor announces, such as the log, topics, a terminal or a history.

Each event goes to every outlet. An outlet that raises affects no other outlet; it is reported as a fault.
"""

from __future__ import annotations

from typing import Callable, Dict, NamedTuple, Union

from .faults import Faults
from .formatting import with_hint
from .middleware import Severity
from .model import Level, Transition

_SEVERITY_OF_LEVEL = {
    Level.OK: Severity.INFO,
    Level.WARN: Severity.WARN,
    Level.ERROR: Severity.ERROR,
    Level.STALE: Severity.WARN,
}


class Notice(NamedTuple):
    """An event of the monitor itself, not of a signal: time went back, a part failed or works again."""

    now_s: float
    """When, in seconds on the node's clock."""
    severity: Severity
    """INFO, WARN or ERROR."""
    text: str
    """One line."""
    part: str = ""
    """The part of the monitor whose fault begins or ends (see `faults.py`); empty for any other notice."""


Event = Union[Transition, Notice]
"""What an outlet receives."""


def event_text(event: Event) -> str:
    """Returns the line that people read about an event: a transition with its hint."""
    return with_hint(event.text, event.hint) if isinstance(event, Transition) else event.text


def event_severity(event: Event) -> Severity:
    """Returns the severity of the log line about an event."""
    return _SEVERITY_OF_LEVEL[event.to_level] if isinstance(event, Transition) else event.severity


Outlet = Callable[[Event], None]
"""Receives one event. It must return quickly: the events of all signals wait for it."""


class Outlets:
    """Passes each event to every outlet, in the order in which they were added."""

    def __init__(self, faults: Faults) -> None:
        """Starts without outlets.

        Args:
            faults: where failing outlets are reported, as `outlet <name>`.
        """
        self._faults = faults
        self._outlets: Dict[str, Outlet] = {}

    def add(self, name: str, outlet: Outlet) -> None:
        """Adds an outlet, in place of an earlier one of the same name."""
        self._outlets[name] = outlet

    def emit(self, event: Event) -> None:
        """Passes an event to every outlet; never raises."""
        for name, outlet in tuple(self._outlets.items()):
            self._faults.guard(f"outlet {name}", outlet, event)
