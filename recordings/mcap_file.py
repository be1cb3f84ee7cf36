"""MCAP files, profiles ros1 and ros2, with or without an index.

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

from .chunked_file import ChunkedFile, Damaged, Record
from .recording import Channel, RawMessage, canonical_type

_ENCODINGS = ("ros1", "cdr")
_FORMATS = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}
_LARGEST_RECORD = 1 << 30
"""Bytes of a record, packed and unpacked; recorders write chunks of about 1 MB unless one message is larger."""

_OPCODE_OF_MESSAGE = int(Opcode.MESSAGE)
_prefix = struct.Struct("<BQ").unpack_from
_message = struct.Struct("<HIQ").unpack_from
_MESSAGE_HEADER = 22
_footer = struct.Struct("<QQI").unpack_from
_FOOTER_SIZE = 29
"""Bytes of the footer record: prefix, start of the summary, start of its offsets, checksum."""
_chunk_header = struct.Struct("<QQQII").unpack_from


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
        self._schemas: Dict[int, Schema] = {}
        self._places: List[_ChunkPlace] = []
        super().__init__(path, name)

    def _read_index(self, file: BinaryIO) -> Optional[str]:
        """Reads channels, time span and the places of the chunks from the summary."""
        file.seek(-len(self.MAGIC), os.SEEK_END)
        if file.read() != self.MAGIC:
            return "has no summary (the recorder was stopped early)"
        try:
            self._check_summary(file)
            file.seek(0)
            summary = make_reader(file).get_summary()
        except MemoryError:
            return "its summary is damaged"
        except self.DAMAGE:
            return "its summary is damaged"
        statistics = summary and summary.statistics
        if not summary or not statistics or len(summary.channels) != statistics.channel_count:
            return ""  # summaries are optional
        if statistics.chunk_count != len(summary.chunk_indexes):
            return ""
        self._schemas.update(summary.schemas)
        for channel in summary.channels.values():
            self._note_channel(channel)
        self._counts = statistics.channel_message_counts
        if statistics.message_count:
            self.span_ns = statistics.message_start_time, statistics.message_end_time
        self._places = [
            _ChunkPlace(index.chunk_start_offset, index.message_index_offsets.keys())
            for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
        ]
        return None

    def _check_summary(self, file: BinaryIO) -> None:
        """Checks the optional checksum of the summary, which the library ignores.

        Raises:
            Damaged: it does not match.
        """
        size = file.seek(-_FOOTER_SIZE - len(self.MAGIC), os.SEEK_END)
        start, _, crc = _footer(file.read(_FOOTER_SIZE), 9)
        if crc and 0 < start <= size and size - start <= _LARGEST_RECORD:
            file.seek(start)
            if zlib.crc32(file.read(size + _FOOTER_SIZE - 4 - start)) != crc:
                raise Damaged("the summary has a wrong checksum")

    def _chunks(self, file: BinaryIO, wanted: Optional[Mapping[int, Any]]) -> Iterator[List[RawMessage[Any]]]:
        if not self._places or wanted is None:
            yield from super()._chunks(file, wanted)
            return
        size = os.fstat(file.fileno()).st_size
        for place in self._places:
            if not place.channels or not wanted.keys().isdisjoint(place.channels):
                messages: List[RawMessage[Any]] = []
                try:
                    file.seek(place.start)
                    record = self._read_record(file, size)
                    if record is None or record.kind != Opcode.CHUNK or not record.complete:
                        raise Damaged("no chunk where the index has one")
                    self._take(record, wanted, messages, [])
                except self.DAMAGE as error:
                    self._leave_out(place.start, size, error)
                yield messages

    def _read_record(self, file: BinaryIO, size: int) -> Optional[Record]:
        prefix = file.read(9)
        if len(prefix) < 9:
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
        if length > _LARGEST_RECORD:
            raise Damaged(f"a record of {length} bytes, expected at most {_LARGEST_RECORD}")
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
            start = position + 9
            position = start + length
            if position > end:
                raise Damaged("a record goes beyond its chunk")
            if opcode == _OPCODE_OF_MESSAGE:
                number, _, time_ns = _message(chunk, start)
                if wanted is None:
                    into.append((time_ns, number, b""))
                elif number in wanted:
                    into.append((time_ns, wanted[number], chunk[start + _MESSAGE_HEADER : position]))
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


def _unpacked(record: bytes) -> Tuple[bytes, int, int]:
    """Returns the content of a chunk as far as it can be unpacked, with its expected size and checksum."""
    _, _, size, crc, name_length = _chunk_header(record)
    position = 32 + name_length
    compression = record[32:position].decode("utf-8")
    data = record[position + 8 :]
    if size > _LARGEST_RECORD:
        raise Damaged(f"a chunk of {size} bytes, expected at most {_LARGEST_RECORD}")
    if compression == "zstd":
        data = _unpack_zstd(data, size)
    elif compression == "lz4":
        data = _unpack_lz4(data, size)
    elif compression:
        raise Damaged(f"compression {compression!r}, expected zstd or lz4")
    return data, size, crc


def _unpack_zstd(data: bytes, size: int) -> bytes:
    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            return bytes(stream.read(size + 1))
    except zstandard.ZstdError as error:
        raise Damaged(str(error)) from None


def _unpack_lz4(data: bytes, size: int) -> bytes:
    try:
        unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
    except RuntimeError as error:
        raise Damaged(str(error)) from None
    return unpacked
