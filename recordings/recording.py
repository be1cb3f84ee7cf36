"""One recorded file, whatever its format: its channels, its time span, its messages in the order of their log times.

`ros1_bag.py`, `mcap_file.py` and `sqlite_file.py` each read one format and return a `RecordedFile`. A file that ends
early or is damaged is read as far as possible; `problem` then says how far.
"""

from __future__ import annotations

from typing import Iterable, Iterator, List, Mapping, NamedTuple, Optional, Protocol, Sequence, Tuple, TypeVar


class RecordingError(Exception):
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
"""What the reader of a recording wants to get with each message of a channel."""

RawMessage = Tuple[int, Target, bytes]
"""Log time in nanoseconds since 1970, the channel's target, the message as it was serialized."""


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
        """Log times of the first and the last message; None without messages."""

    @property
    def problem(self) -> str:
        """One line that says what could not be read, empty if there was nothing so far."""

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels in the order of their log times, as far as the file can be read.

        Args:
            targets: the channels, each with what to yield with its messages.
        """


Entry = Tuple[int, int, bytes]
"""Log time in ns, number of the channel in its file, serialized message."""


def in_time_order(chunks: Iterable[List[Entry]]) -> Iterator[Entry]:
    """Yields the entries of chunks in the order of their times, holding back one chunk at most.

    Recorders write chunk after chunk, and messages of neighbouring chunks may overlap by a little. What overlaps by
    more than a chunk is yielded late, out of order: memory stays bounded.
    """
    held: List[Entry] = []
    for chunk in chunks:
        if not chunk:
            continue
        chunk.sort(key=_time)
        if held and chunk[0][0] < held[-1][0]:
            chunk = sorted(held + chunk, key=_time)
            ready = len(chunk) // 2
            yield from chunk[:ready]
            held = chunk[ready:]
        else:
            yield from held
            held = chunk
    yield from held


def _time(entry: Entry) -> int:
    return entry[0]


def canonical_type(name: str) -> str:
    """Returns `package/Type` for `package/msg/Type` and `package/Type`."""
    package, _, rest = name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}"
