"""Transitions and evidence as rows of the database."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from typing import Any, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.formatting import datum_text, printable
from robot_health_monitor.core.model import Level, Transition

from .checked_rows import is_count, is_datum, is_json_object, is_level, is_number, is_text, is_time, optional

MAX_EVIDENCE = 300
"""Most samples that are stored with a transition."""

TRANSITION_COLUMNS = (
    "wall_s, robot, signal, from_level, to_level, value, statistic, bound, now_s, since_s, fingerprint, text, "
    "statistics, repeated, hint"
)
"""The columns of a transition except its id, in the order of `transition_row`."""

TRANSITION_CHECKS = (
    is_count, is_time, is_text, is_text, is_level, is_level, is_datum, is_text, optional(is_number), is_number,
    is_number, is_text, is_text, is_json_object, is_count, is_text,
)  # fmt: skip
"""The checks of the id and the `TRANSITION_COLUMNS`."""

INSERT_TRANSITION = (
    f"INSERT INTO transitions ({TRANSITION_COLUMNS}) VALUES ({', '.join('?' for _ in TRANSITION_COLUMNS.split(','))})"
)
"""Stores what `transition_row` returns."""


@dataclass(frozen=True)
class StoredTransition:
    """A transition, as the history has it."""

    id: int
    """Its number. Later events have larger numbers, also when the wall clock is set back."""
    wall_s: float
    """When, in s since 1970."""
    robot: str
    """As the fields of `Transition` of the same names, down to `hint`."""
    signal: str
    from_level: Level
    to_level: Level
    value: Any
    """A number, the text of a bad datum, or None."""
    statistic: str
    bound: Optional[float]
    now_s: float
    since_s: float
    fingerprint: str
    text: str
    statistics: Mapping[str, Optional[float]]
    """None: not finite."""
    repeat: bool
    hint: str


_FIELDS = tuple(StoredTransition.__dataclass_fields__)


def transition_row(transition: Transition, wall_s: float) -> Tuple[Any, ...]:
    """Returns the columns of a transition, in the order of `TRANSITION_COLUMNS`.

    Args:
        transition: what to store.
        wall_s: when, in s since 1970.
    """
    statistics = {name: _finite(value) for name, value in transition.statistics.items()}
    return (
        wall_s,
        printable(transition.robot),
        printable(transition.signal),
        int(transition.from_level),
        int(transition.to_level),
        _storable(transition.value),
        transition.statistic,
        transition.bound,
        transition.now_s,
        transition.since_s,
        transition.fingerprint,
        printable(transition.text),
        json.dumps(statistics),
        int(transition.repeat),
        printable(transition.hint),
    )


def stored_transition(row: Sequence[Any]) -> StoredTransition:
    """Returns the transition of a row that starts with the id, followed by `TRANSITION_COLUMNS`."""
    fields = dict(zip(_FIELDS, row))
    fields["from_level"], fields["to_level"] = Level(fields["from_level"]), Level(fields["to_level"])
    fields["statistics"], fields["repeat"] = json.loads(fields["statistics"]), bool(fields["repeat"])
    return StoredTransition(**fields)


def pack_samples(samples: Sequence[Tuple[float, Any]], stored_until_s: float = -math.inf) -> bytes:
    """Packs samples, 12 bytes each.

    The format: the time of the window's first sample in s since 1970 as float64, the seconds since then as float32 for
    each sample, the values as float64; little-endian. A value that is not a number is NaN.

    Args:
        samples: wall time in s and value; at most `MAX_EVIDENCE`, more are left out at the beginning.
        stored_until_s: samples up to this time are left out, because an earlier transition has them.
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


def _finite(value: float) -> Optional[float]:
    return value if math.isfinite(value) else None


def _storable(value: Any) -> Any:
    """Returns a number that SQLite can store, or the text of any other datum."""
    if value is None or (isinstance(value, float) and math.isfinite(value)):
        return value
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 53:
        return value
    return printable(datum_text(value))
