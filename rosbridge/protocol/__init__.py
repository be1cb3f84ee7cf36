"""The rosbridge v2 protocol as pure code: no sockets, no clock, no threads, no state.

Every WebSocket message is one operation: `read_operation(decode(data, limits))` reads it, `encode` writes one. Invalid
input raises ProtocolError and nothing else.
"""

from .codec import CBOR_COMPRESSIONS, CBOR_PROBLEM, CBOR_SUBPROTOCOL, SUBPROTOCOLS, Wire, decode, encode
from .limits import DEFAULT_LIMITS, Id, Limits, ProtocolError
from .operations import read_operation

__all__ = [
    "CBOR_COMPRESSIONS",
    "CBOR_PROBLEM",
    "CBOR_SUBPROTOCOL",
    "DEFAULT_LIMITS",
    "Id",
    "Limits",
    "ProtocolError",
    "SUBPROTOCOLS",
    "Wire",
    "decode",
    "encode",
    "read_operation",
]
