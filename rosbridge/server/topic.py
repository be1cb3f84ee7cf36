"""One topic, the clients that subscribe to it, and how each of them receives its messages."""

from __future__ import annotations

import asyncio
import functools
from collections import deque
from dataclasses import dataclass
from typing import Callable, Deque, Dict, Iterable, List, NamedTuple, Optional, Protocol, Sequence

from ...core.messages.dialect import Message
from ...core.port.middleware import Subscription
from ...core.values.errors import MessageError
from ...runtime.event_loops import ThreadPool
from ..protocol import Limits
from ..protocol.definitions import Serializer
from ..protocol.operations import COMPRESSIONS, Subscribe
from .sending import EncodedMessage, Encoding, EncodingQueue


class Options(NamedTuple):
    """How a client receives the messages of a topic."""

    throttle_s: float = 0.0
    """Minimum time between two messages, in s."""
    queue_length: int = 0
    """Messages to queue meanwhile, the newest ones; 0: messages in between are dropped."""
    fragment_size: Optional[int] = None
    """In characters; None: no fragments."""
    compression: str = "none"

    @property
    def encoding(self) -> Encoding:
        """What the bytes that are sent depend on."""
        return Encoding(self.compression, self.fragment_size)


def merge(requests: Iterable[Subscribe], limits: Limits) -> Options:
    """Returns one set of options, within the limits, for all subscriptions of a client to one topic.

    As in the reference server: the fastest rate, the shortest queue, the smallest fragments, and the compression that
    is last in COMPRESSIONS.
    """
    every = list(requests)
    return Options(
        min(each.throttle_rate for each in every) / 1000.0,
        min(limits.queue_messages, *(each.queue_length for each in every)),
        min((each.fragment_size for each in every if each.fragment_size is not None), default=None),
        max((each.compression for each in every), key=COMPRESSIONS.index),
    )


@dataclass
class ByteBudget:
    """Bytes that the throttled messages of one client may occupy together."""

    bound: int
    used: int = 0


class Pacer:
    """Limits the rate of one subscription."""

    def __init__(
        self,
        options: Options,
        budget: ByteBudget,
        send: Callable[[EncodedMessage], None],
        call_later: Callable[[float, Callable[[], None]], asyncio.TimerHandle],
    ) -> None:
        """Starts empty; the first message is sent at once. All subscriptions of a client share `budget`."""
        self._options = options
        self._budget = budget
        self._send = send
        self._call_later = call_later
        self._waiting: Deque[EncodedMessage] = deque()
        self._pause: Optional[asyncio.TimerHandle] = None
        """Ends when the next message may be sent."""

    def offer(self, message: EncodedMessage) -> None:
        """Sends a message, or queues it; drops the oldest of the queue if it or the budget is full."""
        self._waiting.append(message)
        self._budget.used += message.size
        if self._pause is None:
            self._send_next()
        while self._waiting and (
            len(self._waiting) > self._options.queue_length or self._budget.used > self._budget.bound
        ):
            self._pop()

    def _send_next(self) -> None:
        self._pause = None
        if self._waiting:
            self._pause = self._call_later(self._options.throttle_s, self._send_next)
            self._send(self._pop())

    def close(self) -> None:
        """Drops the queue, and sends nothing more."""
        if self._pause is not None:
            self._pause.cancel()
        while self._waiting:
            self._pop()

    def _pop(self) -> EncodedMessage:
        message = self._waiting.popleft()
        self._budget.used -= message.size
        return message


class Receiver(Protocol):
    """A client, as seen from a topic."""

    throttled: ByteBudget
    """For the messages that wait because of `throttle_rate`."""

    def put(self, frames: bytes) -> None:
        """Sends frames or queues them."""


