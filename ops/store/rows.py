"""Rows of a history file: transitions and evidence; every row is checked when it is read.

Other programs and damage may have put anything into them. A row with an unexpected value is skipped, and noted at its
connection, so that it can be reported in one line.
"""

from __future__ import annotations

import functools
import json
import math
import sqlite3
import struct
from dataclasses import dataclass
from typing import (
    Any,
    Callable,
    Dict,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Type,
    TypeVar,
    Union,
)

from ...core.config.schema import REQUIRED, declared, row_reader
from ...core.judge.continuity import MAX_EVIDENCE
from ...core.values.formatting import datum_text, printable
from ...core.values.model import Level, Transition

T = TypeVar("T")
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
    """Yields the rows that pass the checks, one per column; skips the others. The first column identifies the row."""
    for row in rows:
        for check, value in zip(checks, row):  # not `all`, which takes twice as long
            if not check(value):
                skip(connection, table, row[0])
                break
        else:
            yield tuple(row)


def read_rows(
    connection: sqlite3.Connection, table: str, rows: Sequence[Sequence[Any]], schema: Type[T]
) -> Iterator[T]:
    """Yields rows as a dataclass that declares their columns; skips others. The first column identifies the row."""
    read = row_reader(schema)
    for row in rows:
        found = read(row)
        if found is None:
            skip(connection, table, row[0])
        else:
            yield found


def is_number(value: object) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, (float, int)) and math.isfinite(value)


def is_time(value: object) -> bool:
    """Whether a value is a time in s since 1970 that a calendar has."""
    return isinstance(value, (float, int)) and -LATEST_S <= value <= LATEST_S


def is_text(value: object) -> bool:
    """Whether a value is a text."""
    return isinstance(value, str)


def is_level(value: object) -> bool:
    """Whether a value is the number of a level."""
    return value in (0, 1, 2, 3) and isinstance(value, int)


def is_count(value: object) -> bool:
    """Whether a value is an integer; flags are 0 and 1."""
    return isinstance(value, int)


def is_json_object(value: object) -> bool:
    """Whether a value is the text of a JSON object."""
    try:
        return isinstance(json.loads(value), dict)  # type: ignore[arg-type]
    except (TypeError, ValueError, RecursionError):
        return False


def optional(check: Check) -> Check:
    """Returns a check that also accepts NULL."""
    return lambda value: value is None or check(value)


def time_column() -> Any:
    """Returns the field of a time in s since 1970."""
    return declared(REQUIRED, "", -LATEST_S, LATEST_S)


def text_column() -> Any:
    """Returns the field of a text, as it was found."""
    return declared(REQUIRED, any_text=True)


@dataclass(frozen=True)
class StoredTransition:
    """A transition, as the history has it. The fields are the columns of the table `transitions`."""

    id: int = declared(REQUIRED)
    """Its number. Later events have larger numbers, also when the wall clock is set back."""
    wall_s: float = time_column()
    """When, in s since 1970."""
    robot: str = text_column()
    """As the fields of `Transition` of the same names, down to `cause`."""
    signal: str = text_column()
    from_level: Level = declared(REQUIRED)
    to_level: Level = declared(REQUIRED)
    value: Optional[Union[float, str]] = declared(REQUIRED)
    """A number, the text of a bad datum, or None."""
    statistic: str = text_column()
    bound: Optional[float] = declared(REQUIRED)
    now_s: float = declared(REQUIRED)
    since_s: float = declared(REQUIRED)
    fingerprint: str = text_column()
    text: str = text_column()
    statistics: Mapping[str, Any] = declared(REQUIRED)
    """None: not finite."""
    repeat: bool = declared(REQUIRED)
    hint: str = text_column()
    black_box: str = text_column()
    cause: str = text_column()
    alert_id: int = declared(REQUIRED)
    """Number of the transition that began the alert: the same for all of its levels and its end."""
    affected: str = text_column()

    @property
    def effects(self) -> Sequence[str]:
        """Names of the signals that the alert kept from being announced, if it began here."""
        return self.affected.split("\n") if self.affected else ()

    @property
    def affects(self) -> int:
        """How many they are."""
        return len(self.effects)


_GIVEN_COLUMNS = (
    "wall_s, robot, signal, from_level, to_level, value, statistic, bound, now_s, since_s, fingerprint, text, "
    "statistics, repeated, hint, black_box, cause"
)
TRANSITION_COLUMNS = f"{_GIVEN_COLUMNS}, coalesce(alert_id, id), affected"
"""The columns of a transition except its id, in the order of the fields of `StoredTransition`."""

INSERT_TRANSITION = f"INSERT INTO transitions ({_GIVEN_COLUMNS}, alert_id) VALUES ({', '.join('?' * 18)})"
"""Stores what `transition_row` returns; the last value is the transition that began the alert (None: this one)."""


def transition_row(transition: Transition, wall_s: float) -> Tuple[Any, ...]:
    """Returns the columns of a transition at a time in s since 1970, as of one that begins an alert."""
    return (
        wall_s, printable(transition.robot), printable(transition.signal), int(transition.from_level),
        int(transition.to_level), _storable(transition.value), transition.statistic, transition.bound,
        transition.now_s, transition.since_s, transition.fingerprint, printable(transition.text),
        json.dumps({name: value if math.isfinite(value) else None for name, value in transition.statistics.items()}),
        int(transition.repeat), printable(transition.hint), transition.black_box, transition.cause,
        None,
    )  # fmt: skip


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


class UnpackedSamples(NamedTuple):
    """The samples of `pack_samples`."""

    first_s: float
    """Time of the window's first sample, in s since 1970."""
    samples: List[Tuple[float, float]]
    """Wall time in s and value."""

    @property
    def is_complete(self) -> bool:
        """Whether no samples were left out."""
        return bool(self.samples) and self.samples[0][0] <= self.first_s


def unpack_samples(packed: bytes) -> Optional[UnpackedSamples]:
    """Returns the samples of `pack_samples`; None if there are none, or it is not of this form."""
    if not isinstance(packed, bytes) or len(packed) % 12 != 8:
        return None
    count = len(packed) // 12
    first_s, *numbers = struct.unpack(f"<d{count}f{count}d", packed)
    samples = [(first_s + time_s, value) for time_s, value in zip(numbers[:count], numbers[count:])]
    return UnpackedSamples(first_s, samples)


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
    return printable(datum_text(value))
