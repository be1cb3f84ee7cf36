"""Rows of a history file: transitions and evidence; every row is checked when it is read.

Other programs and damage may have put anything into them. A row with an unexpected value is skipped, and noted at its
connection, so that it can be reported in one line.
"""

from __future__ import annotations

import functools
import json
import math
import struct
from sqlite3 import Connection
from typing import (
    Any,
    Callable,
    Iterable,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Type,
    TypeVar,
    Union,
    get_type_hints,
)

from ...core.config import row_reader
from ...core.judge import MAX_EVIDENCE
from ...core.values import JsonObject, Level, Transition, datum_text, printable

T = TypeVar("T")
_types_of = functools.lru_cache(maxsize=None)(get_type_hints)
Values = Union[Sequence[Any], JsonObject]
"""The parameters of a query."""


class CheckedConnection(Connection):
    """A connection that notes whether rows were skipped. In texts that are not UTF-8, odd characters are replaced.

    It is in autocommit mode, and any one thread may use it at a time.
    """

    def __init__(self, database: str, timeout_s: float = 0.0) -> None:
        """Opens a database by its path or URI; waits so long, in s, for other connections that write."""
        super().__init__(database, timeout=timeout_s, isolation_level=None, check_same_thread=False, uri=True)
        self.text_factory = functools.partial(str, encoding="utf-8", errors="replace")
        self.skipped_text = ""
        """One line about the first row that was skipped; empty if none were."""


def skip(connection: Connection, table: str, row: object) -> None:
    """Notes that a row was skipped."""
    if isinstance(connection, CheckedConnection) and not connection.skipped_text:
        connection.skipped_text = f"a row has unexpected values and is skipped ({table} {row!r:.60})"


class Rows(List[T]):
    """The rows of a query without those that were skipped."""

    raw: Sequence[Sequence[Any]] = ()
    """All of them, as the query returned them."""


def select(
    connection: Connection,
    table: str,
    types: Iterable[Any],
    query: str,
    values: Values = (),
    make: Callable[[Iterable[Any]], Any] = tuple,
) -> Rows[Any]:
    """Returns what `make` makes of the rows of a query whose columns are of these types; skips others.

    The first column identifies a row, the table names it.
    """
    cursor = connection.execute(query, values)
    read = row_reader(tuple(column[0] for column in cursor.description), tuple(types))
    rows: Rows[Any] = Rows()
    rows.raw = cursor.fetchall()
    for row in rows.raw:
        fields = read(row)
        if fields is None:
            skip(connection, table, row[0])
        else:
            rows.append(make(fields))
    return rows


def records(
    connection: Connection, table: str, record: Type[T], tail: str = "", values: Values = (), columns: str = ""
) -> Rows[T]:
    """Returns rows of a table as a NamedTuple whose fields are its `columns`, as `select`; `tail` follows the table."""
    types = _types_of(record)  # type: ignore[arg-type]  # mypy: not every class is hashable
    query = f"SELECT {columns or ', '.join(types)} FROM {table} {tail}"
    return select(connection, table, types.values(), query, values, lambda fields: record(*fields))


class StoredTransition(NamedTuple):
    """A transition, as the history has it. The fields are the columns of the table `transitions`."""

    id: int
    """Its number. Later events have larger numbers, also when the wall clock is set back."""
    wall_s: float
    """When, in s since 1970."""
    robot: str
    """As the fields of `Transition` of the same names, down to `cause`."""
    signal: str
    from_level: Level
    to_level: Level
    value: Optional[Union[float, str]]
    """A number, the text of a bad datum, or None."""
    statistic: str
    bound: Optional[float]
    now_s: float
    since_s: float
    fingerprint: str
    text: str
    statistics: JsonObject
    """A value is None if it was not finite."""
    repeat: bool
    hint: str
    black_box: str
    cause: str
    alert_id: int
    """Number of the transition that began the alert: the same for all of its levels and its end."""
    affected: str

    @property
    def effects(self) -> Sequence[str]:
        """Names of the signals that the alert kept from being announced, if it began here."""
        return self.affected.split("\n") if self.affected else ()

    @property
    def affects(self) -> int:
        """How many they are."""
        return len(self.effects)


_GIVEN = StoredTransition._fields[1:-2]
AFFECTED = """(
    SELECT coalesce(group_concat(signal, char(10)), '')
    FROM (SELECT signal FROM effects WHERE transition_id = transitions.id ORDER BY rowid)
)"""
"""The effects of a transition, a line each."""
TRANSITION_COLUMNS = f"id, {', '.join(_GIVEN)}, coalesce(alert_id, id), {AFFECTED}"
"""The columns of a transition, in the order of the fields of `StoredTransition`."""

INSERT_TRANSITION = f"INSERT INTO transitions ({', '.join(_GIVEN)}, alert_id) VALUES ({', '.join('?' * 18)})"
"""Stores what `transition_row` returns; the last value is the transition that began the alert (None if it is new)."""


def transition_row(transition: Transition, wall_s: float) -> Tuple[Any, ...]:
    """Returns the columns of a transition at a time in s since 1970, as of one that begins an alert."""
    row = {name: getattr(transition, name) for name in _GIVEN[1:]}
    row["value"] = _storable(transition.value)
    row["statistics"] = json.dumps(
        {name: value if math.isfinite(value) else None for name, value in transition.statistics.items()}
    )
    return (wall_s, *(printable(value) if isinstance(value, str) else value for value in row.values()), None)


def pack_samples(samples: Sequence[Tuple[float, Any]], stored_until_s: float = -math.inf) -> bytes:
    """Packs samples (wall time in s, value), 12 bytes each; of more than `MAX_EVIDENCE`, the newest.

    The format: the time of the window's first sample in s since 1970 as float64, the seconds since then as float32 for
    each sample, the values as float64; little-endian. A value that is not a number is NaN. Samples up to
    `stored_until_s` are left out, because an earlier transition has them.
    """
    samples = samples[-MAX_EVIDENCE:]
    if not samples:
        return b""
    first_s, last_s = samples[0][0], samples[-1][0]
    if last_s >= stored_until_s:  # otherwise the wall clock was set back
        samples = [sample for sample in samples if sample[0] > stored_until_s]
    times = [_number(time_s) - first_s for time_s, _ in samples]
    values = [_number(value) for _, value in samples]
    return struct.pack(f"<d{len(samples)}f{len(samples)}d", first_s, *times, *values)


def unpack_samples(packed: object) -> Tuple[float, List[Tuple[float, float]]]:
    """Returns the time of the window's first sample, and samples (wall time in s, value) as `pack_samples` has them.

    Infinity and no samples if there are none, or `packed` is not of this form.
    """
    if not isinstance(packed, bytes) or len(packed) % 12 != 8:
        return math.inf, []
    count = len(packed) // 12
    first_s, *numbers = struct.unpack(f"<d{count}f{count}d", packed)
    return first_s, [(first_s + time_s, value) for time_s, value in zip(numbers[:count], numbers[count:])]


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _storable(value: Any) -> Any:
    """Returns a number that SQLite can store, or the text of any other datum."""
    if value is None or (isinstance(value, float) and math.isfinite(value)):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 53:
        return value
    return datum_text(value)
