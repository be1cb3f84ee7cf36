"""Messages that wait in memory, as they were received, until an alert needs them or they are too old.

The messages of a robot are numbered. Every few seconds a segment begins, with the state of the robot's signals, so that
a recording can begin there. A recording reads the messages where they are: a message is in memory once, until it has
been written and is too old for the next recording.

Memory is bounded for all robots together. If it is full, the oldest messages go first, written or not.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Mapping, NamedTuple, Sequence, Tuple

from ...core.judge import SavedSignal
from ...core.messages import RawFormat

OVERHEAD_BYTES = 180
"""Memory of a message besides its data: the tuple, the number, the head of the bytes, its place in a list."""
STATE_BYTES = 1_500
"""Memory of the saved state of one signal, estimated."""

_TOGETHER_S = 1.0  # messages of a robot that count as equally old, so that not every one is compared with all robots


Message = Tuple[float, str, RawFormat, bytes]
"""Time of its arrival in s, on the steady clock of its robot; absolute name of its topic; its format; its bytes."""


def _bytes(message: Message) -> int:
    return len(message[3]) + OVERHEAD_BYTES


class Segment(NamedTuple):
    """A moment at which a recording can begin."""

    begin_s: float
    """On the robot's steady clock."""
    number: int
    """Number of the first message after it."""
    states: Mapping[str, SavedSignal]
    """The states of the robot's signals."""
    quiet: Sequence[Message]
    """The latest messages of topics that were quiet before, with the time `begin_s`."""
    bytes: int
    """Memory of what it has."""


class Ring:
    """The memory for the messages of all robots of a process."""

    def __init__(self, memory_bytes: float) -> None:
        """Starts empty."""
        self.lock = threading.Lock()
        """Held for some microseconds at a time."""
        self.used_bytes = 0
        self.dropped = 0
        """Messages that went before they were too old, because memory was full."""
        self.too_large: tuple[str, int] | None = None
        """Topic and bytes of the latest message that alone does not fit; it would cost all others."""
        self.robots: list[RobotRing] = []
        """Those that have messages."""
        self.memory_bytes = memory_bytes
        self._oldest: RobotRing | None = None
        self._oldest_until_s = 0.0

    def use(self, size: int) -> None:
        """Counts memory, with the lock held, and drops the oldest messages while it is full."""
        self.used_bytes += size
        while self.used_bytes > self.memory_bytes and self.robots:
            oldest = self._oldest
            if oldest is None or not oldest.messages or oldest.messages[0][0] > self._oldest_until_s:
                self._oldest = oldest = min(self.robots, key=lambda robot: robot.messages[0][0])
                self._oldest_until_s = oldest.messages[0][0] + _TOGETHER_S
            self.dropped += 1
            oldest.drop()


class RobotRing:
    """The messages of one robot. Called by one thread at a time; a `Reader` may read in another thread."""

    def __init__(self, ring: Ring, before_s: float) -> None:
        """Starts without a segment; `before_s` is the time that messages wait."""
        self.ring = ring
        self.messages: deque[Message] = deque()
        self.first = 0
        """Number of the oldest message."""
        self._before_s = before_s
        self._segments: deque[Segment] = deque()
        self.readers: list[Reader] = []
        """The recordings that are not closed, the latest last."""

    @property
    def current(self) -> Segment | None:
        """The latest segment; None before the first one."""
        return self._segments[-1] if self._segments else None

    @property
    def end(self) -> int:
        """Number of the next message."""
        return self.first + len(self.messages)

    def begin_segment(
        self, now_s: float, states: Mapping[str, SavedSignal], changed: int, quiet: Sequence[Message] = ()
    ) -> None:
        """Begins a segment with states, of which so many are not those of the segment before, and `Segment.quiet`."""
        size = changed * STATE_BYTES + sum(map(_bytes, quiet))
        with self.ring.lock:
            self._segments.append(Segment(now_s, self.end, states, quiet, size))
            self.ring.use(size)
            while len(self._segments) > 1 and self._segments[1].begin_s <= now_s - self._before_s:
                self.ring.used_bytes -= self._segments.popleft().bytes
            self.release()

    def add(self, message: Message) -> None:
        """Adds a message; before the first segment it is left out."""
        ring, size = self.ring, _bytes(message)
        with ring.lock:
            if size > ring.memory_bytes:
                ring.dropped += 1
                ring.too_large = message[1], len(message[3])
            elif self._segments:
                if not self.messages:
                    ring.robots.append(self)
                self.messages.append(message)
                ring.use(size)

    def drop(self) -> None:
        """Drops the oldest message, with the lock held."""
        self.ring.used_bytes -= _bytes(self.messages.popleft())
        self.first += 1
        if not self.messages:
            self.ring.robots.remove(self)

    def release(self) -> None:
        """Drops, with the lock held, what neither a recording nor the next one needs."""
        needed = self._segments[0].number if self._segments else self.end
        needed = min([needed, *(reader.position for reader in self.readers)])
        while self.first < needed:
            self.drop()

    def reader(self) -> Reader:
        """Begins a recording of everything that is there, and of what comes until `end_reader`."""
        with self.ring.lock:
            # What went before the recording is not lost for it. Only the first segment may lack its first messages.
            following = list(self._segments)[1:]
            begins = (one for one, after in zip(self._segments, following) if after.number > self.first)
            self.readers.append(Reader(self, next(begins, self._segments[-1])))
            return self.readers[-1]

    def end_reader(self) -> None:
        """Ends the recording after the messages that are there now."""
        with self.ring.lock:
            for reader in self.readers:
                reader.end = self.end if reader.end is None else reader.end

    def reach_s(self, now_s: float) -> float:
        """Returns how far the messages reach back, in s; at most the time that they wait."""
        with self.ring.lock:
            if not self.messages or not self._segments:
                return 0.0
            begin = self._segments[0]
            return min(self._before_s, now_s - (begin.begin_s if self.first <= begin.number else self.messages[0][0]))

    def close(self) -> None:
        """Ends the recording and forgets the messages."""
        self.end_reader()
        with self.ring.lock:
            self.ring.used_bytes -= sum(segment.bytes for segment in self._segments)
            self._segments.clear()
            self.release()


class Reader:
    """The place up to which a recording has read a robot's messages. Use `RobotRing.reader`."""

    def __init__(self, robot: RobotRing, first: Segment) -> None:
        """Begins with a segment, with the lock held."""
        self._robot = robot
        self.first = first
        """The segment with which the recording begins."""
        self.position = max(first.number, robot.first)
        """Number of the next message."""
        self.lost = 0
        """Messages that went before they were read."""
        self.end: int | None = None
        """Number of the first message that no longer belongs to the recording; None while it goes on."""

    def read(self, most_bytes: int) -> list[Message]:
        """Returns the next messages, at most so many bytes and at least one; empty if there are none now."""
        messages: list[Message] = []
        size, robot = 0, self._robot
        with robot.ring.lock:
            end = robot.end if self.end is None else self.end
            gone = max(0, min(robot.first, end) - self.position)
            self.lost += gone
            self.position += gone
            while self.position < end and size < most_bytes:
                messages.append(robot.messages[self.position - robot.first])
                size += _bytes(messages[-1])
                self.position += 1
        return messages

    @property
    def is_complete(self) -> bool:
        """Whether everything that belongs to the recording has been read."""
        return self.end is not None and self.position >= self.end

    def close(self) -> None:
        """Ends the reading."""
        with self._robot.ring.lock:
            self._robot.readers.remove(self)
            self._robot.release()
