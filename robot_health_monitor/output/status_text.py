"""How a status looks in a table: texts, colours, and which of several is the worst."""

from __future__ import annotations

from typing import Sequence

from rich.text import Text

from robot_health_monitor.core.formatting import with_hint
from robot_health_monitor.core.model import Level, Status

__all__ = [
    "STYLE_OF_LEVEL",
    "UNKNOWN_STATES",
    "is_unknown",
    "level_text",
    "rank",
    "rank_counts",
    "rank_of",
    "reason_text",
]

STYLE_OF_LEVEL = {
    Level.OK: "green",
    Level.WARN: "black on bright_yellow",  # readable on a dark and on a light terminal
    Level.ERROR: "bold red",
    Level.STALE: "magenta",
}
_STYLE_OF_UNKNOWN = "cyan"
_RANKS = ((6, "ERROR"), (4, "STALE"), (2, "WARN"), (1, "unknown"), (0, "OK"))
UNKNOWN_STATES = ("waiting", "unreachable")
"""States in which the level is not known: neither OK nor an alarm."""


def is_unknown(status: Status) -> bool:
    """Returns whether the level is not known."""
    return status.state in UNKNOWN_STATES


def rank(status: Status) -> int:
    """Orders statuses from OK (0) to the worst; an unknown one is above OK and below every alarm."""
    return rank_of(status.level, status.state)


def rank_of(level: Level, state: str) -> int:
    """Returns the rank of a level in a state, as `rank`."""
    return 1 if state in UNKNOWN_STATES else 2 * level.severity


def rank_counts(ranks: Sequence[int]) -> str:
    """Returns how many there are of each rank: `2 ERROR, 198 OK`."""
    counts = [(ranks.count(number), name) for number, name in _RANKS]
    return ", ".join(f"{count} {name}" for count, name in counts if count)


def reason_text(status: Status) -> str:
    """Returns the reason for the level, with the hint why there are no samples."""
    return with_hint(status.message, status.hint)


def level_text(status: Status) -> Text:
    """Returns the level, or the state while the level is not known; says if notifications are silenced."""
    text = Text(status.state if is_unknown(status) else status.level.name)
    text.stylize(_STYLE_OF_UNKNOWN if is_unknown(status) else STYLE_OF_LEVEL[status.level])
    return text.append(" silenced") if status.silence is not None else text
