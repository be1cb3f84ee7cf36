"""Reading serialized messages of ROS 1, each by the type that its publisher's connection header names.

A node receives every topic as bytes, whatever its subscriptions read: all subscriptions of a process to a topic share
one connection and the class of the first one.
"""

from __future__ import annotations

import contextlib
import functools
from typing import Any, Callable

import rospy

from ..core.messages.raw_messages import RawFormat, ros1_format
from ..core.port import Severity
from ..core.values import ABSENT, ConfigError, Getter, canonical_type
from ..runtime.native_node import Log
from . import messages

_MOST_HEADERS = 100


class Reader:
    """Reads the messages of a topic, each by the definition of its publisher."""

    def __init__(self, topic: str, expected: str, getter_of: Callable[[RawFormat], Getter], log: Log) -> None:
        """Takes messages of the type `expected`, or of any if it is empty.

        `getter_of` returns what reads messages of a format, and raises ConfigError if they cannot be read.
        """
        self._topic, self._expected, self._log = topic, canonical_type(expected), log
        self._getter_of = getter_of
        self._getter = functools.lru_cache(maxsize=_MOST_HEADERS)(self._bind)
        """By type, checksum and definition."""

    def read(self, native: Any) -> Any:
        """Returns what is read of a message; ABSENT, after one ERROR line, if the publisher's type does not fit.

        Raises ValueError if the message does not match that type.
        """
        header = native._connection_header
        get = self._getter(header.get("type", ""), header.get("md5sum", ""), header.get("message_definition", ""))
        # rospy itself reads /clock as messages.
        return get(native._buff if isinstance(native, rospy.AnyMsg) else messages.serialized(native))

    def _bind(self, type_name: str, checksum: str, definition: str) -> Getter:
        try:
            if self._expected not in ("", type_name):
                raise ConfigError(f"{self._topic}: expected messages of type {self._expected}, got {type_name}")
            return self._getter_of(_format(type_name, checksum, definition))
        except ConfigError as error:
            self._log(Severity.ERROR, str(error))
            return lambda data: ABSENT


def _format(type_name: str, checksum: str, definition: str) -> RawFormat:
    """Returns the format of a publisher; one that sends no definition may have that which is installed here."""
    if not definition.strip():
        with contextlib.suppress(ConfigError):
            if checksum in ("", rospy.AnyMsg._md5sum, messages.message_class(type_name)._md5sum):
                return messages.raw_format(type_name)
    return ros1_format(type_name, definition)
