"""One recorded file, whatever its format: its channels, its time span, its messages in the order of their log times.

`ros1_bag.py`, `mcap_file.py` and `sqlite_file.py` each read one format and return a `RecordedFile`. A file that ends
early or is damaged is read as far as possible; `problem` then says how far.
"""

from __future__ import annotations

from operator import itemgetter
from typing import Iterable, Iterator, List, Mapping, NamedTuple, Optional, Protocol, Sequence, Tuple, TypeVar

from robot_health_monitor.core.errors import ConfigError, MessageError
from robot_health_monitor.core.middleware import canonical_type

LARGEST = 64 << 20
"""Bytes of a record, a chunk or a message, packed or unpacked: several of them are in memory at the same time."""
_LARGEST_RATIO = 10_000
"""Bytes that one packed byte may become; black images with zstd come close to it."""
_LONGEST_NAME = 500
"""Characters of a topic or a type; ROS 2 allows 255."""


class Damaged(MessageError):
    """A part of a file that cannot be read. `str()` says why."""


class RecordingError(ConfigError):
    """A recording that cannot be read at all. `str()` is one line: which file, what is wrong, what is expected."""


class Channel(NamedTuple):
    """A topic with the type of its messages, as one file has it."""

    topic: str
    """The absolute name."""
    type_name: str
    """`package/Type`."""
    encoding: str
    """`ros1` or `cdr`."""
    definition: str
    """Text of the type's definition with those of the types in it; empty if the file has none."""
    definition_format: str
    """`msg` or `idl`; empty if the file has no definition."""


Target = TypeVar("Target")
"""A value that a reader attaches to a channel and gets with each of its messages."""

RawMessage = Tuple[int, Target, bytes]
"""Log time in nanoseconds since 1970, the channel's target, the message as it was serialized."""

log_time = itemgetter(0)
"""Returns the log time of a `RawMessage`."""


class RecordedFile(Protocol):
    """One file of a recording."""

    @property
    def name(self) -> str:
        """Path of the file, for messages to people."""

    @property
    def channels(self) -> Sequence[Channel]:
        """The channels, in the order of the file."""

    @property
    def span_ns(self) -> Optional[Tuple[int, int]]:
        """Log times of the first and the last message; None without messages.

        When reading stops at damage, the end becomes the last message that was read.
        """

    @property
    def problem(self) -> str:
        """One line that says what could not be read; empty if everything could so far."""

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels in the order of their log times, as far as the file can be read.

        Args:
            targets: the channels, each with what to yield with its messages.
        """


def in_time_order(chunks: Iterable[List[RawMessage[Target]]]) -> Iterator[RawMessage[Target]]:
    """Yields the messages of chunks in the order of their times, holding back one chunk at most.

    Recorders write chunk after chunk, and neighbouring chunks may overlap in time. A message that is late by more than
    a chunk is yielded late: memory stays bounded.
    """
    held: List[RawMessage[Target]] = []
    for chunk in chunks:
        if not chunk:
            continue
        chunk.sort(key=log_time)
        if held and chunk[0][0] < held[-1][0]:
            chunk = sorted(held + chunk, key=log_time)
            ready = len(chunk) // 2
            yield from chunk[:ready]
            held = chunk[ready:]
            if sum(len(data) for _, _, data in held) > LARGEST:
                yield from held
                held = []
        else:
            yield from held
            held = chunk
    yield from held


def check_size(size: int, packed: int) -> None:
    """Checks a size before anything is unpacked.

    Args:
        size: bytes when unpacked.
        packed: bytes now.

    Raises:
        Damaged: it is too large, or too much larger than `packed`.
    """
    if size > min(LARGEST, (1 << 20) + _LARGEST_RATIO * packed):
        raise Damaged(f"a part that unpacks from {packed} to {size} bytes")


def new_channel(topic: str, type_name: str, encoding: str, definition: str, definition_format: str) -> Channel:
    """Returns a channel.

    Args:
        topic: as the file has it.
        type_name: as the file has it.
        encoding: as in `Channel`.
        definition: as in `Channel`.
        definition_format: as in `Channel`.

    Raises:
        Damaged: a name is too long.
    """
    for name in (topic, type_name):
        if len(name) > _LONGEST_NAME:
            raise Damaged(f"a name of {len(name)} characters, expected at most {_LONGEST_NAME}")
    return Channel("/" + topic.strip("/"), canonical_type(type_name), encoding, definition, definition_format)


def until(span_ns: Optional[Tuple[int, int]], last_ns: int) -> Optional[Tuple[int, int]]:
    """Returns a time span that ends with the last message that was read; `last_ns` 0: with the first."""
    return None if span_ns is None else (span_ns[0], max(span_ns[0], min(span_ns[1], last_ns)))
