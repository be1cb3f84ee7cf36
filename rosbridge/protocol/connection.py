"""The state of the rosbridge protocol towards one peer. No sockets, no clock, no threads.

`Connection.receive(data, now_s)` takes one WebSocket message and returns the operation in it, or None while fragments
are missing. `Connection.send(operation)` returns the messages to transmit. The only state: fragments of incomplete
messages. Client and server use the same class, since the protocol is symmetrical. Invalid input raises ProtocolError
and nothing else.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence

from .codec import CBOR_PROBLEM, Wire, decode, encode_cbor, encode_json, encode_png
from .limits import DEFAULT_LIMITS, Id, Limits, ProtocolError
from .operations import Fragment, Operation, operation_fields, read_operation

CBOR_SUBPROTOCOL = "rosbridge.v2.cbor"
"""WebSocket subprotocol by which this package's client and server agree to send CBOR."""
SUBPROTOCOLS: Sequence[str] = () if CBOR_PROBLEM else (CBOR_SUBPROTOCOL,)
"""Those that a client requests and a server accepts."""

_fragment_ids = itertools.count()


class Connection:
    """The protocol state towards one peer."""

    def __init__(self, limits: Limits = DEFAULT_LIMITS) -> None:
        """Starts a connection."""
        self.limits = limits
        self.reassembly = Reassembly(limits)
        """The fragments of incomplete messages."""

    def receive(self, data: Wire, now_s: float) -> Optional[Operation]:
        """Takes one message of the peer; returns its operation, or None after a fragment while others are missing.

        `now_s` is for the timeout of incomplete messages. The connection remains usable after a ProtocolError.
        """
        return self.receive_decoded(decode(data, self.limits), now_s)

    def receive_decoded(self, fields: Mapping[str, Any], now_s: float) -> Optional[Operation]:
        """Does what `receive` does, with a message that `decode` has decoded."""
        operation = read_operation(fields)
        if not isinstance(operation, Fragment):
            return operation
        whole = self.reassembly.add(operation, now_s)
        if whole is None:
            return None
        operation = read_operation(decode(whole, self.limits))
        if isinstance(operation, Fragment):
            raise ProtocolError("a fragment inside a fragmented message", "fragment")
        return operation

    def send(
        self, operation: Operation, *, fragment_size: Optional[int] = None, compression: str = "none"
    ) -> List[Wire]:
        """Returns the messages to transmit for an operation, encoded with one of COMPRESSIONS.

        Raises MessageError if a value cannot be encoded.
        """
        return encode_fields(operation_fields(operation), encode_json, compression, fragment_size)


def encode_fields(
    fields: Mapping[str, Any],
    encode: Callable[[object], str],
    compression: str = "none",
    fragment_size: Optional[int] = None,
) -> List[Wire]:
    """Returns the messages to transmit for the fields of an operation; `encode` writes JSON.

    JSON longer than `fragment_size` characters is split in fragments. Raises as `Connection.send`.
    """
    if compression in ("cbor", "cbor-raw"):
        return [encode_cbor(fields)]
    text = encode(fields)
    if compression == "png":
        text = encode({"op": "png", "data": encode_png(text)})
    if fragment_size is None or len(text) <= fragment_size:
        return [text]
    return [encode(fragment) for fragment in split(text, fragment_size, f"fragment:{next(_fragment_ids)}")]


def split(text: str, size: int, id: str) -> Iterator[Dict[str, Any]]:  # noqa: A002 - the protocol's word
    """Yields the operations `fragment` of a JSON text: `size` characters each, with an id unique in the connection."""
    total = -(-len(text) // size)
    for number in range(total):
        data = text[number * size : (number + 1) * size]
        yield {"op": "fragment", "id": id, "data": data, "num": number, "total": total}


@dataclass
class _Partial:
    """An incomplete message."""

    total: int
    last_s: float
    pieces: Dict[int, str] = field(default_factory=dict)


class Reassembly:
    """Joins the fragments of one connection, within the limits."""

    def __init__(self, limits: Limits) -> None:
        """Starts without fragments."""
        self._limits = limits
        self._partial: Dict[Id, _Partial] = {}
        self.chars = 0
        """Characters of the incomplete messages: the next fragment may complete a message of this length."""

    def add(self, fragment: Fragment, now_s: float) -> Optional[str]:
        """Takes one fragment; returns the message once it is complete. Repeated fragments are ignored.

        Raises ProtocolError and drops its message if the fragment contradicts earlier ones or exceeds a limit.
        """
        number, total = int(fragment.num), int(fragment.total)
        if number >= total:
            raise ProtocolError(f"num: expected 0 to {total - 1}, got {number}", "fragment", fragment.id)
        for id, partial in tuple(self._partial.items()):  # noqa: A001 - the protocol's word
            if now_s - partial.last_s > self._limits.fragment_timeout_s:
                self._drop(id)
        if fragment.id not in self._partial and len(self._partial) >= self._limits.partial_messages:
            self._drop(next(iter(self._partial)))
        partial = self._partial.setdefault(fragment.id, _Partial(total, now_s))
        if partial.total != total:
            self._drop(fragment.id, f"total: expected {partial.total} as before, got {total}")
        partial.last_s = now_s
        if number not in partial.pieces:
            if self.chars + len(fragment.data) > self._limits.message_bytes:
                self._drop(fragment.id, f"fragments with more than {self._limits.message_bytes} characters")
            partial.pieces[number] = fragment.data
            self.chars += len(fragment.data)
        if len(partial.pieces) < total:
            return None
        self._drop(fragment.id)
        return "".join(partial.pieces[number] for number in range(total))

    def _drop(self, id: Id, problem: str = "") -> None:  # noqa: A002 - the protocol's word
        """Forgets a message; raises ProtocolError if there is a problem."""
        self.chars -= sum(map(len, self._partial.pop(id).pieces.values()))
        if problem:
            raise ProtocolError(problem, "fragment", id)
