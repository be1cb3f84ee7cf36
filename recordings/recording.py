"""One recorded file, whatever its format: its channels, its time span, its messages in the order of their log times.

`ros1_bag.py`, `mcap_file.py` and `sqlite_file.py` each read one format. A file that ends early or is damaged is read as
far as possible; `problem` then says how far.

`.bag` and `.mcap` files are records one after the other, most messages in chunks. They are read chunk after chunk,
which needs no index: one way serves intact and damaged files, and memory does not grow with their length. A damaged
record is left out; reading ends where the next record cannot be found.
"""

from __future__ import annotations

import abc
import bz2
import os
import struct
from itertools import chain
from operator import itemgetter
from typing import Any, BinaryIO, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Tuple, TypeVar

from ..core.messages import RawFormat
from ..core.values import ConfigError, MessageError, canonical_type, count_text
from ..runtime.libraries import RECORDINGS, libraries

LARGEST = 64 << 20
"""Bytes of a record, a chunk or a message, packed or unpacked: several of them are in memory at the same time."""
_LARGEST_RATIO = 10_000  # bytes that one packed byte may become; black images with zstd come close to it
_LONGEST_NAME = 500  # characters of a topic or a type; ROS 2 allows 255
_MOST_CHANNELS = 10_000
_MOST_MESSAGES = 500_000  # messages of a chunk; recorders write chunks of about 1 MB unless one message is larger
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # CDR begins with a zero
_BATCH = 4096
_BATCH_BYTES = 16 << 20  # messages outside of chunks that are sorted together: at most so many, of so many bytes


class Damaged(MessageError):
    """A part of a file that cannot be read. `str()` says why."""


class RecordingError(ConfigError):
    """A recording that cannot be read at all. `str()` is one line: which file, what is wrong, what is expected."""


class Channel(NamedTuple):
    """A topic with the format of its messages, as one file has it."""

    topic: str  # the absolute name
    raw_format: RawFormat  # with an empty schema if the file has no definition of the type

    @property
    def type_name(self) -> str:
        """The type as `package/Type`."""
        return canonical_type(self.raw_format.schema_name)


Target = TypeVar("Target")
"""A value that a reader attaches to a channel and gets with each of its messages."""

RawMessage = Tuple[int, Target, bytes]
"""Log time in nanoseconds since 1970, the channel's target, the message as it was serialized."""

Messages = List[RawMessage[Any]]
Wanted = Optional[Mapping[int, Any]]
"""The numbers of the channels whose messages are wanted, each with its target. None if all messages are wanted, with
the number of their channel as target and without data; channels are noted."""

Span = Optional[Tuple[int, int]]
"""Log times of the first and the last message; None without messages."""

log_time = itemgetter(0)
"""Returns the log time of a `RawMessage`."""


