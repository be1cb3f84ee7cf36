"""Values of fields from messages in rosbridge's form that are recorded as JSON, as a black box may have them."""

from __future__ import annotations

import json
from typing import Any

from robot_health_monitor.core.fixed_fields import Getter
from robot_health_monitor.core.mapping_field import MISSING, MappingField

from .recording import Channel


class _JsonField(MappingField):
    null_is_nan = True


def json_getter(channel: Channel, field: str) -> Getter:
    """Returns a function that reads `field`, a path as in core/field_path.py, from messages; empty: the whole message.

    It raises ValueError for a message without the field. Raises ConfigError: the type has no such field.
    """
    read = _JsonField(channel.topic, channel.type_name, field).read

    def get(data: bytes) -> Any:
        try:
            message = json.loads(data)
        except RecursionError:
            raise ValueError("nested too deeply") from None
        if not isinstance(message, dict):
            raise ValueError("not a JSON object")
        try:
            return read(message)
        except MISSING as error:
            raise ValueError(f"no field {field}: {error}") from None

    return get
