"""Rows of a history file, checked when they are read: other programs and damage may have put anything into them.

A row with an unexpected value is skipped, and noted at its connection, so that it can be reported in one line.
"""

from __future__ import annotations

import functools
import json
import math
import sqlite3
from typing import Any, Callable, Dict, Iterator, List, Sequence, Tuple

Check = Callable[[Any], bool]

LATEST_S = 253_402_300_000.0
"""Latest time that is accepted, in s since 1970: the end of the year 9999."""
_MOST_NOTED = 1000


class CheckedConnection(sqlite3.Connection):
    """A connection that notes which rows were skipped. In texts that are not UTF-8, the odd characters are replaced."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Opens the database, as `sqlite3.connect`, of which this is a `factory`."""
        super().__init__(*arguments, **options)
        self.text_factory = functools.partial(str, encoding="utf-8", errors="replace")
        self.skipped: Dict[str, None] = {}
        """The rows that were skipped, such as `transitions 17`; the first thousand."""

    @property
    def skipped_text(self) -> str:
        """One line about the rows that were skipped; empty: none were."""
        if not self.skipped:
            return ""
        count = len(self.skipped)
        rows = f"{count} rows have" if count > 1 else "a row has"
        return f"{rows} unexpected values and {'are' if count > 1 else 'is'} skipped ({next(iter(self.skipped))})"


def skip(connection: sqlite3.Connection, table: str, row: object) -> None:
    """Notes that a row was skipped."""
    if isinstance(connection, CheckedConnection) and len(connection.skipped) < _MOST_NOTED:
        connection.skipped[f"{table} {row!r:.60}"] = None


def checked(
    connection: sqlite3.Connection, table: str, rows: Sequence[Sequence[Any]], checks: Sequence[Check]
) -> Iterator[Tuple[Any, ...]]:
    """Yields the rows whose values pass; skips the others.

    Args:
        connection: where they come from.
        table: its name.
        rows: what was read; the first column identifies the row.
        checks: one per column.
    """
    for row in rows:
        if all(check(value) for check, value in zip(checks, row)):
            yield tuple(row)
        else:
            skip(connection, table, row[0])


def is_number(value: object) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, (int, float)) and math.isfinite(value)


def is_time(value: object) -> bool:
    """Whether a value is a time in s since 1970 that a calendar has."""
    return isinstance(value, (int, float)) and -LATEST_S <= value <= LATEST_S


def is_text(value: object) -> bool:
    """Whether a value is a text."""
    return isinstance(value, str)


def is_level(value: object) -> bool:
    """Whether a value is the number of a level."""
    return value in (0, 1, 2, 3) and isinstance(value, int)


def is_count(value: object) -> bool:
    """Whether a value is an integer; flags are 0 and 1."""
    return isinstance(value, int)


def is_datum(value: object) -> bool:
    """Whether a value is what a robot may have sent: a finite number, a text or nothing."""
    return value is None or isinstance(value, str) or is_number(value)


def is_json_object(value: object) -> bool:
    """Whether a value is the text of a JSON object."""
    try:
        return isinstance(json.loads(value), dict)  # type: ignore[arg-type]
    except (TypeError, ValueError, RecursionError):
        return False


def optional(check: Check) -> Check:
    """Returns a check that also accepts NULL."""
    return lambda value: value is None or check(value)


def names(rows: Sequence[Sequence[Any]]) -> List[Tuple[str, str]]:
    """Returns the rows of robot and signal that are two texts."""
    return [(robot, signal) for robot, signal in rows if is_text(robot) and is_text(signal)]
