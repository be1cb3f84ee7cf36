"""The rosbridge v2 protocol as pure code: no sockets, no clock, no threads."""

from .codec import CBOR_PROBLEM, Wire
from .connection import CBOR_SUBPROTOCOL, SUBPROTOCOLS, Connection
from .limits import DEFAULT_LIMITS, Id, Limits, ProtocolError
from .operations import Operation

__all__ = [
    "CBOR_PROBLEM",
    "CBOR_SUBPROTOCOL",
    "Connection",
    "DEFAULT_LIMITS",
    "Id",
    "Limits",
    "Operation",
    "ProtocolError",
    "SUBPROTOCOLS",
    "Wire",
]
