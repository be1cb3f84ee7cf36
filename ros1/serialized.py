"""Reading serialized messages of ROS 1, each by the type that its publisher's connection header names.

A node receives every topic as bytes, whatever its subscriptions read: all subscriptions of a process to a topic share
one connection and the class of the first one.
"""

from __future__ import annotations

import contextlib
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
        self._getters: dict[tuple[str, ...], Getter] = {}
        """By type, checksum and definition."""
        self._header: Any = None
        """That of the latest message. All messages of a connection have the same object."""

    def read(self, native: Any) -> Any:
        """Returns what is read of a message; ABSENT, after one ERROR line, if the publisher's type does not fit.

        Raises ValueError if the message does not match that type.
        """
        if native._connection_header is not self._header:
            self._header = native._connection_header
            key = tuple(self._header.get(name, "") for name in ("type", "md5sum", "message_definition"))
            if key not in self._getters:
                if len(self._getters) >= _MOST_HEADERS:
                    self._getters.clear()
                try:
                    if self._expected not in ("", key[0]):
                        raise ConfigError(f"{self._topic}: expected messages of type {self._expected}, got {key[0]}")
                    self._getters[key] = self._getter_of(_format(*key))
                except ConfigError as error:
                    self._log(Severity.ERROR, str(error))
                    self._getters[key] = lambda data: ABSENT
            self._get = self._getters[key]
        # rospy itself reads /clock as messages.
        return self._get(native._buff if isinstance(native, rospy.AnyMsg) else messages.serialized(native))


def _format(type_name: str, checksum: str, definition: str) -> RawFormat:
    """Returns the format of a publisher; one that sends no definition may have that which is installed here."""
    if not definition.strip():
        with contextlib.suppress(ConfigError):
            if checksum in ("", rospy.AnyMsg._md5sum, messages.message_class(type_name)._md5sum):
                return messages.raw_format(type_name)
    return ros1_format(type_name, definition)
