"""Messages that wait in memory, as they were received, until an alert needs them or they are too old.

The messages of a robot are in segments of some seconds. Each segment begins with the state of the robot's signals, so
that a recording can begin with any of them. A recording reads the segments where they are: a message is in memory once,
until it has been written and is too old for the next recording.

Memory is bounded for all robots together. If it is full, the oldest messages go first, written or not.
"""

from __future__ import annotations

import itertools
import threading
from collections import OrderedDict, deque
from typing import Deque, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ...core.judge.saved_state import SavedSignal
from ...core.messages.raw_messages import RawFormat

OVERHEAD_BYTES = 180
"""Memory of a message besides its data: the tuple, the number, the head of the bytes, its place in a list."""
STATE_BYTES = 1_500
"""Memory of the saved state of one signal, estimated."""


class Channel(NamedTuple):
    """A topic with the format of its messages."""

    topic: str
    """The absolute name."""
    format: RawFormat


Message = Tuple[float, Channel, bytes]
"""Time of its arrival in s, on the steady clock of its robot; its channel; its bytes."""


class Segment:
    """Messages of one robot in the order of their arrival. Change it with the lock of its `Ring` only."""

    __slots__ = ("begin_s", "bytes", "dropped", "messages", "quiet", "readers", "states")

    def __init__(
        self, begin_s: float, states: Mapping[str, SavedSignal], state_bytes: int, quiet: Sequence[Message] = ()
    ) -> None:
        """Begins at a time on the robot's steady clock, with the states of its signals then.

        `quiet` has the latest messages of topics that were quiet before, with the time at which it begins.
        """
        self.quiet = quiet
        self.begin_s = begin_s
        self.states = states
        self.dropped = 0
        """How many messages went because memory was full: always the first ones."""
        self.bytes = state_bytes
        self.readers = 1
        """Who still needs it: the ring of its robot, and the recording."""
        self.messages: Deque[Message] = deque()
        """Those in memory; read them by their numbers: `message`."""

    @property
    def count(self) -> int:
        """Number of its messages, with those that were dropped."""
        return self.dropped + len(self.messages)

    def message(self, number: int) -> Message:
        """Returns one by its number, which is at least `dropped`."""
        return self.messages[number - self.dropped]

    def drop(self) -> None:
        """Drops its oldest message."""
        self.bytes -= len(self.messages.popleft()[2]) + OVERHEAD_BYTES
        self.dropped += 1


class Reader:
    """The place up to which a recording has read a robot's messages. Use `RobotRing.reader`."""

    def __init__(self, ring: Ring, segments: List[Segment]) -> None:
        """Begins with the first of some segments, of which the last one may still grow."""
        self._ring = ring
        self.segments = deque(segments)
        self.first = segments[0]
        """The segment with which the recording begins."""
        self.position = segments[0].dropped
        self.lost = 0
        """Messages that went before they were read."""
        self.end: Optional[int] = None
        """Number of messages of the last segment that still belong to the recording; None: it goes on."""

    def read(self, most_bytes: int) -> List[Message]:
        """Returns the next messages, at most so many bytes and at least one; empty: there are none now."""
        found: List[Message] = []
        size = 0
        with self._ring.lock:
            while self.segments and size < most_bytes:
                segment = self.segments[0]
                is_last = len(self.segments) == 1
                end = self.end if is_last and self.end is not None else segment.count
                dropped = min(segment.dropped, end)
                if dropped > self.position:
                    self.lost += dropped - self.position
                    self.position = dropped
                while self.position < end and size < most_bytes:
                    message = segment.message(self.position)
                    found.append(message)
                    size += len(message[2]) + OVERHEAD_BYTES
                    self.position += 1
                if self.position < end or (is_last and self.end is None):
                    break
                self.segments.popleft()
                self.position = 0
                self._ring.release(segment)
        return found

    @property
    def is_complete(self) -> bool:
        """Whether everything that belongs to the recording has been read."""
        return not self.segments

    def close(self) -> None:
        """Ends the reading."""
        with self._ring.lock:
            while self.segments:
                self._ring.release(self.segments.popleft())


