"""The rosbridge v2 protocol as pure code: no sockets, no clock, no threads."""

from .codec import Wire
from .connection import CBOR_SUBPROTOCOL, Connection
from .limits import DEFAULT_LIMITS, Id, Limits, ProtocolError
from .operations import Operation

__all__ = ["CBOR_SUBPROTOCOL", "Connection", "DEFAULT_LIMITS", "Id", "Limits", "Operation", "ProtocolError", "Wire"]
