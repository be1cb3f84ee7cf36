"""Foxglove's WebSocket protocol as pure code: what a server says, and how channels are subscribed to.

Source: the protocol's specification, versions `foxglove.websocket.v1` (github.com/foxglove/ws-protocol) and
`foxglove.sdk.v1` (github.com/foxglove/foxglove-sdk), which are alike in what is used here: `serverInfo`, `advertise`,
`unadvertise`, `status`, messages of channels, `subscribe` and `unsubscribe`.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Iterator, NamedTuple, Sequence

from ..core.messages import RawFormat
from ..core.values import JsonObject, MessageError, read_json

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""WebSocket subprotocols, the current one first; a server answers with the one that it speaks."""
LARGEST_ID = 2**32 - 1
"""Of a subscription, which has four bytes in messages."""

_MESSAGE_DATA = 1
_MESSAGE_HEAD = struct.Struct("<BIQ")
"""Opcode, id of the subscription, time of the log in ns since 1970."""
_LONGEST_NAME = 1_000
_LARGEST_CHANNEL_ID = 2**64 - 1
_SCHEMA_ENCODINGS = {"cdr": ("ros2msg", "ros2idl"), "ros1": ("ros1msg",), "json": ("jsonschema", "")}
"""By encoding of messages: those of schemas that can be read, first the one that servers mean who name none."""


class ProtocolError(MessageError):
    """A message that is not valid in the protocol."""


class Channel(NamedTuple):
    """A topic that the server offers. Several channels may have one topic."""

    id: int
    topic: str
    raw_format: RawFormat
    """That of its messages. The encodings may be others than those that can be read."""

    @property
    def problem(self) -> str:
        """Why its messages cannot be read, empty if they can."""
        encoding, _, schema_encoding, *_ = self.raw_format
        if encoding not in _SCHEMA_ENCODINGS:
            return f"its messages have the encoding {encoding or 'of no name'}, which is not supported"
        if schema_encoding not in _SCHEMA_ENCODINGS[encoding]:
            return f"its schema has the encoding {schema_encoding}, which is not supported"
        return ""


class ServerMessage(NamedTuple):
    """What a text message of the server says: what it offers, or reports on itself. Other operations are not used."""

    op: str
    channels: Sequence[Channel] = ()
    """Those that the server offers from now on."""
    channel_ids: Sequence[int] = ()
    """Those that it no longer offers."""
    level: int = 0
    """Of `message`: 0 info, 1 warning, 2 error."""
    message: str = ""


def read_text(text: str) -> ServerMessage:
    """Returns what a text message of the server says.

    Raises ProtocolError if it is not valid. Of the channels in an `advertise`, those that are not valid are left out.
    """
    try:
        fields = read_json(text)
    except ValueError as error:
        raise ProtocolError(f"not JSON: {type(error).__name__}") from None
    op = fields.get("op") if isinstance(fields, dict) else None
    if not isinstance(op, str):
        raise ProtocolError("expected an object with op")
    if op == "advertise":
        return ServerMessage(op, channels=list(_channels(_list_of(fields, "channels"))))
    if op == "unadvertise":
        return ServerMessage(op, channel_ids=[each for each in _list_of(fields, "channelIds") if _is_id(each)])
    level, message = fields.get("level"), fields.get("message")
    if op == "status" and type(level) is int and isinstance(message, str):
        return ServerMessage(op, level=level, message=message)
    return ServerMessage(op)


def read_message(data: bytes) -> tuple[int, bytes] | None:
    """Returns a subscription's id and the message that came for it; None for a binary message that is not used here.

    Raises ProtocolError if it is shorter than its head. The log time is not returned: it is the server's business.
    """
    if data[0] != _MESSAGE_DATA:
        return None
    if len(data) < _MESSAGE_HEAD.size:
        raise ProtocolError(f"expected a message of at least {_MESSAGE_HEAD.size} bytes, got {len(data)}")
    _, subscription, _ = _MESSAGE_HEAD.unpack_from(data)
    return subscription, data[_MESSAGE_HEAD.size :]


def subscribe(subscription: int, channel_id: int) -> str:
    """Returns the message that subscribes to a channel."""
    return json.dumps({"op": "subscribe", "subscriptions": [{"id": subscription, "channelId": channel_id}]})


def unsubscribe(subscription: int) -> str:
    """Returns the message that ends a subscription."""
    return json.dumps({"op": "unsubscribe", "subscriptionIds": [subscription]})


def _list_of(fields: JsonObject, key: str) -> list[Any]:
    value = fields.get(key)
    if not isinstance(value, list):
        raise ProtocolError(f"{fields['op']}: expected a list as {key}")
    return value


def _channels(offered: Sequence[Any]) -> Iterator[Channel]:
    for each in offered:
        if not isinstance(each, dict) or not _is_id(each.get("id")):
            continue
        texts = [each.get(key) or "" for key in ("topic", "encoding", "schemaName", "schemaEncoding", "schema")]
        topic, encoding, name, schema_encoding, schema = texts
        if all(isinstance(text, str) for text in texts) and topic and max(map(len, texts[:4])) <= _LONGEST_NAME:
            known = _SCHEMA_ENCODINGS.get(encoding, ("",))
            yield Channel(each["id"], topic, RawFormat(encoding, name, schema_encoding or known[0], schema))


def _is_id(value: object) -> bool:
    return type(value) is int and 0 <= value <= _LARGEST_CHANNEL_ID
