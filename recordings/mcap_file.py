"""MCAP files, profiles ros1 and ros2: chunk after chunk, with or without an index, also when the file ends early.

The library mcap reads the summary, schemas and channels. Messages are cut out of chunks here, because the library makes
an object of each one, images included. Source of the format: mcap.dev/spec.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from typing import Any, BinaryIO, Collection, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel as McapChannel
from mcap.records import Schema

from .recording import Channel, RawMessage, RecordingError, Target, canonical_type, in_time_order, until

_MAGIC = b"\x89MCAP0\r\n"
_ENCODINGS = ("ros1", "cdr")
_FORMATS = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}
_LARGEST_RECORD = 1 << 30
"""Bytes of a record, packed and unpacked; recorders write chunks of about 1 MB unless one message is larger."""
_BATCH = 4096
"""Messages outside of chunks that are sorted together."""

_OPCODE_OF_MESSAGE = int(Opcode.MESSAGE)
_prefix = struct.Struct("<BQ").unpack_from
_message = struct.Struct("<HIQ").unpack_from
_MESSAGE_HEADER = 22
_chunk_header = struct.Struct("<QQQII").unpack_from


class _Damaged(Exception):
    """A part of the file that cannot be read."""


_DAMAGE = (_Damaged, McapError, ValueError, KeyError, EOFError, OSError, OverflowError, struct.error, IndexError)
"""What reading damaged bytes raises."""


class _ChunkPlace(NamedTuple):
    start: int
    channels: Collection[int]
    """Numbers of the channels with messages in the chunk; empty: unknown."""


class McapFile:
    """An `.mcap` file; implements `recording.RecordedFile`."""

    def __init__(self, path: str, name: str = "") -> None:
        """Reads the summary, or the whole file if there is none.

        Args:
            path: the file.
            name: path to show, if it differs.

        Raises:
            RecordingError: it cannot be opened or is no MCAP file.
        """
        self.name = name or path
        self._path = path
        self.problem = ""
        self.span_ns: Optional[Tuple[int, int]] = None
        self._schemas: Dict[int, Schema] = {}
        self._channels: Dict[int, Channel] = {}
        self._places: List[_ChunkPlace] = []
        try:
            with open(path, "rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise RecordingError(f"{self.name}: expected an MCAP file, which starts with 89 4D 43 41 50")
                if not self._read_summary(file):
                    self._scan()
        except OSError as error:
            raise RecordingError(f"{self.name}: cannot be read: {error.strerror or error}") from None

    @property
    def channels(self) -> List[Channel]:
        """The channels, each once, in the order of the file."""
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels; see `recording.RecordedFile`."""
        wanted = {number: targets[channel] for number, channel in self._channels.items() if channel in targets}
        return in_time_order(self._chunks(wanted))

    def _read_summary(self, file: BinaryIO) -> bool:
        """Reads channels, time span and the places of the chunks; returns False if they are missing or damaged."""
        file.seek(-len(_MAGIC), os.SEEK_END)
        if file.read() != _MAGIC:
            self.problem = f"{self.name}: has no summary (the recorder was stopped early): read to its end"
            return False
        file.seek(0)
        try:
            summary = make_reader(file).get_summary()
        except (*_DAMAGE, MemoryError):
            self.problem = f"{self.name}: its summary is damaged: read to its end"
            return False
        statistics = summary and summary.statistics
        if not summary or not statistics or len(summary.channels) != statistics.channel_count:
            return False  # summaries are optional
        if statistics.chunk_count != len(summary.chunk_indexes):
            return False
        self._schemas.update(summary.schemas)
        for channel in summary.channels.values():
            self._note_channel(channel)
        if statistics.message_count:
            self.span_ns = statistics.message_start_time, statistics.message_end_time
        self._places = [
            _ChunkPlace(index.chunk_start_offset, index.message_index_offsets.keys())
            for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
        ]
        return True

    def _scan(self) -> None:
        """Finds channels and time span by reading the whole file."""
        first, last = None, 0
        for entries in self._chunks(None):
            for time_ns, _, _ in entries:
                first = time_ns if first is None else min(first, time_ns)
                last = max(last, time_ns)
        self.span_ns = None if first is None else (first, last)

    def _chunks(self, wanted: Optional[Mapping[int, Any]]) -> Iterator[List[RawMessage[Any]]]:
        """Yields the messages of each chunk whose channel is in `wanted`; None: of all, without their data."""
        with open(self._path, "rb") as file:
            if self._places and wanted is not None:
                yield from self._indexed_chunks(file, wanted)
            else:
                yield from self._all_chunks(file, wanted)

    def _indexed_chunks(self, file: BinaryIO, wanted: Mapping[int, Any]) -> Iterator[List[RawMessage[Any]]]:
        for place in self._places:
            if not place.channels or not wanted.keys().isdisjoint(place.channels):
                entries: List[RawMessage[Any]] = []
                try:
                    file.seek(place.start)
                    opcode, length = _read_prefix(file)
                    if opcode != Opcode.CHUNK:
                        raise _Damaged("the index names a chunk where there is none")
                    self._read_chunk(_read(file, length), wanted, entries)
                except _DAMAGE as error:
                    self._leave_out(place.start, file, error)
                yield entries

    def _all_chunks(self, file: BinaryIO, wanted: Optional[Mapping[int, Any]]) -> Iterator[List[RawMessage[Any]]]:
        size = os.fstat(file.fileno()).st_size
        position, last_ns = len(_MAGIC), 0
        loose: List[RawMessage[Any]] = []
        file.seek(position)
        while True:
            entries: List[RawMessage[Any]] = []
            framed = False
            try:
                opcode, length = _read_prefix(file)
                position_after = file.tell() + length
                if opcode == Opcode.DATA_END:
                    break
                if opcode == Opcode.CHUNK:
                    record = _read(file, length, partly=True)
                    framed = len(record) == length
                    self._read_chunk(record, wanted, entries)
                elif opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                    record = _read(file, length)
                    framed = True
                    self._take_record(opcode, record, 0, length, wanted, loose)
                elif not opcode or position_after > size:
                    raise _Damaged("the file ends within a record" if opcode else "a record of type 0")
                file.seek(position_after)
            except _DAMAGE as error:
                if not framed:
                    self.problem = f"{self.name}: damaged at byte {position} of {size} ({error}): read up to there"
                    self.span_ns = until(self.span_ns, _last_time(entries, _last_time(loose, last_ns)))
                    yield entries
                    break
                self._leave_out(position, file, error)
            position = file.tell()
            last_ns = _last_time(entries, last_ns)
            if entries:
                yield entries
            elif len(loose) >= _BATCH:
                last_ns = _last_time(loose, last_ns)
                yield loose
                loose = []
        yield loose

    def _leave_out(self, position: int, file: BinaryIO, error: Exception) -> None:
        size = os.fstat(file.fileno()).st_size
        # The first damage is named; that reading ended early matters more and replaces it.
        self.problem = (
            self.problem or f"{self.name}: damaged at byte {position} of {size} ({error}): a part of it is left out"
        )

    def _read_chunk(self, record: bytes, wanted: Optional[Mapping[int, Any]], into: List[RawMessage[Any]]) -> None:
        chunk, expected_size, expected_crc = _unpacked(record)
        if expected_crc and len(chunk) == expected_size and zlib.crc32(chunk) != expected_crc:
            raise _Damaged("a chunk with a wrong checksum")
        position, end = 0, len(chunk)
        while position < end:
            opcode, length = _prefix(chunk, position)
            start = position + 9
            position = start + length
            if position > end:
                raise _Damaged("a record goes beyond its chunk")
            if opcode == _OPCODE_OF_MESSAGE:
                number, _, time_ns = _message(chunk, start)
                if wanted is None:
                    into.append((time_ns, number, b""))
                elif number in wanted:
                    into.append((time_ns, wanted[number], chunk[start + _MESSAGE_HEADER : position]))
            else:
                self._take_record(opcode, chunk, start, length, wanted, into)
        if end != expected_size:
            raise _Damaged(f"a chunk unpacks to {end} bytes, expected {expected_size}")

    def _take_record(
        self,
        opcode: int,
        data: bytes,
        start: int,
        length: int,
        wanted: Optional[Mapping[int, Any]],
        into: List[RawMessage[Any]],
    ) -> None:
        if opcode == Opcode.MESSAGE:
            number, _, time_ns = _message(data, start)
            if wanted is None:
                into.append((time_ns, number, b""))
            elif number in wanted:
                into.append((time_ns, wanted[number], data[start + _MESSAGE_HEADER :]))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and wanted is None:
            stream = ReadDataStream(io.BytesIO(data[start : start + length]))
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
            else:
                self._note_channel(McapChannel.read(stream))

    def _note_channel(self, channel: McapChannel) -> None:
        schema = self._schemas.get(channel.schema_id)
        if schema is None or channel.message_encoding not in _ENCODINGS:
            return  # not a message of ROS
        definition_format = _FORMATS.get(schema.encoding, "")
        self._channels[channel.id] = Channel(
            "/" + channel.topic.strip("/"),
            canonical_type(schema.name),
            channel.message_encoding,
            bytes(schema.data).decode("utf-8", "replace") if definition_format else "",
            definition_format,
        )


