"""Reads one field of messages that are mappings, as the native message of a middleware brings it."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Optional

from ..values.elements import Elements
from ..values.errors import ConfigError, MessageError
from ..values.field_path import Getter, mapping_getter, parse_field_path
from ..values.formatting import describe
from ..values.where import filtered, parse_selection
from .dialect import Message
from .standard_messages import check_field, complete, constant_getter


def _arrival(message: Any) -> Any:
    return 1.0


def _is_never_short(path: str) -> bool:
    """Returns whether no index of a path can be beyond the end of an array."""
    steps = parse_field_path(path)
    return bool(steps) and not any(isinstance(step, int) for step in steps)


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
        self._value_of: Getter = _arrival
        self._get: Getter = _arrival
        self._null_is_nan = self.is_filtered = False
        if field is not None:
            try:
                path, comparisons = parse_selection(field)
                parse_field_path(path)
            except ValueError as error:
                raise ConfigError(f"{topic}: field {describe(field)}: {error}") from None
            if path or not comparisons:
                self._value_of = self._get = mapping_getter(path)
                self._null_is_nan = self.null_is_nan and _is_never_short(path)
            if comparisons:
                self.is_filtered = True
                self._get = filtered(comparisons, self._value_of, self._comparable, constant_getter)

    def read(self, message: Message) -> Any:
        """Returns the field of a message; raises one of `MISSING`."""
        value = self._get(message)
        return value if type(value) is float else self._as_elsewhere(value)

    def _comparable(self, path: str) -> Getter:
        """Returns a getter of a field that is compared."""
        get = mapping_getter(path)
        if not self.null_is_nan or not _is_never_short(path):
            return get

        def get_number(message: Any) -> Any:
            value = get(message)
            return math.nan if value is None else value

        return get_number

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
            default = self._value_of(complete(self.known_type(), {}))
        except (ConfigError, MessageError, *MISSING):
            return False
        return isinstance(default, (int, float)) and not isinstance(default, bool)