class Ring:
    """The messages of all robots of a process."""

    def __init__(self, memory_bytes: float) -> None:
        """Starts empty."""
        self.lock = threading.Lock()
        """Held for some microseconds at a time."""
        self.used_bytes = 0
        self.dropped = 0
        """Messages that went before they were too old, because memory was full."""
        self.too_large: Optional[Tuple[str, int]] = None
        """Topic and bytes of the latest message that alone does not fit; it would cost all others."""
        self._memory_bytes = memory_bytes
        self._segments: OrderedDict[Segment, None] = OrderedDict()  # oldest first

    def add(self, segment: Segment, message: Message) -> None:
        """Adds a message to a segment, which must be the last one of its robot."""
        size = len(message[2]) + OVERHEAD_BYTES
        with self.lock:
            if size > self._memory_bytes:
                self.dropped += 1
                self.too_large = message[1].topic, len(message[2])
                return
            segment.messages.append(message)
            segment.bytes += size
            self.used_bytes += size
            if self.used_bytes > self._memory_bytes:
                self._make_room()

    def begin(self, segment: Segment) -> None:
        """Adds a segment, with the lock held."""
        self._segments[segment] = None
        self.used_bytes += segment.bytes
        if self.used_bytes > self._memory_bytes:
            self._make_room()

    def release(self, segment: Segment) -> None:
        """Notes, with the lock held, that one of its readers no longer needs a segment."""
        segment.readers -= 1
        if not segment.readers and segment in self._segments:
            del self._segments[segment]
            self.used_bytes -= segment.bytes
            segment.messages.clear()

    def _make_room(self) -> None:
        for _ in range(len(self._segments)):
            segment = next(iter(self._segments))
            while segment.dropped < segment.count:
                before = segment.bytes
                segment.drop()
                self.dropped += 1
                self.used_bytes -= before - segment.bytes
                if self.used_bytes <= self._memory_bytes:
                    return
            self._segments.move_to_end(segment)  # what is added to it later is newer than the messages of the others


class RobotRing:
    """The messages of one robot. Called by one thread at a time; a `Reader` may read in another thread."""

    def __init__(self, ring: Ring, before_s: float) -> None:
        """Starts without a segment; `before_s` is the time that messages wait."""
        self._ring = ring
        self._before_s = before_s
        self._segments: Deque[Segment] = deque()
        self.current: Optional[Segment] = None
        """The segment that grows."""
        self._reader: Optional[Reader] = None

    def begin_segment(
        self, now_s: float, states: Mapping[str, SavedSignal], changed: int, quiet: Sequence[Message] = ()
    ) -> None:
        """Begins a segment with states, of which so many are not those of the segment before, and `Segment.quiet`."""
        quiet_bytes = sum(len(data) + OVERHEAD_BYTES for _, _, data in quiet)
        segment = Segment(now_s, states, changed * STATE_BYTES + quiet_bytes, quiet)
        with self._ring.lock:
            self._segments.append(segment)
            self._ring.begin(segment)
            self.current = segment
            if self._reader is not None:
                segment.readers += 1
                self._reader.segments.append(segment)
            while len(self._segments) > 1 and self._segments[1].begin_s <= now_s - self._before_s:
                self._ring.release(self._segments.popleft())

    def add(self, time_s: float, channel: Channel, data: bytes) -> None:
        """Adds a message; before the first segment it is left out."""
        if self.current is not None:
            self._ring.add(self.current, (time_s, channel, data))

    def reader(self) -> Reader:
        """Begins a recording of everything that is there, and of what comes until `end_reader`."""
        with self._ring.lock:
            # What went before the recording is not lost for it. Only the first of these may lack its first messages.
            gone = itertools.takewhile(lambda each: each.dropped == each.count, tuple(self._segments)[:-1])
            segments = list(self._segments)[len(list(gone)) :]
            for segment in segments:
                segment.readers += 1
            self._reader = Reader(self._ring, segments)
            return self._reader

    def end_reader(self) -> None:
        """Ends the recording after the messages that are there now."""
        with self._ring.lock:
            if self._reader is not None and self.current is not None:
                self._reader.end = self.current.count
            self._reader = None

    def reach_s(self, now_s: float) -> float:
        """Returns how far the messages reach back, in s; at most the time that they wait."""
        with self._ring.lock:
            for segment in self._segments:
                if segment.dropped < segment.count:
                    first_s = segment.message(segment.dropped)[0] if segment.dropped else segment.begin_s
                    return min(self._before_s, now_s - first_s)
        return 0.0

    def close(self) -> None:
        """Ends the recording and forgets the messages."""
        self.end_reader()
        with self._ring.lock:
            while self._segments:
                self._ring.release(self._segments.popleft())
            self.current = None
