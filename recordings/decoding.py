"""The types of recorded messages; those that a recording does not define are the standard ones."""

from __future__ import annotations

import functools
from typing import Any

from ..core.messages import SerializedType
from ..core.values import ConfigError
from ..runtime.libraries import RECORDINGS, libraries
from .recording import Channel


@functools.lru_cache(maxsize=256)
def type_of(channel: Channel) -> SerializedType:
    """Returns the type of a channel's messages, read once per channel.

    Raises ConfigError if its definition is missing, and the type is not a standard one.
    """
    raw_format = channel.raw_format
    if raw_format.schema or raw_format.message_encoding == "json":
        return SerializedType(channel.topic, raw_format)
    is_cdr = raw_format.message_encoding == "cdr"
    store, name = _standard_types(is_cdr), channel.type_name.replace("/", "/msg/")
    if name not in store.types:
        problem = "the recording has no definition of it, and it is not a standard type"
        raise ConfigError(f"{channel.topic}: cannot use the definition of {channel.type_name}: {problem}")
    text = store.generate_msgdef(name, ros_version=2 if is_cdr else 1)[0]
    return SerializedType(channel.topic, raw_format._replace(schema=text, schema_encoding="ros2msg"))


@functools.lru_cache(maxsize=2)
def _standard_types(is_cdr: bool) -> Any:
    with libraries(*RECORDINGS):
        from rosbags.typesys import Stores, get_typestore

    ros2 = getattr(Stores, "ROS2_JAZZY", Stores.ROS2_HUMBLE)  # rosbags for Python 3.8 does not know Jazzy
    return get_typestore(ros2 if is_cdr else Stores.ROS1_NOETIC)
