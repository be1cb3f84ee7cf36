"""MCAP files, profiles ros1 and ros2, with or without an index.

The library mcap reads the summary, schemas and channels. Messages are cut out of chunks here, because the library makes
an object of each one, images included. Source of the format: mcap.dev/spec.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from operator import itemgetter
from typing import BinaryIO, Collection, Iterator

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment as McapAttachment
from mcap.records import AttachmentIndex, ChunkIndex, Schema, Statistics
from mcap.records import Channel as McapChannel
from mcap.stream_reader import StreamReader

from ..core.judge import STATE, THRESHOLDS
from ..core.messages import PROFILES, RawFormat
from .recording import LARGEST, ChunkedFile, Damaged, Messages, Record, Wanted, unpack

_FORMATS = ("ros1msg", "ros2msg", "ros2idl", "jsonschema")
_LARGEST_ATTACHMENT = 16 << 20
_OPCODE_OF_MESSAGE = int(Opcode.MESSAGE)
_PREFIX_SIZE = 9
_prefix = struct.Struct("<BQ").unpack_from
_message = struct.Struct("<HIQ").unpack_from
_MESSAGE_HEADER = 22
_footer = struct.Struct("<QQI").unpack_from
_FOOTER_SIZE = 29  # bytes of the footer record: prefix, start of the summary, start of its offsets, checksum
_chunk_header = struct.Struct("<QQQII").unpack_from
_CHUNK_HEADER = 32

_NEEDED = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)


class McapFile(ChunkedFile):
    """An `.mcap` file."""

    MAGIC = b"\x89MCAP0\r\n"
    EXPECTED = "an MCAP file, which starts with 89 4D 43 41 50"
    DAMAGE = (*ChunkedFile.DAMAGE, McapError)
    DAMAGED_INDEX = "its summary is damaged"

    def _read_index(self, file: BinaryIO) -> str | None:
        """Reads channels, time span and the places of the chunks from the summary, which is optional."""
        self._schemas: dict[int, tuple[str, str, str]] = {}  # name, format and definition per schema
        self._places: list[tuple[int, Collection[int]]] = []
        """Start of each chunk, and the numbers of the channels with messages in it; empty if they are not known."""
        file.seek(-len(self.MAGIC), os.SEEK_END)
        if file.read() != self.MAGIC:
            return "has no summary (the recorder was stopped early)"
        summary = self._read_summary(file)
        if summary is None:
            return ""
        statistics: Statistics | None = None
        places: list[tuple[int, Collection[int]]] = []
        numbers = set()
        channels_of: dict[frozenset[int], frozenset[int]] = {}
        for record in StreamReader(io.BytesIO(summary), skip_magic=True, emit_chunks=True).records:
            if isinstance(record, Schema):
                self._note_schema(record)
            elif isinstance(record, McapChannel):
                numbers.add(record.id)
                self._note_channel(record)
            elif isinstance(record, Statistics):
                statistics = record
            elif isinstance(record, ChunkIndex):
                channels = frozenset(record.message_index_offsets)
                places.append((record.chunk_start_offset, channels_of.setdefault(channels, channels)))
            elif isinstance(record, AttachmentIndex) and record.name in (THRESHOLDS, STATE):
                self._read_attachment(file, record)
        expected = statistics and (statistics.channel_count, statistics.chunk_count)
        if statistics is None or expected != (len(numbers), len(places)):
            return ""
        self._counts = statistics.channel_message_counts
        if statistics.message_count:
            self.span_ns = statistics.message_start_time, statistics.message_end_time
        self._places = sorted(places, key=itemgetter(0))
        return None

    def _read_summary(self, file: BinaryIO) -> bytes | None:
        """Reads the summary and what follows it; returns None if there is none, or a very large one."""
        end = file.seek(-_FOOTER_SIZE - len(self.MAGIC), os.SEEK_END)
        start, _, checksum = _footer(file.read(_FOOTER_SIZE), _PREFIX_SIZE)
        if start > end:
            raise Damaged("a summary beyond the end")
        if not start or end - start > LARGEST:  # as large as that of some 100 GB
            return None
        file.seek(start)
        summary = file.read()
        if checksum and zlib.crc32(memoryview(summary)[: -4 - len(self.MAGIC)]) != checksum:
            raise Damaged("the summary has a wrong checksum")
        return summary

    def _read_attachment(self, file: BinaryIO, index: AttachmentIndex) -> None:
        """Reads what a black box has attached; raises one of `DAMAGE`."""
        if not _PREFIX_SIZE < index.length <= _LARGEST_ATTACHMENT:
            raise Damaged(f"an attachment of {index.length} bytes")
        file.seek(index.offset + _PREFIX_SIZE)
        attachment = McapAttachment.read(ReadDataStream(io.BytesIO(file.read(index.length - _PREFIX_SIZE))))
        self.attachments[attachment.name] = attachment.data.decode("utf-8", "replace")

    def _chunks(self, file: BinaryIO, wanted: Wanted) -> Iterator[Messages]:
        if not self._places or wanted is None:
            yield from super()._chunks(file, wanted)
            return
        size = os.fstat(file.fileno()).st_size
        end = 0
        for start, channels in self._places:
            if not channels or not wanted.keys().isdisjoint(channels):
                messages: Messages = []
                try:
                    file.seek(start)
                    record = self._read_record(file, size)
                    if record is None or not record.is_chunk or not record.complete or start < end:
                        raise Damaged("no chunk where the index has one")
                    end = file.tell()
                    self._take(record, wanted, messages)
                except self.DAMAGE as error:
                    self._leave_out(start, size, error)
                record = None  # its bytes are not needed while the messages are read
                yield messages

    def _read_record(self, file: BinaryIO, size: int) -> Record | None:
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
            return Record(opcode, False, b"", complete)
        if length > LARGEST:
            raise Damaged(f"a record of {length} bytes, expected at most {LARGEST}")
        data = prefix + file.read(length)
        return Record(opcode, opcode == Opcode.CHUNK, data, len(data) == _PREFIX_SIZE + length)

    def _take(self, record: Record, wanted: Wanted, into: Messages) -> None:
        if record.is_chunk:
            _, _, size, checksum, name_length = _chunk_header(record.data, _PREFIX_SIZE)
            start = _PREFIX_SIZE + _CHUNK_HEADER + name_length
            compression = record.data[start - name_length : start].decode("utf-8")
            content = unpack(compression, record.data[start + 8 :], size)
            if checksum and len(content) == size and zlib.crc32(content) != checksum:
                raise Damaged("a chunk with a wrong checksum")
            self._take_records(content, wanted, into)
            if len(content) != size:
                raise Damaged(f"a chunk unpacks to {len(content)} bytes, expected {size}")
        elif record.complete:
            self._take_records(record.data, wanted, into)

    def _take_records(self, data: bytes, wanted: Wanted, into: Messages) -> None:
        """Takes messages from records; without `wanted` also schemas and channels."""
        position, end = 0, len(data)
        while position < end:
            opcode, length = _prefix(data, position)
            start = position + _PREFIX_SIZE
            position = start + length
            if position > end:
                raise Damaged("a record goes beyond its chunk")
            if opcode == _OPCODE_OF_MESSAGE:
                number, _, time_ns = _message(data, start)
                self._add_message(into, wanted, number, time_ns, data, start + _MESSAGE_HEADER, position)
            elif wanted is None and opcode == Opcode.SCHEMA:
                self._note_schema(Schema.read(ReadDataStream(io.BytesIO(data[start:position]))))
            elif wanted is None and opcode == Opcode.CHANNEL:
                self._note_channel(McapChannel.read(ReadDataStream(io.BytesIO(data[start:position]))))

    def _note_schema(self, schema: Schema) -> None:
        is_read = schema.encoding in _FORMATS
        text = bytes(schema.data).decode("utf-8", "replace") if is_read else ""
        self._schemas[schema.id] = schema.name, schema.encoding if is_read else "", text

    def _note_channel(self, channel: McapChannel) -> None:
        schema = self._schemas.get(channel.schema_id)
        encoding = channel.message_encoding
        if schema is not None and encoding in PROFILES:  # else not a message of ROS
            self._add_channel(channel.id, channel.topic, RawFormat(encoding, *schema))
