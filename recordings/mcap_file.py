"""MCAP files, profiles ros1 and ros2, with or without an index.

The library mcap reads the summary, schemas and channels. Messages are cut out of chunks here, because the library makes
an object of each one, images included. Source of the format: mcap.dev/spec.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from typing import Any, BinaryIO, Collection, Dict, FrozenSet, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as McapChannel
from mcap.records import ChunkIndex, Schema, Statistics

from .chunked_file import ChunkedFile, Record
from .recording import LARGEST, Damaged, RawMessage, check_size

_ENCODINGS = ("ros1", "cdr")
_FORMATS = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}
_LARGEST_INDEX_RECORD = 8 << 20
"""Bytes of a record of the summary."""

_OPCODE_OF_MESSAGE = int(Opcode.MESSAGE)
_BLOCK = 1 << 20
_PREFIX_SIZE = 9
_prefix = struct.Struct("<BQ").unpack_from
_message = struct.Struct("<HIQ").unpack_from
_MESSAGE_HEADER = 22
_footer = struct.Struct("<QQI").unpack_from
_FOOTER_SIZE = 29
"""Bytes of the footer record: prefix, start of the summary, start of its offsets, checksum."""
_chunk_header = struct.Struct("<QQQII").unpack_from


_NEEDED_OF_SUMMARY = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX)
_NEEDED = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)


class _ChunkPlace(NamedTuple):
    start: int
    channels: Collection[int]
    """Numbers of the channels with messages in the chunk; empty: unknown."""


class McapFile(ChunkedFile):
    """An `.mcap` file; implements `recording.RecordedFile`."""

    MAGIC = b"\x89MCAP0\r\n"
    EXPECTED = "an MCAP file, which starts with 89 4D 43 41 50"
    DAMAGE = (*ChunkedFile.DAMAGE, McapError)

    def __init__(self, path: str, name: str = "") -> None:
        """Reads the summary, or the whole file if there is none; see `ChunkedFile`."""
        self._schemas: Dict[int, Tuple[str, str, str]] = {}
        """Name, definition and its format per schema."""
        self._places: List[_ChunkPlace] = []
        super().__init__(path, name)

    def _read_index(self, file: BinaryIO) -> Optional[str]:
        """Reads channels, time span and the places of the chunks from the summary."""
        file.seek(-len(self.MAGIC), os.SEEK_END)
        if file.read() != self.MAGIC:
            return "has no summary (the recorder was stopped early)"
        try:
            if self._read_summary(file, *self._check_summary(file)):
                return None
            problem = ""  # summaries are optional
        except self.DAMAGE:
            problem = "its summary is damaged"
        self._channels.clear()
        self._places.clear()
        return problem

    def _read_summary(self, file: BinaryIO, start: int, end: int) -> bool:
        """Reads the summary record by record; returns whether it is complete."""
        statistics: Optional[Statistics] = None
        channels_of: Dict[FrozenSet[int], FrozenSet[int]] = {}
        numbers: Set[int] = set()
        file.seek(start)
        while start and file.tell() < end:
            opcode, length = _prefix(file.read(_PREFIX_SIZE))
            if opcode not in _NEEDED_OF_SUMMARY:
                file.seek(length, os.SEEK_CUR)
                continue
            if length > _LARGEST_INDEX_RECORD:
                raise Damaged(f"a record of {length} bytes, expected at most {_LARGEST_INDEX_RECORD}")
            stream = ReadDataStream(io.BytesIO(file.read(length)))
            if opcode == Opcode.SCHEMA:
                self._note_schema(Schema.read(stream))
            elif opcode == Opcode.CHANNEL:
                channel = McapChannel.read(stream)
                numbers.add(channel.id)
                self._note_channel(channel)
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(stream)
            else:
                index = ChunkIndex.read(stream)
                channels = frozenset(index.message_index_offsets)
                place = _ChunkPlace(index.chunk_start_offset, channels_of.setdefault(channels, channels))
                self._places.append(place)
        if statistics is None or statistics.channel_count != len(numbers):
            return False
        if statistics.chunk_count != len(self._places):
            return False
        self._counts = statistics.channel_message_counts
        if statistics.message_count:
            self.span_ns = statistics.message_start_time, statistics.message_end_time
        self._places.sort(key=lambda place: place.start)
        return True

    def _check_summary(self, file: BinaryIO) -> Tuple[int, int]:
        """Checks the optional checksum of the summary; returns its start (0: there is none) and its end.

        Raises:
            Damaged: it does not match.
        """
        end = file.seek(-_FOOTER_SIZE - len(self.MAGIC), os.SEEK_END)
        start, _, crc = _footer(file.read(_FOOTER_SIZE), 9)
        if start > end:
            raise Damaged("a summary beyond the end")
        if crc and start:
            file.seek(start)
            found, left = 0, end + _FOOTER_SIZE - 4 - start
            while left:
                block = file.read(min(left, _BLOCK))
                found, left = zlib.crc32(block, found), left - len(block)
            if found != crc:
                raise Damaged("the summary has a wrong checksum")
        return start, end

    def _chunks(self, file: BinaryIO, wanted: Optional[Mapping[int, Any]]) -> Iterator[List[RawMessage[Any]]]:
        if not self._places or wanted is None:
            yield from super()._chunks(file, wanted)
            return
        size = os.fstat(file.fileno()).st_size
        end = 0
        for place in self._places:
            if not place.channels or not wanted.keys().isdisjoint(place.channels):
                messages: List[RawMessage[Any]] = []
                try:
                    file.seek(place.start)
                    record = self._read_record(file, size)
                    if record is None or record.kind != Opcode.CHUNK or not record.complete or place.start < end:
                        raise Damaged("no chunk where the index has one")
                    end = file.tell()
                    self._take(record, wanted, messages, [])
                except self.DAMAGE as error:
                    self._leave_out(place.start, size, error)
                record = None  # its bytes are not needed while the messages are read
                yield messages

    def _read_record(self, file: BinaryIO, size: int) -> Optional[Record]:
        prefix = file.read(_PREFIX_SIZE)
        if len(prefix) < _PREFIX_SIZE:
            raise Damaged("the file ends within a record")
        opcode, length = _prefix(prefix)
        if opcode == Opcode.DATA_END:
            return None
        if not opcode:
            raise Damaged("a record of type 0")
        if opcode not in _NEEDED:
            complete = file.tell() + length <= size
            if complete:
                file.seek(length, os.SEEK_CUR)
            return Record(opcode, b"", complete)
        if length > LARGEST:
            raise Damaged(f"a record of {length} bytes, expected at most {LARGEST}")
        data = file.read(length)
        return Record(opcode, data, len(data) == length)

    def _take(
        self,
        record: Record,
        wanted: Optional[Mapping[int, Any]],
        chunk: List[RawMessage[Any]],
        loose: List[RawMessage[Any]],
    ) -> None:
        if record.kind == Opcode.CHUNK:
            self._take_chunk(record.data, wanted, chunk)
        elif record.complete and record.data:
            self._take_record(record.kind, record.data, 0, len(record.data), wanted, loose)

    def _take_chunk(self, record: bytes, wanted: Optional[Mapping[int, Any]], into: List[RawMessage[Any]]) -> None:
        chunk, expected_size, expected_crc = _unpacked(record)
        if expected_crc and len(chunk) == expected_size and zlib.crc32(chunk) != expected_crc:
            raise Damaged("a chunk with a wrong checksum")
        position, end = 0, len(chunk)
        while position < end:
            opcode, length = _prefix(chunk, position)
            start = position + _PREFIX_SIZE
            position = start + length
            if position > end:
                raise Damaged("a record goes beyond its chunk")
            if opcode == _OPCODE_OF_MESSAGE:
                number, _, time_ns = _message(chunk, start)
                if wanted is None:
                    self._add_message(into, time_ns, number, b"")
                elif number in wanted:
                    self._add_message(into, time_ns, wanted[number], chunk[start + _MESSAGE_HEADER : position])
            else:
                self._take_record(opcode, chunk, start, length, wanted, into)
        if end != expected_size:
            raise Damaged(f"a chunk unpacks to {end} bytes, expected {expected_size}")

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
                self._add_message(into, time_ns, number, b"")
            elif number in wanted:
                self._add_message(into, time_ns, wanted[number], data[start + _MESSAGE_HEADER :])
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and wanted is None:
            stream = ReadDataStream(io.BytesIO(data[start : start + length]))
            if opcode == Opcode.SCHEMA:
                self._note_schema(Schema.read(stream))
            else:
                self._note_channel(McapChannel.read(stream))

    def _note_schema(self, schema: Schema) -> None:
        form = _FORMATS.get(schema.encoding, "")
        self._schemas[schema.id] = schema.name, bytes(schema.data).decode("utf-8", "replace") if form else "", form

    def _note_channel(self, channel: McapChannel) -> None:
        schema = self._schemas.get(channel.schema_id)
        if schema is not None and channel.message_encoding in _ENCODINGS:  # else not a message of ROS
            type_name, text, form = schema
            self._add_channel(channel.id, channel.topic, type_name, channel.message_encoding, text, form)


def _unpacked(record: bytes) -> Tuple[bytes, int, int]:
    """Returns the content of a chunk as far as it can be unpacked, with its expected size and checksum."""
    _, _, size, crc, name_length = _chunk_header(record)
    position = 32 + name_length
    compression = record[32:position].decode("utf-8")
    data = record[position + 8 :]
    check_size(size, len(data))
    if compression == "zstd":
        data = _unpack_zstd(data, size)
    elif compression == "lz4":
        data = _unpack_lz4(data, size)
    elif compression:
        raise Damaged(f"compression {compression!r}, expected zstd or lz4")
    return data, size, crc


def _unpack_zstd(data: bytes, size: int) -> bytes:
    try:
        with zstandard.ZstdDecompressor(max_window_size=LARGEST).stream_reader(data) as stream:
            return bytes(stream.read(size + 1))
    except zstandard.ZstdError as error:
        raise Damaged(str(error)) from None


def _unpack_lz4(data: bytes, size: int) -> bytes:
    try:
        unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
    except RuntimeError as error:
        raise Damaged(str(error)) from None
    return unpacked
