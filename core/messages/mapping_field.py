"""Reads one field of messages that are mappings, as the native message of a middleware brings it."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Callable, Optional

from ..values.elements import Elements
from ..values.errors import ConfigError, MessageError
from ..values.field_path import mapping_getter, parse_field_path
from .dialect import Message
from .standard_messages import check_field, complete

MISSING = (KeyError, TypeError, AttributeError)
"""What `MappingField.read` raises if a message does not have the field."""


class MappingField:
    """A field of the messages of one topic. JSON has no types and no NaN."""

    null_is_nan = False
    """Whether a None is a NaN, which JSON has no number for. Not with an index in the field: the array is too short."""

    def __init__(self, topic: str, type_name: str, field: Optional[str]) -> None:
        """Binds the field, with arguments, and errors, as of `Middleware.subscribe`, and the resolved topic."""
        if type_name:
            check_field(topic, type_name, field or "")
        self.topic = topic
        self._type_name = type_name
        self._field = field
        self._get: Callable[[Any], Any] = (lambda message: 1.0) if field is None else mapping_getter(field)
        steps = parse_field_path(field or "")
        self._null_is_nan = self.null_is_nan and bool(steps) and not any(isinstance(step, int) for step in steps)

    def read(self, message: Message) -> Any:
        """Returns the field of a message; raises one of `MISSING`."""
        value = self._get(message)
        return value if type(value) is float else self._as_elsewhere(value)

    def known_type(self) -> str:
        """Returns the type of the messages; empty: it is not known."""
        return self._type_name

    def _as_elsewhere(self, value: Any) -> Any:
        """Returns a value as the native message of a middleware brings it."""
        if isinstance(value, bool) and self._is_numeric:
            return "true" if value else "false"
        if not self._null_is_nan:
            return value
        if type(value) is Elements:
            return Elements((name, math.nan if each is None else each) for name, each in value)
        return math.nan if value is None else value

    @cached_property
    def _is_numeric(self) -> bool:
        """Whether the field is known to be a number."""
        try:
            default = self._get(complete(self.known_type(), {}))
        except (ConfigError, MessageError, *MISSING):
            return False
        return isinstance(default, (int, float)) and not isinstance(default, bool)
