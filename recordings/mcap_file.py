"""MCAP files, profiles ros1 and ros2: chunk after chunk, with or without an index, also when the file ends early.

The library mcap reads the summary, the schemas and the channels. The messages inside a chunk are cut out here: the
library makes an object of every one, images included. Source of the format: mcap.dev/spec.
"""

from __future__ import annotations

import io
import os
import struct
from typing import BinaryIO, Collection, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel as McapChannel
from mcap.records import Schema

from .recording import Channel, Entry, RawMessage, RecordingError, Target, canonical_type, in_time_order

_MAGIC = b"\x89MCAP0\r\n"
_ENCODINGS = ("ros1", "cdr")
_FORMATS = {"ros1msg": "msg", "ros2msg": "msg", "ros2idl": "idl"}
_LARGEST_RECORD = 1 << 30
"""Bytes of a record, packed and unpacked; recorders write chunks of about 1 MB unless one message is larger."""
_BATCH = 4096
"""Messages outside of chunks that are put into the order of their times together."""

_prefix = struct.Struct("<BQ").unpack_from
_message = struct.Struct("<HIQ").unpack_from
_MESSAGE_HEADER = 22
_chunk_header = struct.Struct("<QQQII").unpack_from


class _Damaged(Exception):
    """The file cannot be read beyond this point."""


class _ChunkPlace(NamedTuple):
    start: int
    channels: Collection[int]
    """Numbers of the channels with messages in the chunk; empty: unknown."""


