"""The state of the rosbridge protocol towards one peer. No sockets, no clock, no threads.

`Connection.receive(data, now_s)` takes one WebSocket message and returns the operation in it, or None while fragments
are missing. `Connection.send(operation)` returns the messages to transmit. The only state: fragments of incomplete
messages. Client and server use the same class, since the protocol is symmetrical. Invalid input raises ProtocolError
and nothing else.
"""

from __future__ import annotations

import itertools
from typing import Any, Callable, List, Mapping, Optional

from .cbor import encode_cbor
from .codec import Wire, decode, encode_json, encode_json_with_nan
from .errors import ProtocolError
from .fragments import Reassembly, split
from .limits import DEFAULT_LIMITS, Limits
from .operations import Operation, operation_fields, read_operation
from .png import encode_png

__all__ = ["CBOR_SUBPROTOCOL", "Connection"]

CBOR_SUBPROTOCOL = "rosbridge.v2.cbor"
"""WebSocket subprotocol by which this package's client and server agree to send CBOR."""


class Connection:
    """The protocol state towards one peer."""

    def __init__(self, limits: Limits = DEFAULT_LIMITS, *, nan_as_null: bool = True) -> None:
        """Starts a connection.

        Args:
            limits: limits for received messages.
            nan_as_null: write NaN and infinities as null, which every JSON reader accepts. False writes them as
                Python does (`NaN`, `Infinity`): lossless, and accepted by rosbridge servers.
        """
        self.limits = limits
        self._reassembly = Reassembly(limits)
        self._fragment_ids = itertools.count()
        self._encode: Callable[[object], str] = encode_json if nan_as_null else encode_json_with_nan

    @property
    def fragment_chars(self) -> int:
        """Characters of incomplete messages: the next fragment may complete a message of this length."""
        return self._reassembly.chars

    def receive(self, data: Wire, now_s: float) -> Optional[Operation]:
        """Takes one message of the peer.

        Args:
            data: the message.
            now_s: the current time in s, for the timeout of incomplete messages.

        Returns:
            The operation; None after a fragment, while others are missing.

        Raises:
            ProtocolError: not rosbridge, or over a limit. The connection remains usable.
        """
        return self.receive_decoded(decode(data, self.limits), now_s)

    def receive_decoded(self, fields: Mapping[str, Any], now_s: float) -> Optional[Operation]:
        """Does what `receive` does, with a message that `decode` has decoded."""
        if fields.get("op") == "fragment":
            whole = self._reassembly.add(fields, now_s)
            if whole is None:
                return None
            fields = decode(whole, self.limits)
        return self._read(fields)

    def _read(self, fields: Mapping[str, Any]) -> Operation:
        if fields.get("op") == "fragment":
            raise ProtocolError("a fragment inside a fragmented message", "fragment")
        if fields.get("op") == "png":
            raise ProtocolError("received messages must not be compressed", "png")
        return read_operation(fields, self.limits)

    def send(
        self, operation: Operation, *, fragment_size: Optional[int] = None, compression: str = "none"
    ) -> List[Wire]:
        """Returns the messages to transmit for an operation.

        Args:
            operation: the operation.
            fragment_size: split longer messages, in characters. None: never.
            compression: one of COMPRESSIONS, as requested by the peer. CBOR is not split.

        Raises:
            MessageError: the operation contains a value that cannot be encoded.
        """
        fields = operation_fields(operation)
        if compression in ("cbor", "cbor-raw"):
            return [encode_cbor(fields)]
        text = self._encode(fields)
        if compression == "png":
            text = self._encode({"op": "png", "data": encode_png(text)})
        return self.fragmented(text, fragment_size)

    def fragmented(self, text: str, fragment_size: Optional[int]) -> List[Wire]:
        """Returns an encoded message in fragments if it is longer than `fragment_size` characters, else unchanged."""
        if fragment_size is None or len(text) <= fragment_size:
            return [text]
        id = f"fragment:{next(self._fragment_ids)}"  # noqa: A001 - the protocol's word
        return [self._encode(fragment) for fragment in split(text, fragment_size, id)]
