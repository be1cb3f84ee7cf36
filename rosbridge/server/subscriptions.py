"""What a client asked for when it subscribed: merging several requests for one topic, and keeping to their rate."""

from __future__ import annotations

from collections import deque
from typing import Deque, Generic, Iterable, NamedTuple, Optional, TypeVar

from ..protocol import COMPRESSIONS, Subscribe
from ..protocol.limits import Limits

T = TypeVar("T")


class Options(NamedTuple):
    """How one client gets the messages of one topic."""

    throttle_s: float = 0.0
    """Least time between two messages, in s."""
    queue_length: int = 0
    """How many wait for their time, the newest ones; 0: those in between are left out."""
    fragment_size: Optional[int] = None
    compression: str = "none"

    @property
    def direct(self) -> bool:
        """Whether every message goes out as it is and at once."""
        return self.throttle_s == 0.0 and self.fragment_size is None


def options_of(request: Subscribe, limits: Limits) -> Options:
    """Returns what a request asks for, with its queue within the limits."""
    queue_length = min(request.queue_length, limits.queue_messages)
    return Options(request.throttle_rate / 1000.0, queue_length, request.fragment_size, request.compression)


def merge(requests: Iterable[Options]) -> Options:
    """Returns what serves all of a client's subscriptions to one topic.

    As the reference server has it: the fastest rate, the shortest queue, the smallest fragments, and of the
    compressions the one that stands last in COMPRESSIONS.
    """
    every = list(requests)
    sizes = [options.fragment_size for options in every if options.fragment_size is not None]
    return Options(
        min(options.throttle_s for options in every),
        min(options.queue_length for options in every),
        min(sizes) if sizes else None,
        max((options.compression for options in every), key=COMPRESSIONS.index),
    )


class Pacer(Generic[T]):
    """Lets messages through at no more than a subscription's rate."""

    def __init__(self, options: Options) -> None:
        """Starts with the rate and queue of `options`; the first message may go at once."""
        self._period_s = options.throttle_s
        self._waiting: Deque[T] = deque(maxlen=options.queue_length)
        self._next_s = float("-inf")

    def offer(self, message: T, now_s: float) -> Optional[T]:
        """Takes a message; returns the one to send now, None when its time has not come.

        When the queue is full the oldest in it is left out.
        """
        if now_s < self._next_s - self._period_s:
            self._next_s = now_s
        self._waiting.append(message)
        if self._waiting:
            return self.due(now_s)
        if now_s < self._next_s:
            return None
        self._next_s = now_s + self._period_s
        return message

    def due(self, now_s: float) -> Optional[T]:
        """Returns the oldest waiting message when its time has come."""
        if not self._waiting or now_s < self._next_s:
            return None
        self._next_s = now_s + self._period_s
        return self._waiting.popleft()

    @property
    def next_s(self) -> Optional[float]:
        """When the next waiting message may go, in s; None when none waits."""
        return self._next_s if self._waiting else None