class RecordedFile(abc.ABC):
    """One file of a recording."""

    MAGIC: bytes  # what the file starts with
    EXPECTED: str  # what the file is expected to be, if it starts with other bytes

    def __init__(self, path: str, name: str = "") -> None:
        """Reads the index, or the whole file if there is none; `name` is the path to show, if it differs.

        Raises RecordingError if it cannot be opened or is of another format.
        """
        self.name = name or path  # for messages to people
        self.problem = ""
        """One line that says what could not be read; empty if everything could so far."""
        self.has_holes = False
        """Whether messages between others were left out so far, because they could not be read."""
        self.span_ns: Span = None
        """When reading stops at damage, the end becomes the last message that was read."""
        self.attachments: dict[str, str] = {}
        """The texts that a black box attaches, by name."""
        self._path = path
        self._channels: dict[int, Channel] = {}
        self._texts: dict[str, str] = {}  # each definition once: channels may share one
        try:
            with open(path, "rb") as file:
                if file.read(len(self.MAGIC)) != self.MAGIC:
                    raise RecordingError(f"expected {self.EXPECTED}", file=self.name)
                self._open(file)
        except OSError as error:
            raise RecordingError(f"cannot be read: {error.strerror or error}", file=self.name) from None

    @property
    def channels(self) -> list[Channel]:
        """The channels, each once, in the order of the file."""
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels in the order of their log times, as far as the file can be read.

        `targets` are the channels, each with what to yield with its messages.
        """
        wanted = {number: targets[channel] for number, channel in self._channels.items() if channel in targets}
        messages = self._messages(wanted)
        is_cdr = any(channel.raw_format.message_encoding == "cdr" for channel in targets)
        for first in messages:
            is_packed = is_cdr and first[2][:4] == _ZSTD_MAGIC  # then all are
            rest = chain([first], messages)
            yield from self._unpacked(rest) if is_packed else rest

    @abc.abstractmethod
    def _open(self, file: BinaryIO) -> None:
        """Reads channels and time span; the file has been read up to the end of `MAGIC`."""

    @abc.abstractmethod
    def _messages(self, wanted: Mapping[int, Target]) -> Iterator[RawMessage[Target]]:
        """Yields messages as `messages` does."""

    def _add_channel(self, number: int, topic: str, raw_format: RawFormat) -> None:
        """Adds a channel as the file has it. Raises Damaged if a name is too long, or there are too many."""
        if len(self._channels) >= _MOST_CHANNELS:
            raise Damaged(f"more than {_MOST_CHANNELS} channels")
        for name in (topic, raw_format.schema_name):
            if len(name) > _LONGEST_NAME:
                raise Damaged(f"a name of {len(name)} characters, expected at most {_LONGEST_NAME}")
        text = self._texts.setdefault(raw_format.schema, raw_format.schema)
        self._channels[number] = Channel("/" + topic.strip("/"), raw_format._replace(schema=text))

    @staticmethod
    def _span_of(chunks: Iterable[Messages]) -> Span:
        """Returns the time span of messages in any order."""
        span: Span = None
        for times in (list(map(log_time, chunk)) for chunk in chunks):
            times.extend(span or ())
            span = (min(times), max(times)) if times else None
        return span

    def _end_span(self, last_ns: int) -> None:
        """Ends the time span with the last message that was read; with 0, with the first."""
        if self.span_ns is not None:
            first_ns, end_ns = self.span_ns
            self.span_ns = first_ns, max(first_ns, min(end_ns, last_ns))

    def _unpacked(self, messages: Iterator[RawMessage[Target]]) -> Iterator[RawMessage[Target]]:
        """Unpacks messages that rosbag2 has compressed with zstd one by one."""
        with libraries(*RECORDINGS):
            import zstandard

        decompressor = zstandard.ZstdDecompressor(max_window_size=LARGEST)
        damaged = 0
        for time_ns, target, data in messages:
            try:
                check_size(zstandard.frame_content_size(data), len(data))
                unpacked = decompressor.decompress(data, max_output_size=LARGEST)
            except (zstandard.ZstdError, Damaged):
                damaged += 1
                self.has_holes = True
            else:
                yield time_ns, target, unpacked
        if damaged and not self.problem:
            self.problem = f"{self.name}: damaged: {count_text(damaged, 'message')} cannot be unpacked and left out"


class Record(NamedTuple):
    """One record of a `.bag` or `.mcap` file."""

    kind: Any  # what the format has in front of the data
    is_chunk: bool
    data: bytes
    complete: bool  # False if the file ends within the record


class ChunkedFile(RecordedFile):
    """A file of records."""

    DAMAGE: tuple[type[Exception], ...] = (
        Damaged, KeyError, ValueError, EOFError, OSError, OverflowError, struct.error, IndexError,
    )  # fmt: skip
    """What reading damaged bytes raises."""
    DAMAGED_INDEX: str  # what is wrong if reading the index raises that
    _counts: Mapping[int, int] | None = None  # messages per channel according to the index; None without an index

    def _open(self, file: BinaryIO) -> None:
        try:
            missing = self._read_index(file)
        except self.DAMAGE:
            missing = self.DAMAGED_INDEX
        if missing is not None:
            self._channels.clear()
            self.span_ns = self._span_of(self._chunks(file, None))
            self.problem = self.problem or (missing and f"{self.name}: {missing}: read to its end")

    def _messages(self, wanted: Mapping[int, Target]) -> Iterator[RawMessage[Target]]:
        if self._counts is not None and not any(self._counts.get(number) for number in wanted):
            return
        with open(self._path, "rb") as file:
            yield from in_time_order(self._counted(self._chunks(file, wanted), wanted))

    @abc.abstractmethod
    def _read_index(self, file: BinaryIO) -> str | None:
        """Reads the index; returns None, or what is wrong with it: empty if a complete file needs none."""

    @abc.abstractmethod
    def _read_record(self, file: BinaryIO, size: int) -> Record | None:
        """Reads the next record of a file of `size` bytes, if it is needed; None at the end. Raises any of `DAMAGE`."""

    @abc.abstractmethod
    def _take(self, record: Record, wanted: Wanted, into: Messages) -> None:
        """Takes channels and messages from a record. Raises what is in `DAMAGE` if the rest cannot be read."""

    def _chunks(self, file: BinaryIO, wanted: Wanted) -> Iterator[Messages]:
        """Yields the messages of each chunk, and those outside of chunks in batches."""
        file.seek(len(self.MAGIC))
        size = os.fstat(file.fileno()).st_size
        last_ns = position = loose_bytes = 0
        messages: Messages = []
        is_chunk = False
        end: Exception | None = None
        while end is None:
            position = file.tell()
            try:
                record = self._read_record(file, size)
            except self.DAMAGE as error:
                end = error
            else:
                if record is None:
                    break
                try:
                    self._take(record, wanted, messages)
                except self.DAMAGE as error:
                    self._leave_out(position, size, error)
                if not record.complete:
                    end = Damaged("the file ends within a record")
                is_chunk = record.is_chunk
                loose_bytes += len(record.data)
                del record  # its bytes are not needed while the messages are read
            last_ns = max(last_ns, messages[-1][0] if messages else 0)
            if is_chunk or len(messages) >= _BATCH or loose_bytes > _BATCH_BYTES:
                yield messages
                messages, loose_bytes = [], 0
        if end is not None:
            self.problem = f"{self._damage_at(position, size, end)}: read up to there"
            self._end_span(last_ns)
        yield messages

    @staticmethod
    def _add_message(
        messages: Messages, wanted: Wanted, number: int, time_ns: int, data: bytes, start: int, end: int
    ) -> None:
        """Adds a message to those of its chunk, if it is wanted. Raises Damaged if the chunk has implausibly many."""
        if len(messages) >= _MOST_MESSAGES:
            raise Damaged(f"a chunk with more than {_MOST_MESSAGES} messages")
        if wanted is None:
            messages.append((time_ns, number, b""))
        elif number in wanted:
            messages.append((time_ns, wanted[number], data[start:end]))

    def _counted(self, chunks: Iterator[Messages], wanted: Mapping[int, Any]) -> Iterator[Messages]:
        """Compares the number of messages with the index: damage may look like a record that is not needed."""
        count = 0
        for chunk in chunks:
            count += len(chunk)
            yield chunk
        if self._counts is not None:
            expected = sum(self._counts.get(number, 0) for number in wanted)
            self.has_holes = self.has_holes or count != expected
            if count != expected and not self.problem:
                self.problem = f"{self.name}: damaged: expected {expected} messages, got {count}"

    def _leave_out(self, position: int, size: int, error: Exception) -> None:
        """Notes that a part of a record is left out; only the first damage is named."""
        self.has_holes = True
        self.problem = self.problem or f"{self._damage_at(position, size, error)}: a part of it is left out"

    def _damage_at(self, position: int, size: int, error: Exception) -> str:
        reason = str(error) if isinstance(error, (Damaged, OSError)) else "not as the format requires"
        return f"{self.name}: damaged at byte {position} of {size} ({reason})"


def in_time_order(chunks: Iterable[list[RawMessage[Target]]]) -> Iterator[RawMessage[Target]]:
    """Yields the messages of chunks in the order of their times, holding back one chunk at most.

    Recorders write chunk after chunk, and neighbouring chunks may overlap in time. A message that is late by more than
    a chunk is yielded late: memory stays bounded.
    """
    held: list[RawMessage[Target]] = []
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
    """Raises Damaged if `packed` bytes are to become implausibly many; call before anything is unpacked."""
    if size > min(LARGEST, (1 << 20) + _LARGEST_RATIO * packed):
        raise Damaged(f"a part that unpacks from {packed} to {size} bytes")


def unpack(compression: str, data: bytes, size: int) -> bytes:
    """Returns the content of a chunk, one byte more than `size` if there are more.

    Raises Damaged if it cannot be unpacked, or is to become implausibly large.
    """
    check_size(size, len(data))
    if compression in ("", "none"):
        return data
    if compression == "bz2":
        return bz2.BZ2Decompressor().decompress(data, size)
    if compression == "lz4":
        with libraries(*RECORDINGS):
            import lz4.frame

        try:
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1))
        except RuntimeError as error:
            raise Damaged(str(error)) from None
    if compression == "zstd":
        with libraries(*RECORDINGS):
            import zstandard

        try:
            with zstandard.ZstdDecompressor(max_window_size=LARGEST).stream_reader(data) as stream:
                return bytes(stream.read(size + 1))
        except zstandard.ZstdError as error:
            raise Damaged(str(error)) from None
    raise Damaged(f"compression {compression!r}, expected none, bz2, lz4 or zstd")
