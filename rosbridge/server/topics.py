"""From one message to many clients: each message is encoded once per encoding, whatever the number of clients."""

from __future__ import annotations

import asyncio
import time
from typing import Any, Callable, Dict, List, Mapping, Optional, Protocol, Sequence

from ..protocol import Connection, Wire
from ..protocol.cbor import encode_cbor
from ..protocol.codec import encode_json
from ..protocol.png import encode_png
from .frames import FrameMaker
from .subscriptions import Options, Pacer


class Receiver(Protocol):
    """A client, as seen from a topic."""

    connection: Connection

    def put(self, frame: bytes) -> None:
        """Sends a frame, or lets it wait its turn."""


class EncodedMessage:
    """One message of a topic in all the forms that somebody wants; each is made when it is first asked for."""

    def __init__(
        self,
        topic: Topic,
        message: Optional[Mapping[str, Any]],
        data: Optional[bytes] = None,
    ) -> None:
        """Takes the message as a mapping, or as the bytes that a middleware transports."""
        self._topic = topic
        self._message = message
        self._data = data
        self._wires: Dict[str, Wire] = {}
        self._frames: Dict[str, bytes] = {}

    def frame(self, compression: str) -> bytes:
        """Returns the WebSocket frame for a compression.

        Raises:
            ValueError: the message cannot be encoded so.
        """
        frame = self._frames.get(compression)
        if frame is None:
            frame = self._frames[compression] = self._topic.frame_maker.frame(self.wire(compression))
        return frame

    def wire(self, compression: str) -> Wire:
        """Returns the message as it is before framing.

        Raises:
            ValueError: the message cannot be encoded so.
        """
        wire = self._wires.get(compression)
        if wire is None:
            wire = self._wires[compression] = self._encode(compression)
        return wire

    def _encode(self, compression: str) -> Wire:
        if compression == "none":
            return f"{self._topic.json_start}{encode_json(self._message)}}}"
        if compression == "png":
            text = self.wire("none")
            assert isinstance(text, str)
            return encode_json({"op": "png", "data": encode_png(text)})
        message: Any = self._message
        if compression == "cbor-raw":
            nanoseconds = time.time_ns()
            message = {
                "secs": nanoseconds // 1_000_000_000,
                "nsecs": nanoseconds % 1_000_000_000,
                "bytes": self._data if self._message is None else self._topic.serialized(self._message),
            }
        return encode_cbor({"op": "publish", "topic": self._topic.name, "msg": message})


class Topic:
    """One topic and the clients that subscribe to it. All of it runs in the server's event loop."""

    def __init__(
        self,
        name: str,
        type_name: str,
        frame_maker: FrameMaker,
        serialize: Optional[Callable[[Mapping[str, Any]], bytes]],
        on_failure: Callable[[str], None],
    ) -> None:
        """Makes a topic without clients.

        Args:
            name: its name.
            type_name: type of its messages.
            frame_maker: makes the frames.
            serialize: turns a message into raw bytes where the middleware gives none; None: that is not possible.
            on_failure: told why a message could not be sent.
        """
        self.name = name
        self.type_name = type_name
        self.frame_maker = frame_maker
        self.json_start = f'{{"op":"publish","topic":{encode_json(name)},"msg":'
        self.native_raw = False
        """Whether raw bytes come from the middleware, through `deliver_raw`."""
        self._serialize = serialize
        self._on_failure = on_failure
        self._options: Dict[Receiver, Options] = {}
        self._direct: Dict[str, List[Receiver]] = {}
        self._pacers: Dict[Receiver, Pacer[EncodedMessage]] = {}
        self._timers: Dict[Receiver, asyncio.TimerHandle] = {}

    @property
    def compressions(self) -> Sequence[str]:
        """The compressions that somebody wants."""
        return tuple({options.compression for options in self._options.values()})

    def serialized(self, message: Mapping[str, Any]) -> bytes:
        """Returns a message in raw bytes.

        Raises:
            ValueError: its type is not known, or it does not fit.
        """
        if self._serialize is None:
            raise ValueError(f"{self.type_name} cannot be sent as cbor-raw: its definition is not known")
        return self._serialize(message)

    def set_options(self, receiver: Receiver, options: Optional[Options]) -> None:
        """Says how a client gets the messages from now on; None: not any more."""
        self._pacers.pop(receiver, None)
        timer = self._timers.pop(receiver, None)
        if timer is not None:
            timer.cancel()
        if options is None:
            self._options.pop(receiver, None)
        else:
            self._options[receiver] = options
            if not options.direct:
                self._pacers[receiver] = Pacer(options)
        self._direct = {}
        for other, chosen in self._options.items():
            if chosen.direct:
                self._direct.setdefault(chosen.compression, []).append(other)

    def deliver(self, message: Mapping[str, Any]) -> None:
        """Sends a message to every client that does not want it raw from the middleware."""
        encoded = EncodedMessage(self, message)
        for compression, receivers in self._direct.items():
            if compression != "cbor-raw" or not self.native_raw:
                self._send(encoded, compression, receivers)
        if self._pacers:
            self._pace(encoded, raw=False)

    def deliver_raw(self, data: bytes) -> None:
        """Sends the bytes of a message to every client that wants them."""
        encoded = EncodedMessage(self, None, data)
        receivers = self._direct.get("cbor-raw")
        if receivers:
            self._send(encoded, "cbor-raw", receivers)
        if self._pacers:
            self._pace(encoded, raw=True)

    def _send(self, encoded: EncodedMessage, compression: str, receivers: Sequence[Receiver]) -> None:
        try:
            frame = encoded.frame(compression)
        except (ValueError, TypeError) as error:
            self._on_failure(f"{self.name}: {error}")
            return
        for receiver in receivers:
            receiver.put(frame)

    def _pace(self, encoded: EncodedMessage, raw: bool) -> None:
        now_s = asyncio.get_event_loop().time()
        for receiver, pacer in tuple(self._pacers.items()):
            if (self._options[receiver].compression == "cbor-raw" and self.native_raw) == raw:
                self._send_paced(receiver, pacer.offer(encoded, now_s))
                self._wait(receiver, pacer, now_s)

    def _wait(self, receiver: Receiver, pacer: Pacer[EncodedMessage], now_s: float) -> None:
        """Has the next waiting message sent when its time comes."""
        if pacer.next_s is not None and receiver not in self._timers:
            delay_s = max(0.0, pacer.next_s - now_s)
            self._timers[receiver] = asyncio.get_event_loop().call_later(delay_s, self._on_due, receiver)

    def _on_due(self, receiver: Receiver) -> None:
        self._timers.pop(receiver, None)
        pacer = self._pacers.get(receiver)
        if pacer is not None:
            now_s = asyncio.get_event_loop().time()
            self._send_paced(receiver, pacer.due(now_s))
            self._wait(receiver, pacer, now_s)

    def _send_paced(self, receiver: Receiver, encoded: Optional[EncodedMessage]) -> None:
        if encoded is None:
            return
        options = self._options[receiver]
        if options.fragment_size is None or options.compression.startswith("cbor"):
            self._send(encoded, options.compression, [receiver])
            return
        try:
            text = encoded.wire(options.compression)
        except (ValueError, TypeError) as error:
            self._on_failure(f"{self.name}: {error}")
            return
        assert isinstance(text, str)
        for piece in receiver.connection.fragmented(text, options.fragment_size):
            receiver.put(self.frame_maker.frame(piece))
