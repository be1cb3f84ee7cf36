"""The options of a client's subscriptions: merging several for one topic, and limiting the rate."""

from __future__ import annotations

from collections import deque
from typing import Deque, Generic, Iterable, NamedTuple, Optional, Tuple, TypeVar

from ..protocol import Limits
from ..protocol.operations import COMPRESSIONS, Subscribe

T = TypeVar("T")


class Options(NamedTuple):
    """How a client receives the messages of a topic."""

    throttle_s: float = 0.0
    """Minimum time between two messages, in s."""
    queue_length: int = 0
    """Messages to queue meanwhile, the newest ones; 0: messages in between are dropped."""
    fragment_size: Optional[int] = None
    """In characters; None: no fragments."""
    compression: str = "none"


def options_of(request: Subscribe, limits: Limits) -> Options:
    """Returns the options that a client requests, within the limits."""
    queue_length = min(request.queue_length, limits.queue_messages)
    return Options(request.throttle_rate / 1000.0, queue_length, request.fragment_size, request.compression)


def merge(requests: Iterable[Options]) -> Options:
    """Returns one set of options for all subscriptions of a client to one topic.

    As in the reference server: the fastest rate, the shortest queue, the smallest fragments, and the compression that
    is last in COMPRESSIONS.
    """
    every = list(requests)
    sizes = [options.fragment_size for options in every if options.fragment_size is not None]
    return Options(
        min(options.throttle_s for options in every),
        min(options.queue_length for options in every),
        min(sizes) if sizes else None,
        max((options.compression for options in every), key=COMPRESSIONS.index),
    )


class ByteBudget:
    """Bytes that the throttled messages of one client may occupy together."""

    def __init__(self, bound: int) -> None:
        """Starts with nothing used."""
        self.bound = bound
        self.used = 0


class Pacer(Generic[T]):
    """Limits the rate of one subscription."""

    def __init__(self, options: Options, budget: ByteBudget) -> None:
        """Starts empty; the first message may be sent at once.

        Args:
            options: rate and queue.
            budget: shared by all subscriptions of the client.
        """
        self._period_s = options.throttle_s
        self._length = options.queue_length
        self._budget = budget
        self._waiting: Deque[Tuple[T, int]] = deque()
        self._next_s = float("-inf")

    def offer(self, message: T, size: int, now_s: float) -> Optional[T]:
        """Processes a message; returns the one to send now, None if it is too early.

        If the queue or the budget is full, the oldest messages of the queue are dropped.

        Args:
            message: the message.
            size: its estimated size in bytes.
            now_s: monotonic seconds.
        """
        if now_s < self._next_s - self._period_s:
            self._next_s = now_s
        if not self._waiting and now_s >= self._next_s:
            self._next_s = now_s + self._period_s
            return message
        self._waiting.append((message, size))
        self._budget.used += size
        while self._waiting and (len(self._waiting) > self._length or self._budget.used > self._budget.bound):
            self._pop()
        return self.due(now_s)

    def due(self, now_s: float) -> Optional[T]:
        """Returns the oldest queued message if its time has come."""
        if not self._waiting or now_s < self._next_s:
            return None
        self._next_s = now_s + self._period_s
        return self._pop()

    def clear(self) -> None:
        """Drops the queue."""
        while self._waiting:
            self._pop()

    @property
    def next_s(self) -> Optional[float]:
        """When the next queued message may be sent, in s; None if none is queued."""
        return self._next_s if self._waiting else None

    def _pop(self) -> T:
        message, size = self._waiting.popleft()
        self._budget.used -= size
        return message
