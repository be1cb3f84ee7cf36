"""ROS 1 bags, format version 2.0: chunk after chunk, with or without an index.

A recorder that is killed leaves a bag without an index (`.bag.active`), which rosbags refuses to read. Reading the
chunks in their order needs no index, so one way serves intact and damaged bags, and memory does not grow with the
length of the bag. Source of the format: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import os
import struct
from typing import Any, BinaryIO, Dict, Iterator, List, Mapping, Optional, Tuple

from .recording import (
    Channel,
    RawMessage,
    RecordingError,
    Target,
    canonical_type,
    in_time_order,
    libraries,
    until,
)

_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG_HEADER, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
_OP_OF_MESSAGE = bytes([_MESSAGE])
_LARGEST_HEADER = 10_000_000
"""Bytes of a record's header; the header of a connection holds a definition's text."""
_LARGEST_CHUNK = 1 << 30
"""Bytes of a chunk, packed and unpacked. rosbag writes chunks of 0.75 MB unless one message is larger."""
_BATCH = 4096
"""Messages outside of chunks that are sorted together."""

_uint32 = struct.Struct("<I").unpack_from
_uint64 = struct.Struct("<Q").unpack_from
_time = struct.Struct("<II").unpack_from


class _Damaged(Exception):
    """A part of the file that cannot be read."""


_DAMAGE = (_Damaged, KeyError, ValueError, EOFError, OSError, struct.error, IndexError)
"""What reading damaged bytes raises."""


class Ros1Bag:
    """A `.bag` file; implements `recording.RecordedFile`."""

    def __init__(self, path: str, name: str = "") -> None:
        """Reads the index, or the whole file if there is none.

        Args:
            path: the file.
            name: path to show, if it differs.

        Raises:
            RecordingError: it cannot be opened or is no ROS 1 bag.
        """
        self.name = name or path
        self._path = path
        self.problem = ""
        self.span_ns: Optional[Tuple[int, int]] = None
        self._channels: Dict[int, Channel] = {}
        try:
            with open(path, "rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise RecordingError(f"{self.name}: expected a ROS 1 bag, which starts with #ROSBAG V2.0")
                if not self._read_index(file):
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

    def _read_index(self, file: BinaryIO) -> bool:
        """Reads connections and time span from the index at the end; returns False if it is missing or damaged."""
        try:
            header, _, _ = _read_record(file)
            if header.get(b"op") != bytes([_BAG_HEADER]):
                return False
            start = _uint64(header[b"index_pos"])[0]
            if not start or start >= os.fstat(file.fileno()).st_size:
                return False
            file.seek(start)
            times: List[int] = []
            count = _uint32(header[b"conn_count"])[0] + _uint32(header[b"chunk_count"])[0]
            for _ in range(count):
                record, data, complete = _read_record(file)
                if not complete:
                    return self._forget()
                if record[b"op"] == bytes([_CONNECTION]):
                    self._note_connection(record, data)
                elif record[b"op"] == bytes([_CHUNK_INFO]) and _uint32(record[b"count"])[0]:
                    times += (_nanoseconds(record[b"start_time"]), _nanoseconds(record[b"end_time"]))
        except _DAMAGE:
            return self._forget()
        self.span_ns = (min(times), max(times)) if times else None
        return True

    def _forget(self) -> bool:
        self._channels.clear()
        return False

    def _scan(self) -> None:
        """Finds connections and time span by reading the whole file."""
        first, last = None, 0
        for entries in self._chunks(None):
            for time_ns, _, _ in entries:
                first = time_ns if first is None else min(first, time_ns)
                last = max(last, time_ns)
        if not self.problem:
            self.problem = f"{self.name}: has no index (the recorder was stopped early): read to its end"
        self.span_ns = None if first is None else (first, last)

    def _chunks(self, wanted: Optional[Mapping[int, Any]]) -> Iterator[List[RawMessage[Any]]]:
        """Yields the messages of each chunk whose connection is in `wanted`; None: of all, without their data."""
        with open(self._path, "rb") as file:
            file.seek(len(_MAGIC))
            size = os.fstat(file.fileno()).st_size
            last_ns = 0
            # A recorder that was killed has not written the size of its last chunk: the messages follow as records.
            loose: List[RawMessage[Any]] = []
            while file.tell() < size:
                position = file.tell()
                entries: List[RawMessage[Any]] = []
                complete = False
                try:
                    header, data, complete = _read_record(file)
                    op = header[b"op"][0]
                    if op == _CHUNK:
                        self._read_chunk(header, data, wanted, entries)
                    elif op in (_MESSAGE, _CONNECTION) and complete:
                        self._take_record(header, data, wanted, loose)
                    if not complete:
                        raise _Damaged("the file ends within a record")
                except _DAMAGE as error:
                    problem = f"{self.name}: damaged at byte {position} of {size} ({error})"
                    if not complete:
                        self.problem = f"{problem}: read up to there"
                        self.span_ns = until(self.span_ns, _last_time(entries, _last_time(loose, last_ns)))
                        yield loose
                        yield entries
                        return
                    self.problem = self.problem or f"{problem}: a part of it is left out"
                last_ns = _last_time(entries, last_ns)
                if entries:
                    yield entries
                elif len(loose) >= _BATCH:
                    last_ns = _last_time(loose, last_ns)
                    yield loose
                    loose = []
            yield loose

    def _read_chunk(
        self,
        header: Dict[bytes, bytes],
        data: bytes,
        wanted: Optional[Mapping[int, Any]],
        into: List[RawMessage[Any]],
    ) -> None:
        chunk = _unpacked(header, data)
        position, end = 0, len(chunk)
        while position < end:
            header_start = position + 4
            data_start = header_start + _uint32(chunk, position)[0] + 4
            position = data_start + _uint32(chunk, data_start - 4)[0]
            if position > end:
                raise _Damaged("a record goes beyond its chunk")
            fields = _fields(chunk[header_start : data_start - 4])
            if fields[b"op"] == _OP_OF_MESSAGE and wanted is not None and _uint32(fields[b"conn"])[0] not in wanted:
                continue  # no copy of an image
            self._take_record(fields, chunk[data_start:position], wanted, into)
        if end != _uint32(header[b"size"])[0]:
            raise _Damaged(f"a chunk unpacks to {end} bytes, expected {_uint32(header[b'size'])[0]}")

    def _take_record(
        self,
        header: Dict[bytes, bytes],
        data: bytes,
        wanted: Optional[Mapping[int, Any]],
        into: List[RawMessage[Any]],
    ) -> None:
        op = header[b"op"][0]
        if op == _MESSAGE:
            number = _uint32(header[b"conn"])[0]
            if wanted is None:
                into.append((_nanoseconds(header[b"time"]), number, b""))
            elif number in wanted:
                into.append((_nanoseconds(header[b"time"]), wanted[number], data))
        elif op == _CONNECTION:
            self._note_connection(header, data)

    def _note_connection(self, header: Dict[bytes, bytes], data: bytes) -> None:
        number = _uint32(header[b"conn"])[0]
        if number not in self._channels:
            fields = _fields(data)
            type_name = fields[b"type"].decode("utf-8")
            definition = fields.get(b"message_definition", b"").decode("utf-8", "replace")
            topic = "/" + header[b"topic"].decode("utf-8").strip("/")
            self._channels[number] = Channel(
                topic, canonical_type(type_name), "ros1", definition, "msg" if definition else ""
            )


def _read_record(file: BinaryIO) -> Tuple[Dict[bytes, bytes], bytes, bool]:
    """Returns header and data of the next record, and whether the data is complete."""
    header, complete = _read_sized(file, _LARGEST_HEADER)
    if not complete:
        raise _Damaged("the file ends within a record")
    fields = _fields(header)
    if len(fields.get(b"op", b"")) != 1:
        raise _Damaged("a record without a type")
    return (fields, *_read_sized(file, _LARGEST_CHUNK))


def _read_sized(file: BinaryIO, largest: int) -> Tuple[bytes, bool]:
    length_bytes = file.read(4)
    if len(length_bytes) < 4:
        raise _Damaged("the file ends within a record")
    length = _uint32(length_bytes)[0]
    if length > largest:
        raise _Damaged(f"a record of {length} bytes, expected at most {largest}")
    data = file.read(length)
    return data, len(data) == length


def _last_time(entries: List[RawMessage[Any]], last_ns: int) -> int:
    return max(last_ns, entries[-1][0]) if entries else last_ns


def _fields(header: bytes) -> Dict[bytes, bytes]:
    fields: Dict[bytes, bytes] = {}
    position, end = 0, len(header)
    while position < end:
        start = position + 4
        position = start + _uint32(header, position)[0]
        if position > end:
            raise _Damaged("a header field goes beyond its record")
        name, separator, value = header[start:position].partition(b"=")
        if not separator:
            raise _Damaged("a header field without a name")
        fields[name] = value
    return fields


def _unpacked(header: Dict[bytes, bytes], data: bytes) -> bytes:
    """Returns a chunk as far as it can be unpacked."""
    compression = header[b"compression"]
    size = _uint32(header[b"size"])[0]
    if size > _LARGEST_CHUNK:
        raise _Damaged(f"a chunk of {size} bytes, expected at most {_LARGEST_CHUNK}")
    if compression == b"none":
        return data
    if compression == b"bz2":
        return bz2.BZ2Decompressor().decompress(data, size)
    if compression == b"lz4":
        return _unpack_lz4(data, size)
    raise _Damaged(f"compression {compression.decode('ascii', 'replace')!r}, expected none, bz2 or lz4")


def _unpack_lz4(data: bytes, size: int) -> bytes:
    with libraries():
        import lz4.frame  # only bags that are packed with it need it

    try:
        unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, size)
    except RuntimeError as error:
        raise _Damaged(str(error)) from None
    return unpacked


def _nanoseconds(data: bytes) -> int:
    seconds, nanoseconds = _time(data)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
