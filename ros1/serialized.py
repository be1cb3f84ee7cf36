"""Reading serialized messages of ROS 1, each by the type that its publisher's connection header names.

A node receives every topic as bytes, whatever its subscriptions read: all subscriptions of a process to a topic share
one connection and the class of the first one.
"""

from __future__ import annotations

import contextlib
import functools
from typing import Any, Callable

import rospy

from ..core.messages import RawFormat, ros1_format
from ..core.port import Severity
from ..core.values import ABSENT, ConfigError, Getter, canonical_type
from ..runtime.native_node import Log
from . import messages

_MOST_HEADERS = 100


def message_reader(topic: str, expected: str, getter_of: Callable[[RawFormat], Getter], log: Log) -> Getter:
    """Returns what reads the messages of a topic, of the type `expected`, or of any if it is empty.

    `getter_of` returns what reads messages of a format, and raises ConfigError if they cannot be read. A message of a
    type that does not fit reads as ABSENT, after one ERROR line. One that does not match its type raises ValueError.
    """
    wanted = canonical_type(expected)

    @functools.lru_cache(maxsize=_MOST_HEADERS)
    def bind(type_name: str, checksum: str, definition: str) -> Getter:
        try:
            if wanted not in ("", type_name):
                raise ConfigError(f"{topic}: expected messages of type {wanted}, got {type_name}")
            return getter_of(_format(type_name, checksum, definition))
        except ConfigError as error:
            log(Severity.ERROR, str(error))
            return lambda data: ABSENT

    def read(native: Any) -> Any:
        header = native._connection_header
        get = bind(header.get("type", ""), header.get("md5sum", ""), header.get("message_definition", ""))
        # rospy itself reads /clock as messages.
        return get(native._buff if isinstance(native, rospy.AnyMsg) else messages.serialized(native))

    return read


def _format(type_name: str, checksum: str, definition: str) -> RawFormat:
    """Returns the format of a publisher; one that sends no definition may have that which is installed here."""
    if not definition.strip():
        with contextlib.suppress(ConfigError):
            if checksum in ("", rospy.AnyMsg._md5sum, messages.message_class(type_name)._md5sum):
                return messages.raw_format(type_name)
    return ros1_format(type_name, definition)
