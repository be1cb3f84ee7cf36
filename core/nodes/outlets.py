"""Outlets: everything that receives what the monitor announces, such as the log, topics, a terminal or a history.

Each event goes to every outlet. An outlet that raises affects no other outlet; it is reported as a fault. `event_text`
and `json_line` give the forms in which most outlets write an event: on stdout, in webhooks, on the stdin of commands.
`alert_message` and `status_message` give diagnostic_msgs messages, in the mappings that the port carries (REP-107).
"""

from __future__ import annotations

import json
from typing import Any, Callable, Iterable, NamedTuple, Union

from ..messages import json_text
from ..port import Severity
from ..values import OWN_KEY, Faults, Level, Message, Status, Transition, datum_text, fingerprint, with_hint

FIELDS = tuple(name for name in Transition.__dataclass_fields__ if name != "status")
"""The fields of a transition in JSON. Its status is left out: it repeats them as text."""

_MOST_VALUE_CHARS = 2_000
"""Longest value that is written in full: a robot may send a text of a megabyte where a number belongs."""
_KEY_VALUES = ("from_level", "to_level", "value", "statistic", "bound", "now_s", "since_s", "fingerprint")
"""The fields of a transition that are key-values of its message on `alerts`."""
_SEVERITY_OF_LEVEL = {
    Level.OK: Severity.INFO, Level.WARN: Severity.WARN, Level.ERROR: Severity.ERROR, Level.STALE: Severity.WARN,
}  # fmt: skip


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

Outlet = Callable[[Event], None]
"""Receives one event. It must return quickly: the events of all signals wait for it."""


class Outlets:
    """Passes each event to every outlet, in the order in which they were added."""

    def __init__(self, faults: Faults) -> None:
        """Starts without outlets; one that fails is reported to `faults` as `outlet <name>`."""
        self._faults = faults
        self._outlets: dict[str, Outlet] = {}

    def add(self, name: str, outlet: Outlet) -> None:
        """Adds an outlet, in place of an earlier one of the same name."""
        self._outlets[name] = outlet

    def emit(self, event: Event) -> None:
        """Passes an event to every outlet; never raises."""
        for name, outlet in tuple(self._outlets.items()):
            self._faults.guard(f"outlet {name}", outlet, event)


def event_text(event: Event) -> str:
    """Returns the line that people read about an event: a transition with its hint."""
    return with_hint(event.text, event.hint) if isinstance(event, Transition) else event.text


def event_severity(event: Event) -> Severity:
    """Returns the severity of the log line about an event."""
    return _SEVERITY_OF_LEVEL[event.to_level] if isinstance(event, Transition) else event.severity


def json_line(transition: object, **further: object) -> str:
    """Formats a transition as one JSON object: levels by name, NaN and infinities as null, ASCII only.

    A value longer than 2,000 characters, which is not a measurement, is truncated. `transition` may be another object
    with the fields of a Transition; `further` fields are added.
    """
    fields: dict[str, Any] = {**{name: getattr(transition, name) for name in FIELDS}, **further}
    written = {name: _as_json(value) for name, value in fields.items()}
    if not isinstance(fields["value"], float) and len(json.dumps(written["value"])) > _MOST_VALUE_CHARS:
        written["value"] = datum_text(fields["value"])
    return json.dumps(written)


def _as_json(value: object) -> Any:
    if isinstance(value, Level):
        return value.name
    try:
        return json.loads(json_text(value))
    except (ValueError, RecursionError):  # such as an integer of 5,000 digits, which Python does not convert to text
        return datum_text(value)


def status_message(status: Status, node: str) -> Message:
    """Returns a DiagnosticStatus named `node: signal`, as tools expect.

    Every one has a fingerprint, which keeps it from being watched by `*`, here or by another monitor.
    """
    name = f"{node}: {status.name}"
    values = status.values
    if OWN_KEY not in values:
        values = {**values, OWN_KEY: fingerprint(status.hardware_id, name)}
    return {
        "level": int(status.level),
        "name": name,
        "message": with_hint(status.message, status.hint),
        "hardware_id": status.hardware_id,
        "values": [{"key": key, "value": value} for key, value in values.items()],
    }


def array_message(statuses: Iterable[Status], node: str) -> Message:
    """Returns a DiagnosticArray; the adapter stamps its header."""
    return {"status": [status_message(status, node) for status in statuses]}


def alert_message(transition: Transition, node: str, silence: str | None = None) -> Message:
    """Returns the DiagnosticStatus of one transition: its message is the alert line.

    `node` is the base name of the node that judged it, `silence` the text of its signal's silence, None without one.
    """
    values = {name: _text(getattr(transition, name)) for name in _KEY_VALUES}
    if isinstance(transition.value, str):
        values["value"] = datum_text(transition.value)
    if silence is not None:
        values["silenced"] = silence
    status = Status(transition.signal, transition.to_level, transition.text, transition.robot, values, transition.hint)
    return status_message(status, node)


def _text(value: object) -> str:
    if isinstance(value, Level):
        return value.name
    if isinstance(value, (float, str)):
        return str(value)  # in full
    return "" if value is None else datum_text(value)
