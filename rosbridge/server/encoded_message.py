"""One message of a topic and its encodings; each is computed once, whatever the number of clients."""

from __future__ import annotations

import itertools
import time
from typing import Any, Callable, Dict, Mapping, NamedTuple, Optional

from robot_health_monitor.core.errors import MessageError

from ..protocol import Wire
from ..protocol.codec import encode_cbor, encode_json, encode_large_json, encode_png
from ..protocol.connection import split
from .frames import frame
from .message_size import LARGE_BYTES, estimated_bytes

Serializer = Callable[[Mapping[str, Any]], bytes]

_fragment_ids = itertools.count()


class Encoding(NamedTuple):
    """What the bytes that are sent to a client depend on."""

    compression: str = "none"
    fragment_size: Optional[int] = None
    """In characters; None: no fragments."""


class EncodedMessage:
    """A message, and the frames that were made of it."""

    def __init__(
        self,
        topic: str,
        message: Optional[Mapping[str, Any]],
        data: Optional[bytes] = None,
        serialize: Optional[Serializer] = None,
    ) -> None:
        """Stores the message.

        Args:
            topic: its topic, as sent to clients.
            message: the message as a mapping; None: only `data` is known.
            data: the message as the middleware transports it.
            serialize: makes `data` of `message`; None: not possible.
        """
        self.size = estimated_bytes(data if message is None else message)
        """Estimated memory in bytes."""
        self.is_large = self.size > LARGE_BYTES
        """Whether encoding takes so long that a thread should do it."""
        self._topic = topic
        self._message = message
        self._data = data
        self._serialize = serialize
        self._wires: Dict[str, Wire] = {}
        self._frames: Dict[Encoding, bytes] = {}

    def frames(self, encoding: Encoding) -> bytes:
        """Returns the WebSocket frames of the message: one, or one per fragment.

        Raises:
            MessageError: the message cannot be encoded in this way.
        """
        frames = self._frames.get(encoding)
        if frames is None:
            frames = self._frames[encoding] = self._framed(self._wire(encoding.compression), encoding.fragment_size)
        return frames

    def _framed(self, wire: Wire, fragment_size: Optional[int]) -> bytes:
        if fragment_size is None or isinstance(wire, bytes) or len(wire) <= fragment_size:
            return frame(wire)
        fragments = split(wire, fragment_size, f"publish:{next(_fragment_ids)}")
        return b"".join(frame(encode_json(fragment)) for fragment in fragments)

    def _wire(self, compression: str) -> Wire:
        wire = self._wires.get(compression)
        if wire is None:
            wire = self._wires[compression] = self._encode(compression)
        return wire

    def _encode(self, compression: str) -> Wire:
        if compression == "none":
            text = encode_large_json(self._message) if self.is_large else encode_json(self._message)
            return f'{{"op":"publish","topic":{encode_json(self._topic)},"msg":{text}}}'
        if compression == "png":
            return encode_json({"op": "png", "data": encode_png(str(self._wire("none")))})
        message: Any = self._message
        if compression == "cbor-raw":
            nanoseconds = time.time_ns()
            message = {
                "secs": nanoseconds // 1_000_000_000,
                "nsecs": nanoseconds % 1_000_000_000,
                "bytes": self._raw(),
            }
        return encode_cbor({"op": "publish", "topic": self._topic, "msg": message})

    def _raw(self) -> bytes:
        if self._message is None:
            return self._data or b""
        if self._serialize is None:
            raise MessageError("cannot be sent as cbor-raw: the definition of its type is not known")
        return self._serialize(self._message)
