"""What a node does with the messages of a topic: reads a field, or passes the whole on."""

from __future__ import annotations

from typing import Union

from ...core.messages import RawFormat, SerializedType
from ...core.port import MappingSubscription, RawSubscription
from ...core.values import ABSENT, ConfigError, Getter, Message, canonical_type
from ...runtime.bridge.receivers import BridgeReceiver


class _Limited(BridgeReceiver):
    """A receiver of the connection, in front of a subscription of the node."""

    _type_name: str

    @property
    def type_name(self) -> str:
        """The type, which is empty if it has to be found out."""
        return canonical_type(self._type_name)

    def deliver(self, message: Message) -> None:
        """Passes the message on, or its field."""
        self.note_readable()
        super().deliver(message)  # type: ignore[misc]


class FieldReceiver(_Limited, MappingSubscription):
    """One node's subscription to one field of a topic."""

    null_is_nan = True
    needs_format = False
    """Whether the format of the messages has to be found out."""
    _get_from_bytes: Getter | None = None

    @property
    def arrivals_only(self) -> bool:
        """Whether the messages need not be decoded: `deliver` may be called with an empty one."""
        return self._field is None

    def takes_bytes(self, raw_format: RawFormat) -> bool:
        """Prepares for serialized messages of a format; returns False if it needs decoded ones."""
        try:
            types = SerializedType(self.topic, raw_format)
            self._get_from_bytes = _arrival if self._field is None else types.field_getter(self._field)
        except ConfigError:
            return False
        return True

    def deliver_bytes(self, data: bytes) -> None:
        """Called with every serialized message, if all receivers of the topic take them: passes the field on."""
        if self._get_from_bytes is None:
            return
        try:
            value = self._get_from_bytes(data)
        except ValueError as error:
            self.note_mismatch(error)
            value = ABSENT
        self._node.call_back(self, value)

    def too_large(self, size_bytes: int) -> None:
        """Reports a dropped message, which is a sign of life all the same."""
        super().too_large(size_bytes)
        self._node.call_back(self, ABSENT)


class CaptureReceiver(_Limited, RawSubscription):
    """One node's subscription to the messages of a topic as bytes, or as JSON."""

    arrivals_only = False
    needs_format = True

    def takes_bytes(self, raw_format: RawFormat) -> bool:
        """Returns True, because any format is recorded."""
        return True

    def deliver_bytes(self, data: bytes) -> None:
        """Passes the bytes on."""
        self._node.call_back(self, (data, self._node.raw_format_of(self.topic, "")))


Receiver = Union[FieldReceiver, CaptureReceiver]


def _arrival(data: bytes) -> float:
    return 1.0
