"""The common part of `.bag` and `.mcap` files: records one after the other, most messages in chunks.

Files are read chunk after chunk, which needs no index: one way serves intact and damaged files, and memory does not
grow with their length. A damaged record is left out; reading ends where the next record cannot be found.
"""

from __future__ import annotations

import abc
import os
import struct
from typing import Any, BinaryIO, ClassVar, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple, Type

from .recording import (
    Channel,
    Damaged,
    RawMessage,
    RecordingError,
    Target,
    in_time_order,
    new_channel,
    until,
)

_BATCH = 4096
_BATCH_BYTES = 16 << 20
"""Messages outside of chunks that are sorted together: at most so many, of so many bytes."""
_MOST_MESSAGES = 500_000
"""Messages of a chunk; recorders write chunks of about 1 MB unless one message is larger."""
_MOST_CHANNELS = 10_000


class Record(NamedTuple):
    """One record."""

    kind: Any
    """What the format has in front of the data."""
    data: bytes
    complete: bool
    """False if the file ends within the record."""


class ChunkedFile(abc.ABC):
    """A file of records; the base of classes that implement `recording.RecordedFile`."""

    MAGIC: ClassVar[bytes]
    """The bytes that the file starts with."""
    EXPECTED: ClassVar[str]
    """What the file is expected to be, if it starts with other bytes."""
    DAMAGE: ClassVar[Tuple[Type[Exception], ...]] = (
        Damaged, KeyError, ValueError, EOFError, OSError, OverflowError, struct.error, IndexError,
    )  # fmt: skip
    """What reading damaged bytes raises."""

    def __init__(self, path: str, name: str = "") -> None:
        """Reads the index, or the whole file if there is none.

        Args:
            path: the file.
            name: path to show, if it differs.

        Raises:
            RecordingError: it cannot be opened or is of another format.
        """
        self.name = name or path
        self.problem = ""
        self.span_ns: Optional[Tuple[int, int]] = None
        self._path = path
        self._channels: Dict[int, Channel] = {}
        self._texts: Dict[str, str] = {}
        """Each definition once: channels may share one."""
        self._counts: Optional[Mapping[int, int]] = None
        """Messages per channel according to the index; None without an index."""
        try:
            with open(path, "rb") as file:
                if file.read(len(self.MAGIC)) != self.MAGIC:
                    raise RecordingError(f"expected {self.EXPECTED}", file=self.name)
                missing = self._read_index(file)
                if missing is not None:
                    self._scan(file)
                    self.problem = self.problem or (missing and f"{self.name}: {missing}: read to its end")
        except OSError as error:
            raise RecordingError(f"cannot be read: {error.strerror or error}", file=self.name) from None

    @property
    def channels(self) -> List[Channel]:
        """The channels, each once, in the order of the file."""
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels; see `recording.RecordedFile`."""
        wanted = {number: targets[channel] for number, channel in self._channels.items() if channel in targets}
        with open(self._path, "rb") as file:
            yield from in_time_order(self._counted(self._chunks(file, wanted), wanted))

    @abc.abstractmethod
    def _read_index(self, file: BinaryIO) -> Optional[str]:
        """Reads channels and time span from the index.

        Returns:
            None if it could be read; else what is wrong with it, empty if the file is complete without one.
        """

    @abc.abstractmethod
    def _read_record(self, file: BinaryIO, size: int) -> Optional[Record]:
        """Reads the next record of a file of `size` bytes, as far as it is needed; None at the end.

        Raises:
            Damaged: this is not a record. Everything in `DAMAGE` counts as that.
        """

    @abc.abstractmethod
    def _take(
        self,
        record: Record,
        wanted: Optional[Mapping[int, Any]],
        chunk: List[RawMessage[Any]],
        loose: List[RawMessage[Any]],
    ) -> None:
        """Takes channels and messages from a record.

        Args:
            record: the record.
            wanted: the numbers of the channels whose messages to take, each with their target; None: the messages of
                all channels, without data.
            chunk: gets the messages if the record is a chunk.
            loose: gets the message if the record is a message outside of chunks.

        Raises:
            Damaged: the rest of the record cannot be read. Everything in `DAMAGE` counts as that.
        """

    def _chunks(self, file: BinaryIO, wanted: Optional[Mapping[int, Any]]) -> Iterator[List[RawMessage[Any]]]:
        """Yields the messages of each chunk; `wanted` as in `_take`."""
        file.seek(len(self.MAGIC))
        size = os.fstat(file.fileno()).st_size
        last_ns = 0
        loose: List[RawMessage[Any]] = []
        loose_bytes = 0
        ended = False
        while not ended:
            position = file.tell()
            chunk: List[RawMessage[Any]] = []
            try:
                record = self._read_record(file, size)
                if record is None:
                    break
            except self.DAMAGE as error:
                self._end(position, size, error)
                ended = True
            else:
                try:
                    self._take(record, wanted, chunk, loose)
                except self.DAMAGE as error:
                    self._leave_out(position, size, error)
                loose_bytes += len(record.data)
                complete = record.complete
                del record  # its bytes are not needed while the messages are read
                if not complete:
                    self._end(position, size, Damaged("the file ends within a record"))
                    ended = True
            last_ns = max(last_ns, chunk[-1][0] if chunk else 0, loose[-1][0] if loose else 0)
            if chunk:
                yield chunk
            elif len(loose) >= _BATCH or loose_bytes > _BATCH_BYTES:
                yield loose
                loose, loose_bytes = [], 0
        if ended:
            self.span_ns = until(self.span_ns, last_ns)
        yield loose

    def _add_message(self, messages: List[RawMessage[Any]], time_ns: int, target: Any, data: bytes) -> None:
        """Adds a message to those of its chunk.

        Raises:
            Damaged: the chunk has implausibly many.
        """
        if len(messages) >= _MOST_MESSAGES:
            raise Damaged(f"a chunk with more than {_MOST_MESSAGES} messages")
        messages.append((time_ns, target, data))

    def _add_channel(self, number: int, topic: str, type_name: str, encoding: str, text: str, form: str) -> None:
        """Adds a channel; see `recording.new_channel`.

        Raises:
            Damaged: a name is too long, or there are too many channels.
        """
        if len(self._channels) >= _MOST_CHANNELS:
            raise Damaged(f"more than {_MOST_CHANNELS} channels")
        text = self._texts.setdefault(text, text)
        self._channels[number] = new_channel(topic, type_name, encoding, text, form)

    def _counted(
        self, chunks: Iterator[List[RawMessage[Any]]], wanted: Mapping[int, Any]
    ) -> Iterator[List[RawMessage[Any]]]:
        """Compares the number of messages with the index: damage may look like a record that is not needed."""
        found = 0
        for chunk in chunks:
            found += len(chunk)
            yield chunk
        if self._counts is not None:
            expected = sum(self._counts.get(number, 0) for number in wanted)
            if found != expected and not self.problem:
                self.problem = f"{self.name}: damaged: expected {expected} messages, got {found}"

    def _scan(self, file: BinaryIO) -> None:
        """Finds channels and time span by reading the whole file."""
        first, last = None, 0
        for messages in self._chunks(file, None):
            for time_ns, _, _ in messages:
                first = time_ns if first is None else min(first, time_ns)
                last = max(last, time_ns)
        self.span_ns = None if first is None else (first, last)

    def _end(self, position: int, size: int, error: Exception) -> None:
        """Notes that reading ends at a position."""
        self.problem = f"{self._damage_at(position, size, error)}: read up to there"

    def _leave_out(self, position: int, size: int, error: Exception) -> None:
        """Notes that a part of a record is left out; only the first damage is named."""
        self.problem = self.problem or f"{self._damage_at(position, size, error)}: a part of it is left out"

    def _damage_at(self, position: int, size: int, error: Exception) -> str:
        reason = str(error) if isinstance(error, (Damaged, OSError)) else "not as the format requires"
        return f"{self.name}: damaged at byte {position} of {size} ({reason})"
