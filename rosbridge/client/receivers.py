"""What a node does with the messages of a topic: reads a field, passes the whole on, or follows /clock."""

from __future__ import annotations

from typing import Any, Optional, Union

from ...core.messages.dialect import Message
from ...core.messages.fixed_fields import Getter
from ...core.port.mapping_node import MappingNode, MappingSubscription, RawSubscription
from ...core.port.middleware import Callback, RawFormat, Severity
from ...core.port.raw_messages import bytes_getter
from ...core.values.errors import MessageError
from ...core.values.field_path import ABSENT
from ...core.values.model import Level


class _Limited:
    """A receiver that reports messages that are too large as a fault, which ends with the next one that can be read."""

    topic: str
    active: bool
    dropped = 0
    """Messages that were too large to be read."""
    _is_dropping = False

    def __init__(self, node: MappingNode, largest_bytes: int, *binding: Any) -> None:
        """Binds topic, type and what is passed on, with arguments, and errors, as of the methods of `Middleware`.

        Messages of more than `largest_bytes` are not decoded.
        """
        super().__init__(node, *binding)  # type: ignore[call-arg]
        self._faults = node.faults
        self._limit_mb = largest_bytes / 1e6

    def deliver(self, message: Message) -> None:
        """Passes the message on, or its field."""
        if self._is_dropping:
            self._clear_fault()
        super().deliver(message)  # type: ignore[misc]

    def too_large(self, size_bytes: int) -> None:
        """Reports a dropped message."""
        self._is_dropping = True
        self.dropped += 1
        text = f"dropped {self.dropped} messages, the last of {size_bytes / 1e6:.1f} MB (limit {self._limit_mb:.1f} MB)"
        self._faults.report(f"topic {self.topic}", text, Level.WARN)

    def end(self) -> None:
        """Ends the subscription and its fault."""
        self.active = False
        if self._is_dropping:
            self._clear_fault()

    def _clear_fault(self) -> None:
        self._is_dropping = False
        self._faults.clear(f"topic {self.topic}")


class FieldReceiver(_Limited, MappingSubscription):
    """One node's subscription to one field of a topic; a `Receiver` of the connection."""

    null_is_nan = True
    needs_format = False

    def __init__(
        self,
        node: MappingNode,
        largest_bytes: int,
        topic: str,
        type_name: str,
        field: Optional[str],
        callback: Callback,
    ) -> None:
        """Binds the field; see `Middleware.subscribe`."""
        super().__init__(node, largest_bytes, topic, type_name, field, callback)
        self.arrivals_only = field is None
        self._get_from_bytes: Optional[Getter] = None
        self._has_mismatch = False

    def takes_bytes(self, raw_format: RawFormat) -> bool:
        """Binds the field; see `Receiver`."""
        self._get_from_bytes = _arrival if self._field is None else bytes_getter(raw_format, self._field)
        return self._get_from_bytes is not None

    def deliver_bytes(self, data: bytes) -> None:
        """Passes the value of the field on."""
        if self._get_from_bytes is None:
            return
        try:
            value = self._get_from_bytes(data)
        except MessageError as error:
            if not self._has_mismatch:
                self._has_mismatch = True
                text = f"{self.topic}: a message does not match its type: {error}"
                self._node.failures.write(self.topic, Severity.ERROR, text)
            value = ABSENT
        self._node.call_back(self, value)

    def too_large(self, size_bytes: int) -> None:
        """Reports a dropped message, which is a sign of life all the same."""
        super().too_large(size_bytes)
        self._node.call_back(self, ABSENT)


class CaptureReceiver(_Limited, RawSubscription):
    """One node's subscription to the messages of a topic as bytes, or as JSON; a `Receiver` of the connection."""

    arrivals_only = False
    needs_format = True

    def takes_bytes(self, raw_format: RawFormat) -> bool:
        """Always: see `Receiver`."""
        return True

    def deliver_bytes(self, data: bytes) -> None:
        """Passes the bytes on."""
        self._node.call_back(self, (data, self._node.raw_format_of(self.topic, "")))


Receiver = Union[FieldReceiver, CaptureReceiver]


class ClockReceiver:
    """Receives /clock for one node."""

    arrivals_only = False
    needs_format = False

    def __init__(self, node: MappingNode) -> None:
        """Sets the simulated time of a node."""
        self._node = node

    def takes_bytes(self, raw_format: RawFormat) -> bool:
        """Never: see `Receiver`."""
        return False

    def deliver_bytes(self, data: bytes) -> None:
        """Does nothing."""

    def deliver(self, message: Message) -> None:
        """Sets the time."""
        self._node.take_clock(message)

    def too_large(self, size_bytes: int) -> None:
        """Does nothing: no message of this type is that large."""


def _arrival(data: bytes) -> float:
    return 1.0