class Topic:
    """The clients of one topic. Used in the event loop only."""

    def __init__(self, name: str, encoder: ThreadPool, on_failure: Callable[[str], None], limits: Limits) -> None:
        """Starts without clients.

        `name` is as sent to clients. `encoder` encodes large messages. `on_failure` is called with the reason if a
        message cannot be sent.
        """
        self.name = name
        self.type_name = ""
        """The type, empty if it is not known yet."""
        self.serialize: Optional[Serializer] = None
        """Makes raw bytes of a message if the middleware gives none; None: not possible."""
        self.native_raw = False
        """Whether the middleware gives raw bytes, through `deliver_raw`."""
        self.messages: Optional[Subscription] = None
        """The subscription of the middleware that supplies `deliver`."""
        self.raw: Optional[Subscription] = None
        """The subscription of the middleware that supplies `deliver_raw`."""
        self.lock = asyncio.Lock()
        """Held while clients and subscriptions change."""
        self._encoder = encoder
        self._on_failure = on_failure
        self._limits = limits
        self._options: Dict[Receiver, Options] = {}
        self._direct: Dict[Encoding, List[Receiver]] = {}
        self._pacers: Dict[Receiver, Pacer] = {}
        self._queues: Dict[Encoding, EncodingQueue] = {}
        self._dropped = 0

    @property
    def compressions(self) -> Sequence[str]:
        """The compressions that clients have requested."""
        return tuple({options.compression for options in self._options.values()})

    @property
    def dropped(self) -> int:
        """Messages that were not sent because they were too large or the encoder was busy."""
        return self._dropped + sum(queue.dropped for queue in self._queues.values())

    def set_options(self, receiver: Receiver, options: Optional[Options]) -> None:
        """Sets how a client receives the messages; with None, it no longer receives them."""
        pacer = self._pacers.pop(receiver, None)
        if pacer is not None:
            pacer.close()
        if options is None:
            self._options.pop(receiver, None)
        else:
            self._options[receiver] = options
            if options.throttle_s:
                send = functools.partial(self._send, encoding=options.encoding, receivers=[receiver])
                call_later = asyncio.get_event_loop().call_later
                self._pacers[receiver] = Pacer(options, receiver.throttled, send, call_later)
        self._direct = {}
        for other, chosen in self._options.items():
            if not chosen.throttle_s:
                self._direct.setdefault(chosen.encoding, []).append(other)
        for unused in self._queues.keys() - {options.encoding for options in self._options.values()}:
            queue = self._queues.pop(unused)
            queue.clear()
            self._dropped += queue.dropped

    def deliver(self, message: Message) -> None:
        """Sends a message to every client, except those that receive it from `deliver_raw`."""
        self._deliver(EncodedMessage(self.name, message, serialize=self.serialize), raw=False)

    def deliver_raw(self, data: bytes) -> None:
        """Sends the raw bytes of a message to every client that requested them."""
        self._deliver(EncodedMessage(self.name, None, data), raw=True)

    def _deliver(self, message: EncodedMessage, *, raw: bool) -> None:
        if message.size > self._limits.sent_bytes:
            self._dropped += 1
            self._on_failure(f"{self.name}: message of {message.size} bytes dropped (limit {self._limits.sent_bytes})")
            return
        for encoding, receivers in self._direct.items():
            if self._is_raw(encoding.compression) == raw:
                self._send(message, encoding, receivers)
        for receiver, pacer in tuple(self._pacers.items()):
            if self._is_raw(self._options[receiver].compression) == raw:
                pacer.offer(message)

    def _is_raw(self, compression: str) -> bool:
        return compression == "cbor-raw" and self.native_raw

    def _send(self, message: EncodedMessage, encoding: Encoding, receivers: Sequence[Receiver]) -> None:
        queue = self._queues.get(encoding)
        if message.is_large or (queue is not None and queue.busy):
            if queue is None:
                queue = EncodingQueue(encoding, self._encoder, self._limits.encoding_bytes, self._put, self._fail)
                self._queues[encoding] = queue
            queue.put(message, tuple(receivers))
            return
        try:
            frames = message.frames(encoding)
        except MessageError as error:
            self._fail(str(error))
            return
        for receiver in receivers:
            receiver.put(frames)

    def _put(self, frames: bytes, receivers: Sequence[Receiver]) -> None:
        for receiver in receivers:
            if receiver in self._options:
                receiver.put(frames)

    def _fail(self, reason: str) -> None:
        self._dropped += 1
        self._on_failure(f"{self.name} ({self.type_name}): {reason}")
