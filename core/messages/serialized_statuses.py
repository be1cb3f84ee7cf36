"""The statuses of a serialized DiagnosticArray, read without making messages of them.

Robots have hundreds of statuses with several values each. A message of them is a thousand objects, which cost several
times what level and message of each status do. Formats as in `fixed_fields.py`.
"""

from __future__ import annotations

import struct
from typing import Any

from ..values import (
    ABSENT,
    MOST_ELEMENTS,
    OWN_KEY,
    STATUS_TYPE,
    DriverStatus,
    Elements,
    Every,
    MessageError,
    is_own_status,
    leading_path,
    matches_pattern,
    too_many,
)
from .definitions import Definitions
from .fixed_fields import Getter, number_getter

_ARRAY = {"header": "std_msgs/Header", "status": STATUS_TYPE}
_STATUS = ["level", "name", "message", "hardware_id", "values"]
_OWN = OWN_KEY.encode()


def serialized_getter(definitions: Definitions, type_name: str, field: str, *, is_cdr: bool) -> Getter | None:
    """Returns a getter of a number, a time or several statuses in serialized messages; None if it needs messages."""
    get = number_getter(definitions, type_name, field, is_cdr=is_cdr)
    return get or statuses_getter(definitions, type_name, field, is_cdr=is_cdr)


def statuses_getter(definitions: Definitions, type_name: str, field: str, *, is_cdr: bool) -> Getter | None:
    """Returns a getter of `status["pattern"]` in serialized messages, as `field_getter` is for others.

    It raises MessageError for what is no DiagnosticArray. None for other types and fields.
    """
    path, condition = leading_path(field)
    pattern = path[1].pattern if len(path) == 2 and path[0] == "status" and isinstance(path[1], Every) else None
    if condition or pattern is None or {name: kind for name, kind, *_ in definitions[type_name].fields} != _ARRAY:
        return None
    if [name for name, *_ in definitions[STATUS_TYPE].fields] != _STATUS:
        return None
    read = _reader(pattern, is_cdr=is_cdr)

    def get(data: bytes) -> Any:
        try:
            return read(data)
        except (struct.error, IndexError) as error:
            raise MessageError(f"too short, or no DiagnosticArray: {error}") from None

    return get


def _reader(pattern: str, *, is_cdr: bool) -> Getter:
    lengths = [struct.Struct(f"{order}I").unpack_from for order in "><"]
    # CDR: its own header and a stamp; texts end with a zero, and lengths begin at multiples of four. ROS 1: number and
    # stamp.
    zero, padding = (1, 3) if is_cdr else (0, 0)

    def read(data: bytes) -> Any:
        length = lengths[data[1] if is_cdr else 1]

        def text(at: int) -> tuple[bytes, int]:
            begin = at + (-at & padding) + 4
            end = begin + length(data, begin - 4)[0]
            return data[begin : end - zero], end

        _, at = text(12)
        at += -at & padding
        count = length(data, at)[0]
        if count > MOST_ELEMENTS:
            return too_many(count)
        at += 4
        statuses = Elements()
        for _ in range(count):
            level = data[at]
            raw_name, at = text(at + 1)
            message, at = text(at)
            _, at = text(at)  # hardware_id
            at += -at & padding
            values = length(data, at)[0]
            at += 4
            name = raw_name.decode("utf-8", "replace")
            is_own = is_own_status(name, ())
            for _ in range(values):
                key, at = text(at)
                is_own = is_own or key == _OWN
                _, at = text(at)
            if not is_own and matches_pattern(name, pattern):
                signed = level if is_cdr or level < 128 else level - 256
                statuses.append((name, DriverStatus(signed, message.decode("utf-8", "replace"))))
        if at > len(data):
            raise IndexError(f"{len(data)} bytes")
        return statuses or ABSENT

    return read
