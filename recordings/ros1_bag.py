"""ROS 1 bags, format version 2.0, with or without an index.

A recorder that is killed leaves a bag without an index (`.bag.active`), which rosbags refuses to read. Source of the
format: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import os
import struct
from typing import BinaryIO, Counter, Dict

from ..core.messages import ros1_format
from .recording import LARGEST, ChunkedFile, Damaged, Messages, Record, Wanted, unpack

_MESSAGE, _BAG_HEADER, _CHUNK, _CHUNK_INFO, _CONNECTION = (bytes([op]) for op in (2, 3, 5, 6, 7))
_LARGEST_HEADER = 65_536  # bytes of a record's header; a definition's text is in the data of a connection
_MOST_HEADER_FIELDS = 100

_uint32 = struct.Struct("<I").unpack_from
_uint64 = struct.Struct("<Q").unpack_from
_time = struct.Struct("<II").unpack_from

_Fields = Dict[bytes, bytes]


class Ros1Bag(ChunkedFile):
    """A `.bag` file."""

    MAGIC = b"#ROSBAG V2.0\n"
    EXPECTED = "a ROS 1 bag, which starts with #ROSBAG V2.0"

    DAMAGED_INDEX = "has no index (the recorder was stopped early)"

    def _read_index(self, file: BinaryIO) -> None:
        """Reads the connections, and the times at which the first chunk begins and the last one ends."""
        size = os.fstat(file.fileno()).st_size
        record = self._read_record(file, size)
        if record is None or not record.complete or record.kind[b"op"] != _BAG_HEADER:
            raise Damaged("no header")
        start, connections = _uint64(record.kind[b"index_pos"])[0], _uint32(record.kind[b"conn_count"])[0]
        if not start:
            raise Damaged("no index")
        file.seek(start)
        times: list[int] = []
        counts: Counter[int] = Counter()
        for _ in range(connections + _uint32(record.kind[b"chunk_count"])[0]):
            entry = self._read_record(file, size)
            if entry is None or not entry.complete:
                raise Damaged("the index is not complete")
            fields = entry.kind
            if fields[b"op"] == _CONNECTION:
                self._note_connection(fields, entry.data)
            elif fields[b"op"] == _CHUNK_INFO and _uint32(fields[b"count"])[0]:
                times += map(_nanoseconds, (fields[b"start_time"], fields[b"end_time"]))
                for number, count in struct.iter_unpack("<II", entry.data):
                    if number not in self._channels:
                        raise Damaged("the index lacks a connection")
                    counts[number] += count
        if len(self._channels) != connections:
            raise Damaged("the index lacks a connection")
        self._counts = counts
        self.span_ns = (min(times), max(times)) if times else None

    def _read_record(self, file: BinaryIO, size: int) -> Record | None:
        if file.tell() == size:
            return None
        header, complete = _read_sized(file, _LARGEST_HEADER)
        if not complete:
            raise Damaged("the file ends within a record")
        fields = _fields(header)
        if len(fields.get(b"op", b"")) != 1:
            raise Damaged("a record without a type")
        return Record(fields, fields[b"op"] == _CHUNK, *_read_sized(file, LARGEST))

    def _take(self, record: Record, wanted: Wanted, into: Messages) -> None:
        if record.is_chunk:
            self._take_chunk(record, wanted, into)
        elif record.complete:
            # A recorder that was killed has not written the size of its last chunk: the messages follow as records.
            self._take_record(record.kind, record.data, 0, len(record.data), wanted, into)

    def _take_chunk(self, record: Record, wanted: Wanted, into: Messages) -> None:
        expected = _uint32(record.kind[b"size"])[0]
        chunk = unpack(record.kind[b"compression"].decode("ascii", "replace"), record.data, expected)
        position, end = 0, len(chunk)
        while position < end:
            header_start = position + 4
            data_start = header_start + _uint32(chunk, position)[0] + 4
            position = data_start + _uint32(chunk, data_start - 4)[0]
            if position > end:
                raise Damaged("a record goes beyond its chunk")
            fields = _fields(chunk[header_start : data_start - 4])
            self._take_record(fields, chunk, data_start, position, wanted, into)
        if end != expected:
            raise Damaged(f"a chunk unpacks to {end} bytes, expected {expected}")

    def _take_record(self, fields: _Fields, data: bytes, start: int, end: int, wanted: Wanted, into: Messages) -> None:
        if fields[b"op"] == _MESSAGE:
            number, time_ns = _uint32(fields[b"conn"])[0], _nanoseconds(fields[b"time"])
            self._add_message(into, wanted, number, time_ns, data, start, end)
        elif fields[b"op"] == _CONNECTION:
            self._note_connection(fields, data[start:end])

    def _note_connection(self, header: _Fields, data: bytes) -> None:
        number = _uint32(header[b"conn"])[0]
        if number not in self._channels:
            fields = _fields(data)
            type_name = fields[b"type"].decode("utf-8")
            definition = fields.get(b"message_definition", b"").decode("utf-8", "replace")
            topic = header[b"topic"].decode("utf-8")
            self._add_channel(number, topic, ros1_format(type_name, definition))


def _read_sized(file: BinaryIO, largest: int) -> tuple[bytes, bool]:
    """Returns a block that its length precedes, and whether it is complete."""
    length_bytes = file.read(4)
    if len(length_bytes) < 4:
        raise Damaged("the file ends within a record")
    length = _uint32(length_bytes)[0]
    if length > largest:
        raise Damaged(f"a record of {length} bytes, expected at most {largest}")
    data = file.read(length)
    return data, len(data) == length


def _fields(header: bytes) -> _Fields:
    fields: _Fields = {}
    position, end = 0, len(header)
    while position < end:
        start = position + 4
        position = start + _uint32(header, position)[0]
        if position > end:
            raise Damaged("a header field goes beyond its record")
        name, separator, value = header[start:position].partition(b"=")
        if not separator:
            raise Damaged("a header field without a name")
        fields[name] = value
        if len(fields) > _MOST_HEADER_FIELDS:
            raise Damaged(f"a header with more than {_MOST_HEADER_FIELDS} fields")
    return fields


def _nanoseconds(data: bytes) -> int:
    seconds, nanoseconds = _time(data)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
