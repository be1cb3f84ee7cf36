"""Past alerts as JSON values."""

from __future__ import annotations

import sqlite3
from datetime import datetime, timezone
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple, TypeVar

from robot_health_monitor.core.errors import ConfigError, ServiceError
from robot_health_monitor.core.model import Level
from robot_health_monitor.runtime.times import iso_time

from ..history import queries
from ..history.history import History
from ..history.rows import StoredTransition
from .requests import ApiError

__all__ = ["PastAlerts", "Query", "query_of"]

_MOST = 1000
_USUAL = 100
_LARGEST_ID = 2**63 - 1

Result = TypeVar("Result")
Json = Dict[str, Any]


class Query(NamedTuple):
    """Which alerts to return."""

    robot: Optional[str]
    signal: Optional[str]
    level: Optional[Level]
    since_s: Optional[float]
    """In s since 1970."""
    before_id: Optional[int]
    limit: int
    open_only: bool
    """Only those that are the newest of their signal, and not OK."""


def query_of(parameters: Mapping[str, str]) -> Query:
    """Reads the parameters of a request.

    Raises:
        ApiError: one is invalid.
    """
    level = parameters.get("level") or None
    if level is not None and level not in Level.__members__:
        raise ApiError(400, f"level: expected {', '.join(Level.__members__)}, got {level[:20]}")
    before = _number(parameters, "before", 1, _LARGEST_ID)
    limit = _number(parameters, "limit", 1, _MOST)
    return Query(
        parameters.get("robot") or None,
        parameters.get("signal") or None,
        None if level is None else Level[level],
        _time(parameters.get("since", "")),
        before,
        _USUAL if limit is None else limit,
        parameters.get("open", "0") == "1",
    )


class PastAlerts:
    """Reads the history."""

    def __init__(self, history: History) -> None:
        """Reads nothing yet."""
        self._history = history

    def alerts(self, query: Query) -> Json:
        """Returns the answer of `/api/history`. May block."""

        def read(connection: sqlite3.Connection) -> Json:
            found = list(
                queries.transitions(
                    connection,
                    robot=query.robot,
                    signal=query.signal,
                    level=query.level,
                    since_s=query.since_s,
                    before_id=query.before_id,
                    limit=query.limit + 1,
                    newest_first=True,
                    open_only=query.open_only,
                )
            )
            shown = found[: query.limit]
            return {
                "alerts": [_alert(transition) for transition in shown],
                "more": len(found) > query.limit,
                "gaps": [
                    {"from": iso_time(gap.from_s), "to": iso_time(gap.to_s)}
                    for gap in queries.gaps(connection, query.since_s or 0.0)[-_MOST:]
                ],
            }

        return self._read(read)

    def alert(self, number: int) -> Optional[Tuple[Json, List[Tuple[float, Optional[float]]]]]:
        """Returns an alert and its samples (time in s since 1970, value); None if there is none. May block."""

        def read(connection: sqlite3.Connection) -> Optional[Tuple[Json, List[Tuple[float, Optional[float]]]]]:
            transition = queries.transition(connection, number)
            if transition is None:
                return None
            samples = queries.evidence(connection, number)
            finite = [(round(t, 3), value if value - value == 0.0 else None) for t, value in samples]
            return _alert(transition), finite

        return self._read(read)

    def _read(self, function: Callable[[sqlite3.Connection], Result]) -> Result:
        try:
            return self._history.read(function)
        except ConfigError as error:  # the file was replaced or damaged: not the fault of the request
            raise ServiceError(error.problem) from None


def _alert(transition: StoredTransition) -> Json:
    return {
        "id": transition.id,
        "time": iso_time(transition.wall_s),
        "robot": transition.robot,
        "signal": transition.signal,
        "from_level": transition.from_level.name,
        "to_level": transition.to_level.name,
        "value": transition.value,
        "statistic": transition.statistic,
        "bound": transition.bound,
        "since": iso_time(transition.wall_s - (transition.now_s - transition.since_s)),
        "text": transition.text,
        "hint": transition.hint,
        "repeat": transition.repeat,
    }


def _time(text: str) -> Optional[float]:
    if not text:
        return None
    try:
        time = datetime.fromisoformat(text.replace("Z", "+00:00"))
        return (time if time.tzinfo else time.replace(tzinfo=timezone.utc)).timestamp()
    except (ValueError, OverflowError):
        raise ApiError(400, f"since: expected a time such as 2026-11-22T05:00:00Z, got {text[:40]}") from None


def _number(parameters: Mapping[str, str], name: str, least: int, most: int) -> Optional[int]:
    text = parameters.get(name, "")
    if not text:
        return None
    if not (text.isascii() and text.isdigit()) or len(text) > 19 or not least <= int(text) <= most:
        raise ApiError(400, f"{name}: expected a whole number from {least} to {most}, got {text[:20]}")
    return int(text)
