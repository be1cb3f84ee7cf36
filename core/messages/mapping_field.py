"""Reads one field of messages that are mappings from JSON, as the serialized message of a middleware brings it."""

from __future__ import annotations

import math
from typing import Any

from ..values import Elements, Getter, Message, mapping_getter, parse_field_path, selected
from .standard_messages import check_field, constant_getter, is_number


def _arrival(message: Any) -> Any:
    return 1.0


MISSING = (KeyError, TypeError, AttributeError)
"""What `MappingField.read` raises if a message does not have the field."""


class MappingField:
    """A field of the messages of one topic. JSON has no types and no NaN."""

    null_is_nan = False
    """Whether a None is a NaN, which JSON has no number for. Not with an index in the field: the array is too short."""

    def __init__(self, topic: str, type_name: str, field: str | None) -> None:
        """Binds the field, with arguments, and errors, as of `Middleware.subscribe`, and the resolved topic."""
        if type_name:
            check_field(topic, type_name, field or "")
        self.topic = topic
        self._type_name = type_name
        self._field = field
        self._get: Getter = (
            _arrival if field is None else selected(topic, type_name, field, self._bind, constant_getter)
        )

    def read(self, message: Message) -> Any:
        """Returns the field of a message; raises one of `MISSING`."""
        return self._get(message)

    def known_type(self) -> str:
        """Returns the type of the messages; empty if it is not known."""
        return self._type_name

    def _bind(self, path: str) -> Getter:
        """Returns a function that reads a path as elsewhere."""
        get, steps = mapping_getter(path), parse_field_path(path)
        is_short = not steps or any(isinstance(step, int) for step in steps)
        null = math.nan if self.null_is_nan and not is_short else None

        def read(message: Any) -> Any:
            value = get(message)
            if type(value) is Elements and null is not None:
                return Elements((name, null if each is None else each) for name, each in value)
            if type(value) is bool and is_number(self.known_type(), path):
                return "true" if value else "false"
            return null if value is None else value

        return read
