"""Estimates the memory that a message occupies."""

from __future__ import annotations

LARGE_BYTES = 65_536
"""Messages above this size are encoded and decoded in a background thread."""

_OBJECT_BYTES = 32
_COUNTED_ITEMS = 16


def estimated_bytes(value: object) -> int:
    """Returns about how many bytes a value occupies, in time that does not depend on the length of its arrays.

    The elements of a ROS array have one type, so a long array is estimated from three of them.
    """
    if isinstance(value, (str, bytes, bytearray)):
        return 2 * _OBJECT_BYTES + len(value)
    if isinstance(value, dict):
        return 4 * _OBJECT_BYTES + sum(_OBJECT_BYTES + estimated_bytes(item) for item in value.values())
    if isinstance(value, (list, tuple)):
        count = len(value)
        if count <= _COUNTED_ITEMS:
            return 2 * _OBJECT_BYTES + sum(map(estimated_bytes, value))
        sample = (value[0], value[count // 2], value[-1])
        return 2 * _OBJECT_BYTES + count * max(map(estimated_bytes, sample))
    return _OBJECT_BYTES