class McapFile:
    """An `.mcap` file; implements `recording.RecordedFile`."""

    def __init__(self, path: str) -> None:
        """Reads the summary, or the whole file if there is none.

        Args:
            path: the file.

        Raises:
            RecordingError: it cannot be opened or is no MCAP file.
        """
        self.name = path
        self.problem = ""
        self.span_ns: Optional[Tuple[int, int]] = None
        self._schemas: Dict[int, Schema] = {}
        self._channels: Dict[int, Channel] = {}
        self._places: List[_ChunkPlace] = []
        try:
            with open(path, "rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise RecordingError(f"{path}: expected an MCAP file, which starts with 89 4D 43 41 50")
                if not self._read_summary(file):
                    self._scan()
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None

    @property
    def channels(self) -> List[Channel]:
        """The channels, each once, in the order of the file."""
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels; see `recording.RecordedFile`."""
        wanted = {number: targets[channel] for number, channel in self._channels.items() if channel in targets}
        for time_ns, number, data in in_time_order(self._chunks(wanted)):
            yield time_ns, wanted[number], data

    def _read_summary(self, file: BinaryIO) -> bool:
        """Reads channels, time span and the places of the chunks; returns False if they are missing or damaged."""
        file.seek(-len(_MAGIC), os.SEEK_END)
        if file.read() != _MAGIC:
            return False
        file.seek(0)
        try:
            summary = make_reader(file).get_summary()
        except (McapError, ValueError, KeyError, OverflowError, MemoryError, struct.error, OSError):
            return False
        if summary is None or summary.statistics is None or not summary.channels:
            return False
        if summary.statistics.chunk_count != len(summary.chunk_indexes):
            return False
        self._schemas.update(summary.schemas)
        for channel in summary.channels.values():
            self._note_channel(channel)
        if summary.statistics.message_count:
            self.span_ns = summary.statistics.message_start_time, summary.statistics.message_end_time
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
        if not self.problem:
            self.problem = f"{self.name}: has no summary (the recorder was stopped early): read to its end"
        self.span_ns = None if first is None else (first, last)

    def _chunks(self, wanted: Optional[Collection[int]]) -> Iterator[List[Entry]]:
        """Yields the messages of each chunk whose channel is in `wanted`; None: of all, without their data."""
        with open(self.name, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            position = len(_MAGIC)
            try:
                if self._places and wanted is not None:
                    for place in self._places:
                        if not place.channels or any(number in wanted for number in place.channels):
                            position = place.start
                            file.seek(position)
                            opcode, length = _read_prefix(file)
                            if opcode != Opcode.CHUNK:
                                raise _Damaged("the index names a chunk where there is none")
                            yield self._read_records(_unpacked(_read(file, length)), wanted)
                    return
                file.seek(position)
                loose: List[Entry] = []
                while position < size:
                    opcode, length = _read_prefix(file)
                    if opcode == Opcode.DATA_END:
                        break
                    if opcode == Opcode.CHUNK:
                        yield self._read_records(_unpacked(_read(file, length)), wanted)
                    elif opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                        self._take_record(opcode, _read(file, length), 0, length, wanted, loose)
                        if len(loose) >= _BATCH:
                            yield loose
                            loose = []
                    elif length > size - file.tell():
                        raise _Damaged("the file ends within a record")
                    else:
                        file.seek(length, os.SEEK_CUR)
                    position = file.tell()
                else:
                    raise _Damaged("the file ends without its last record")
                yield loose
            except (_Damaged, McapError, ValueError, EOFError, OSError, struct.error, IndexError) as error:
                self.problem = f"{self.name}: damaged at byte {position} of {size} ({error}): read up to there"
                yield from ([loose] if not self._places and loose else [])

    def _read_records(self, chunk: bytes, wanted: Optional[Collection[int]]) -> List[Entry]:
        entries: List[Entry] = []
        position, end = 0, len(chunk)
        while position < end:
            opcode, length = _prefix(chunk, position)
            start = position + 9
            position = start + length
            if position > end:
                raise _Damaged("a record goes beyond its chunk")
            if opcode == Opcode.MESSAGE:
                number, _, time_ns = _message(chunk, start)
                if wanted is None:
                    entries.append((time_ns, number, b""))
                elif number in wanted:
                    entries.append((time_ns, number, chunk[start + _MESSAGE_HEADER : position]))
            else:
                self._take_record(opcode, chunk, start, length, wanted, entries)
        return entries

    def _take_record(
        self, opcode: int, data: bytes, start: int, length: int, wanted: Optional[Collection[int]], into: List[Entry]
    ) -> None:
        if opcode == Opcode.MESSAGE:
            number, _, time_ns = _message(data, start)
            if wanted is None or number in wanted:
                into.append((time_ns, number, b"" if wanted is None else data[start + _MESSAGE_HEADER :]))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and not self.span_ns:
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


def _read(file: BinaryIO, length: int) -> bytes:
    if length > _LARGEST_RECORD:
        raise _Damaged(f"a record of {length} bytes, expected at most {_LARGEST_RECORD}")
    data = file.read(length)
    if len(data) < length:
        raise _Damaged("the file ends within a record")
    return data


def _unpacked(record: bytes) -> bytes:
    _, _, size, _, name_length = _chunk_header(record)
    position = 32 + name_length
    compression = record[32:position].decode("utf-8")
    data = record[position + 8 :]
    if size > _LARGEST_RECORD:
        raise _Damaged(f"a chunk of {size} bytes, expected at most {_LARGEST_RECORD}")
    if compression == "":
        return data
    if compression == "zstd":
        unpacked = _unpack_zstd(data, size)
    elif compression == "lz4":
        unpacked = _unpack_lz4(data, size)
    else:
        raise _Damaged(f"compression {compression!r}, expected zstd or lz4")
    if len(unpacked) != size:
        raise _Damaged(f"a chunk unpacks to {len(unpacked)} bytes, expected {size}")
    return unpacked


def _unpack_zstd(data: bytes, size: int) -> bytes:
    import zstandard  # only files that are packed with it need it

    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            return bytes(stream.read(size + 1))
    except zstandard.ZstdError as error:
        raise _Damaged(str(error)) from None


def _unpack_lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # likewise

    try:
        unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
    except RuntimeError as error:
        raise _Damaged(str(error)) from None
    return unpacked
