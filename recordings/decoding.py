"""The types of recorded messages; those that a recording does not define are the standard ones."""

from __future__ import annotations

import functools
from typing import Any, Tuple

from ..core.messages.fixed_fields import Getter
from ..core.messages.serialized import SerializedType, json_getter
from ..core.values.errors import ConfigError
from ..runtime.libraries import RECORDINGS, libraries
from .recording import Channel


@functools.lru_cache(maxsize=256)
def type_of(channel: Channel) -> SerializedType:
    """Returns the type of a channel's messages, read once per channel.

    Raises ConfigError if its definition cannot be parsed, or is missing and the type is not a standard one.
    """
    form = channel.definition_format
    text, form = (channel.definition, form) if channel.definition else _standard_definition(channel)
    return SerializedType(channel.topic, channel.type_name, channel.encoding, text, form)


def field_getter(channel: Channel, field: str) -> Getter:
    """Returns a function that reads a field of a channel's messages; raises ConfigError as `type_of` does."""
    if channel.encoding == "json":
        return json_getter(channel.topic, channel.type_name, field)
    return type_of(channel).field_getter(field)


def _standard_definition(channel: Channel) -> Tuple[str, str]:
    is_cdr = channel.encoding == "cdr"
    store, name = _standard_types(is_cdr), channel.type_name.replace("/", "/msg/")
    if name not in store.types:
        problem = "the recording has no definition of it, and it is not a standard type"
        raise ConfigError(f"{channel.topic}: cannot use the definition of {channel.type_name}: {problem}")
    return store.generate_msgdef(name, ros_version=2 if is_cdr else 1)[0], "msg"


@functools.lru_cache(maxsize=2)
def _standard_types(is_cdr: bool) -> Any:
    with libraries(*RECORDINGS):
        from rosbags.typesys import Stores, get_typestore

    ros2 = getattr(Stores, "ROS2_JAZZY", Stores.ROS2_HUMBLE)  # rosbags for Python 3.8 does not know Jazzy
    return get_typestore(ros2 if is_cdr else Stores.ROS1_NOETIC)
