"""Numbers in serialized messages, read without deserializing.

Most of what a monitor watches is such a number: `data` of a Float32, `percentage` of a BatteryState, or any number that
only numbers, arrays of fixed size and strings precede. Formats: CDR (OMG DDS-XTypes 1.3, section 7.4, encapsulations
CDR_BE and CDR_LE) and ROS 1's, which has no padding.
"""

from __future__ import annotations

import itertools
import struct
from typing import Any, Callable, Iterator, Mapping, Sequence, Tuple

from ..values import TIME_TYPES, MessageError, stamp_of
from .definitions import NUMBERS, Definitions

Getter = Callable[[bytes], Any]
"""Returns the number or the stamp in a serialized message; raises MessageError if the message is too short."""

Place = Tuple[str, int]
"""struct's letter, and how many of them: an array of fixed size has several. A string: `STRING`, 1."""

STRING = "s"
TIME: Place = ("I", 2)
"""Seconds and nanoseconds. The seconds of ROS 2 are signed."""
_LETTERS: Mapping[str, str] = {**NUMBERS, "string": STRING}
_CDR_HEADER = 4
"""Bytes before a CDR message, to which its alignment does not refer; the second is its byte order."""
_MOST_FIELDS = 4096
"""Plain fields of a type that are looked at."""
_DEEPEST = 32
"""Types that a plain field may be in; a damaged definition may contain itself."""


def number_getter(definitions: Definitions, type_name: str, field: str, *, is_cdr: bool) -> Getter | None:
    """Returns a getter of a number (`orientation.x`) or a time in serialized messages: CDR with its header, or ROS 1's.

    None if something of variable size, other than strings, precedes it, and for a part of a time.
    """
    before: list[Place] = []
    for path, place in itertools.islice(_plain_fields(definitions, type_name, "", 0), _MOST_FIELDS):
        if place is None:
            return None
        if path == field:
            return None if place[0] == STRING else _getter(before, place, is_cdr)
        before.append(place)
    return None


def _plain_fields(
    definitions: Definitions, type_name: str, prefix: str, depth: int
) -> Iterator[tuple[str, Place | None]]:
    """Yields path (of an array with `[]`) and place (None if its size varies) of each plain field, in their order."""
    fields = definitions[type_name].fields if depth <= _DEEPEST and type_name in definitions else ()
    if not fields:
        yield "", None
    for name, kind, size, _ in fields:
        path, letter = f"{prefix}{name}", _LETTERS.get(kind)
        if size is not None:
            yield f"{path}[]", (letter, size) if size > 0 and letter and letter != STRING else None
        elif kind in TIME_TYPES:
            yield path, TIME
        elif letter:
            yield path, (letter, 1)
        else:
            yield from _plain_fields(definitions, kind, f"{path}.", depth + 1)


def _getter(before: Sequence[Place], place: Place, is_cdr: bool) -> Getter:
    """Returns a getter for a number, or a time, after places.

    The places up to a string have a fixed size except for their alignment, which depends on where the string before
    them ended: a table per string gives the bytes up to the next string for each of the eight alignments.
    """
    steps: list[list[Place]] = [[]]
    for each in (*before, place):
        if each[0] == STRING:
            steps[-1].append(("I", 1))
            steps.append([])
        else:
            steps[-1].append(each)
    first, *tables = (_distances(step, is_cdr) for step in steps)
    header = _CDR_HEADER if is_cdr else 0
    start = header + first[0]
    is_time, letters = place == TIME, "iI" if place == TIME and is_cdr else place[0] * place[1]
    numbers = [struct.Struct(f"{order}{letters}").unpack_from for order in "><"]
    lengths = [struct.Struct(f"{order}I").unpack_from for order in "><"]

    def get(data: bytes) -> Any:
        try:
            order = data[1] if is_cdr else 1
            offset = start
            for table in tables:
                offset += 4 + lengths[order](data, offset)[0]
                offset += table[(offset - header) & 7]
            values = numbers[order](data, offset)
            return stamp_of(*values) if is_time else values[0]
        except (struct.error, IndexError) as error:
            raise MessageError(f"too short, or of another format: {error}") from None

    return get


def _distances(places: Sequence[Place], is_aligned: bool) -> tuple[int, ...]:
    """Returns, for each alignment of the start, the bytes from there to the last of the places."""
    distances = []
    for start in range(8):
        offset = size = 0
        for letter, count in places:
            offset += size
            item = struct.calcsize(f"<{letter}")
            if is_aligned:
                offset += -(start + offset) % item
            size = item * count
        distances.append(offset)
    return tuple(distances)
