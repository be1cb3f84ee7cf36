"""How a status looks in a table: texts, colours, and which of several is the worst."""

from __future__ import annotations

from rich.text import Text

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.model import Level, Status

__all__ = ["STYLE_OF_LEVEL", "UNKNOWN_STATES", "is_unknown", "level_text", "rank", "rank_of", "style", "value_text"]

STYLE_OF_LEVEL = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "magenta"}
_STYLE_OF_UNKNOWN = "cyan"
UNKNOWN_STATES = ("waiting", "unreachable")
"""States in which the level is not known: neither OK nor an alarm."""


def is_unknown(status: Status) -> bool:
    """Returns whether the level is not known."""
    return status.values.get("state") in UNKNOWN_STATES


def rank(status: Status) -> int:
    """Orders statuses from OK (0) to the worst; an unknown one is above OK and below every alarm."""
    return rank_of(status.level, status.values.get("state", ""))


def rank_of(level: Level, state: str) -> int:
    """Returns the rank of a level in a state, as `rank`."""
    return 1 if state in UNKNOWN_STATES else 2 * level.severity


def style(status: Status) -> str:
    """Returns the colour of a status, as rich names it."""
    return _STYLE_OF_UNKNOWN if is_unknown(status) else STYLE_OF_LEVEL[status.level]


def level_text(status: Status) -> Text:
    """Returns the level, or the state while the level is not known; says if notifications are silenced."""
    text = status.values["state"] if is_unknown(status) else status.level.name
    return Text(f"{text} silenced" if "silenced" in status.values else text, style=style(status))


def value_text(status: Status) -> str:
    """Returns the value with its unit."""
    return printable(f"{status.values.get('value') or '-'} {status.values.get('unit', '')}".strip())
