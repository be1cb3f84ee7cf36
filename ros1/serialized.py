"""Reading serialized messages of ROS 1, each by the type that its publisher's connection header names.

A node receives every topic as bytes, whatever its subscriptions read: all subscriptions of a process to a topic share
one connection and the class of the first one.
"""

from __future__ import annotations

from typing import Any, Dict, Mapping, Tuple

import genpy
import rospy

from ..core.port.middleware import RawFormat, Severity
from ..core.port.raw_messages import ros1_format
from ..core.values.errors import ConfigError, MessageError
from ..core.values.field_path import ABSENT, Getter
from ..core.values.names import canonical_type
from ..runtime.native_node import Log
from . import messages

_MOST_HEADERS = 100


class FieldReader:
    """Reads a field from serialized messages."""

    def __init__(self, topic: str, expected: str, field: str, decoder: Decoder, log: Log) -> None:
        """Reads `field` of messages of the type `expected`, or of any if it is empty.

        All readers of a topic share `decoder`.
        """
        self._topic, self._field, self._decoder, self._log = topic, field, decoder, log
        self._expected = messages.type_name(messages.message_class(expected)) if expected else ""
        self._readers: Dict[Tuple[str, str], Getter] = {}
        self._header: Any = None
        """That of the latest message. All messages of a connection have the same object."""
        self._has_failed = False

    def read(self, native: Any) -> Any:
        """Returns the field.

        ABSENT, after one ERROR line, if the type is unknown here, is not the expected one, or has no such field, or if
        the message does not match it.
        """
        if native._connection_header is not self._header:
            self._header = native._connection_header
            self._read = self._reader_of(self._header["type"], self._header.get("md5sum", ""))
        try:
            return self._read(native._buff)
        except (genpy.MessageException, MessageError) as error:
            if not self._has_failed:
                self._has_failed = True
                self._log(Severity.ERROR, f"{self._topic}: a message does not match {self._header['type']}: {error}")
            return ABSENT

    def _reader_of(self, type_name: str, checksum: str) -> Getter:
        key = type_name, checksum
        if key not in self._readers:
            if len(self._readers) >= _MOST_HEADERS:
                self._readers.clear()
            try:
                self._readers[key] = self._new_reader(type_name, checksum)
            except ConfigError as error:
                self._log(Severity.ERROR, str(error))
                self._readers[key] = lambda data: ABSENT
        return self._readers[key]

    def _new_reader(self, type_name: str, checksum: str) -> Getter:
        _require_type(self._topic, self._expected, type_name)
        get = messages.field_getter(self._topic, type_name, self._field)
        cls, decode = messages.message_class(type_name), self._decoder.decode
        if checksum not in ("", rospy.AnyMsg._md5sum, cls._md5sum):
            raise ConfigError(f"{self._topic}: the publisher has another definition of {type_name} than this machine")
        direct = messages.serialized_getter(cls, self._field) if checksum == cls._md5sum else None
        return direct or (lambda data: get(decode(data, cls)))


class BytesReader:
    """Returns serialized messages as they are, with their format."""

    def __init__(self, topic: str, expected: str, log: Log) -> None:
        """Takes messages of the type `expected`, or of any if it is empty. It need not be installed here."""
        self._topic, self._expected, self._log = topic, canonical_type(expected), log
        self._header: Any = None
        self._format: Any = ABSENT
        self._is_bytes = True
        self._formats: Dict[Tuple[str, str], Any] = {}

    def read(self, native: Any) -> Any:
        """Returns bytes and format; ABSENT, after one ERROR line, if the type is not the expected one."""
        if native._connection_header is not self._header:
            self._header = native._connection_header
            self._format = self._format_of(self._header)
            self._is_bytes = isinstance(native, rospy.AnyMsg)  # else /clock, which rospy itself reads as messages
        if self._format is ABSENT:
            return ABSENT
        return native._buff if self._is_bytes else messages.serialized(native), self._format

    def _format_of(self, header: Mapping[str, str]) -> Any:
        key = header["type"], header.get("message_definition", "")
        if key not in self._formats:
            if len(self._formats) >= _MOST_HEADERS:
                self._formats.clear()
            try:
                _require_type(self._topic, self._expected, key[0])
                self._formats[key] = _known_format(*key)
            except ConfigError as error:
                self._log(Severity.ERROR, str(error))
                self._formats[key] = ABSENT
        return self._formats[key]


class Decoder:
    """Deserializes each message of a topic once for all its readers."""

    def __init__(self) -> None:
        """Has no message yet."""
        self._data = b""
        self._message: Any = None

    def decode(self, data: bytes, cls: Any) -> Any:
        """Returns a message of a class."""
        if data is not self._data or type(self._message) is not cls:
            self._message = cls().deserialize(data)
            self._data = data
        return self._message


def _require_type(topic: str, expected: str, received: str) -> None:
    if expected and received != expected:
        raise ConfigError(f"{topic}: expected messages of type {expected}, got {received}")


def _known_format(type_name: str, definition: str) -> RawFormat:
    """Returns the format; a publisher that sends no definition is believed to have the one installed here, if any."""
    if definition.strip():
        return ros1_format(type_name, definition)
    try:
        return messages.raw_format(type_name)
    except ConfigError:
        return ros1_format(type_name, "")
