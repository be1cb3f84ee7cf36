"""A transition as one JSON object: on stdout, in webhooks, on the stdin of commands."""

from __future__ import annotations

import json
import math
from typing import Any, Dict, Mapping

from .formatting import datum_text
from .model import Level, Transition

FIELDS = tuple(name for name in Transition.__dataclass_fields__ if name != "status")
"""The fields of a transition that are written. Its status is left out: it repeats them as text."""

_LARGE = 10**1000
_MOST_VALUE_CHARS = 2_000
"""Longest value that is written in full: a robot may send a text of a megabyte where a number belongs."""


def json_line(transition: object, **further: object) -> str:
    """Formats a transition as one JSON object: levels by name, NaN and infinities as null, ASCII only.

    A value longer than 2,000 characters, which is not a measurement, is truncated.

    Args:
        transition: what to format: a Transition, or another object with its fields.
        further: fields to add.
    """
    fields: Dict[str, Any] = {name: getattr(transition, name) for name in FIELDS}
    fields.update(further)
    written = {name: _as_json(value) for name, value in fields.items()}
    if not isinstance(fields["value"], float) and len(json.dumps(written["value"])) > _MOST_VALUE_CHARS:
        written["value"] = datum_text(fields["value"])
    return json.dumps(written)


def _as_json(value: object) -> object:
    if isinstance(value, Level):
        return value.name
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _as_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_as_json(item) for item in value]
    if value is None or isinstance(value, (str, bool)) or (isinstance(value, int) and abs(value) < _LARGE):
        return value
    return datum_text(value)  # such as an integer of 5,000 digits, which Python does not convert to text
