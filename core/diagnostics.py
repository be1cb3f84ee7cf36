"""Statuses and transitions as diagnostic_msgs messages, in the mappings that the port carries (REP-107)."""

from __future__ import annotations

from typing import Dict, Iterable, Optional

from .formatting import datum_text, with_hint
from .middleware import Message
from .model import Status, Transition

STATUS_TYPE = "diagnostic_msgs/DiagnosticStatus"
ARRAY_TYPE = "diagnostic_msgs/DiagnosticArray"


def status_message(status: Status, node: str) -> Message:
    """Returns a DiagnosticStatus named `node: signal`, as tools expect."""
    return {
        "level": int(status.level),
        "name": f"{node}: {status.name}",
        "message": with_hint(status.message, status.hint),
        "hardware_id": status.hardware_id,
        "values": [{"key": key, "value": value} for key, value in status.values.items()],
    }


def array_message(statuses: Iterable[Status], node: str) -> Message:
    """Returns a DiagnosticArray; the adapter stamps its header."""
    return {"status": [status_message(status, node) for status in statuses]}


def alert_message(transition: Transition, node: str, silence: Optional[str] = None) -> Message:
    """Returns the DiagnosticStatus of one transition: its message is the alert line.

    `node` is the base name of the node that judged it, `silence` the text of its signal's silence, None without one.
    """
    value = "" if transition.value is None else datum_text(transition.value)
    if isinstance(transition.value, float):  # in full
        value = repr(transition.value)
    values: Dict[str, str] = {
        "from_level": transition.from_level.name,
        "to_level": transition.to_level.name,
        "value": value,
        "statistic": transition.statistic,
        "bound": "" if transition.bound is None else str(transition.bound),
        "now_s": str(transition.now_s),
        "since_s": str(transition.since_s),
        "fingerprint": transition.fingerprint,
    }
    if silence is not None:
        values["silenced"] = silence
    status = Status(transition.signal, transition.to_level, transition.text, transition.robot, values, transition.hint)
    return status_message(status, node)