def _read_prefix(file: BinaryIO) -> Tuple[int, int]:
    data = file.read(9)
    if len(data) < 9:
        raise _Damaged("the file ends within a record")
    opcode, length = _prefix(data)
    return int(opcode), int(length)


def _read(file: BinaryIO, length: int, partly: bool = False) -> bytes:
    if length > _LARGEST_RECORD:
        raise _Damaged(f"a record of {length} bytes, expected at most {_LARGEST_RECORD}")
    data = file.read(length)
    if len(data) < length and not partly:
        raise _Damaged("the file ends within a record")
    return data


def _last_time(entries: List[RawMessage[Any]], last_ns: int) -> int:
    return max(last_ns, entries[-1][0]) if entries else last_ns


def _unpacked(record: bytes) -> Tuple[bytes, int, int]:
    """Returns the content of a chunk as far as it can be unpacked, with its expected size and checksum."""
    _, _, size, crc, name_length = _chunk_header(record)
    position = 32 + name_length
    compression = record[32:position].decode("utf-8")
    data = record[position + 8 :]
    if size > _LARGEST_RECORD:
        raise _Damaged(f"a chunk of {size} bytes, expected at most {_LARGEST_RECORD}")
    if compression == "zstd":
        data = _unpack_zstd(data, size)
    elif compression == "lz4":
        data = _unpack_lz4(data, size)
    elif compression:
        raise _Damaged(f"compression {compression!r}, expected zstd or lz4")
    return data, size, crc


def _unpack_zstd(data: bytes, size: int) -> bytes:
    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            return bytes(stream.read(size + 1))
    except zstandard.ZstdError as error:
        raise _Damaged(str(error)) from None


def _unpack_lz4(data: bytes, size: int) -> bytes:
    try:
        unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
    except RuntimeError as error:
        raise _Damaged(str(error)) from None
    return unpacked
