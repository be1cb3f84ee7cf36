"""Reading serialized messages of ROS 1, each by the type that its publisher's connection header names.

A node receives every topic as bytes, whatever its subscriptions read: all subscriptions of a process to a topic share
one connection and the class of the first one.
"""

from __future__ import annotations

import abc
import contextlib
from typing import Any, Dict, Tuple

import genpy
import rospy

from ..core.messages.raw_messages import ros1_format
from ..core.port.middleware import Severity
from ..core.values.errors import ConfigError, MessageError
from ..core.values.field_path import ABSENT, Getter
from ..core.values.names import canonical_type
from ..runtime.native_node import Decoder, Log
from . import messages

_MOST_HEADERS = 100


class _Reader(abc.ABC):
    """Reads the messages of a topic."""

    def __init__(self, topic: str, expected: str, log: Log) -> None:
        """Takes messages of the type `expected`, or of any if it is empty."""
        self._topic, self._expected, self._log = topic, canonical_type(expected), log
        self._getters: Dict[Tuple[str, ...], Getter] = {}
        """By type, checksum and definition."""
        self._header: Any = None
        """That of the latest message. All messages of a connection have the same object."""

    def read(self, native: Any) -> Any:
        """Returns what is read of a message; ABSENT, after one ERROR line, if the publisher's type does not fit."""
        if native._connection_header is not self._header:
            self._header = native._connection_header
            key = tuple(self._header.get(name, "") for name in ("type", "md5sum", "message_definition"))
            if key not in self._getters:
                if len(self._getters) >= _MOST_HEADERS:
                    self._getters.clear()
                try:
                    if self._expected not in ("", key[0]):
                        raise ConfigError(f"{self._topic}: expected messages of type {self._expected}, got {key[0]}")
                    self._getters[key] = self._getter(isinstance(native, rospy.AnyMsg), *key)
                except ConfigError as error:
                    self._log(Severity.ERROR, str(error))
                    self._getters[key] = lambda native: ABSENT
            self._get = self._getters[key]
        return self._get(native)

    @abc.abstractmethod
    def _getter(self, is_bytes: bool, type_name: str, checksum: str, definition: str) -> Getter:
        """Returns what reads the messages of a publisher; raises ConfigError if they cannot be read."""


class FieldReader(_Reader):
    """Reads a field from serialized messages, whose type is installed here."""

    def __init__(self, topic: str, expected: str, field: str, decoder: Decoder, log: Log) -> None:
        """All readers of a topic share `decoder`."""
        super().__init__(topic, expected, log)
        self._field, self._decoder = field, decoder
        self._has_failed = False

    def _getter(self, is_bytes: bool, type_name: str, checksum: str, definition: str) -> Getter:
        get = messages.field_getter(self._topic, type_name, self._field)
        cls, decode = messages.message_class(type_name), self._decoder.decode
        if checksum not in ("", rospy.AnyMsg._md5sum, cls._md5sum):
            raise ConfigError(f"{self._topic}: the publisher has another definition of {type_name} than this machine")
        direct = messages.serialized_getter(cls, self._field) if checksum == cls._md5sum else None
        read = direct or (lambda data: get(decode(data, cls)))

        def read_or_log(native: Any) -> Any:
            try:
                return read(native._buff)
            except (genpy.MessageException, MessageError) as error:
                if not self._has_failed:
                    self._has_failed = True
                    self._log(Severity.ERROR, f"{self._topic}: a message does not match {type_name}: {error}")
                return ABSENT

        return read_or_log


class BytesReader(_Reader):
    """Returns serialized messages as they are, with their format. Their type need not be installed here."""

    def _getter(self, is_bytes: bool, type_name: str, checksum: str, definition: str) -> Getter:
        raw = ros1_format(type_name, definition)
        if not definition.strip():  # the publisher is believed to have the definition installed here, if any
            with contextlib.suppress(ConfigError):
                raw = messages.raw_format(type_name)
        if is_bytes:
            return lambda native: (native._buff, raw)
        return lambda native: (messages.serialized(native), raw)  # /clock, which rospy itself reads as messages
