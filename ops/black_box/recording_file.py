"""One MCAP file, written by the library mcap; and the completion of files that a killed process left."""

from __future__ import annotations

import contextlib
import os
import struct
from typing import IO, Any, Iterable, Iterator, Mapping, Sequence

from ...core.messages.raw_messages import RawFormat
from ...core.values import package_version
from .ring import Message

PART = ".part"
"""Ending of the name of a file that is not complete."""
COMPLETED = ".completed"
"""Comes before it while a file that a killed process left is completed."""
LIBRARY = "robot-health "
"""How the name of the program in a file's header begins."""

_CHUNK_BYTES = 256 << 10  # what a kill loses at most, apart from what waits in memory
_MEDIA_TYPES = {".yaml": "application/yaml", ".json": "application/json"}


class RecordingFile:
    """An MCAP file that is being written, under a temporary name. All methods may raise OSError."""

    def __init__(self, path: str, profile: str, begin_ns: int, attachments: Mapping[str, str]) -> None:
        """Creates the file. It begins at a time, in ns since 1970, which is also that of the attachments."""
        from mcap.writer import Writer  # only those who have a black box need it

        self._path = path
        self._stream: IO[bytes] = open(path + PART, "xb")
        self._channels: dict[tuple[str, RawFormat], int] = {}
        self._schemas: dict[RawFormat, int] = {}
        self._counts: dict[int, int] = {}
        self.messages = 0
        """Number of messages that were written."""
        try:
            self._writer: Any = Writer(self._stream, chunk_size=_CHUNK_BYTES)
            self._writer.start(profile, f"{LIBRARY}{package_version()}")
            for name, text in attachments.items():
                media_type = _MEDIA_TYPES[os.path.splitext(name)[1]]
                self._writer.add_attachment(begin_ns, begin_ns, name, media_type, text.encode("utf-8"))
            self._stream.flush()
        except BaseException:
            self.discard()
            raise

    @property
    def bytes(self) -> int:
        """Its size until now."""
        return self._stream.tell()

    def write(self, messages: Sequence[Message], offset_s: float) -> None:
        """Writes messages; with `offset_s` added, their times are seconds since 1970."""
        for time_s, topic, raw_format, data in messages:
            number = self._channels.get((topic, raw_format)) or self._register(topic, raw_format)
            time_ns = max(0, round((time_s + offset_s) * 1e9))
            self._counts[number] = sequence = self._counts.get(number, 0) + 1
            self._writer.add_message(number, time_ns, data, time_ns, sequence & 0xFFFFFFFF)
            self.messages += 1
        self._stream.flush()

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Completes the file and gives it its name."""
        self._writer.add_metadata("robot-health", dict(metadata))
        _complete(self._writer, self._stream, self._path)

    def discard(self) -> None:
        """Removes the file; never raises."""
        for action in (self._stream.close, lambda: os.unlink(self._path + PART)):
            try:
                action()
            except OSError:
                pass

    def _register(self, topic: str, raw_format: RawFormat) -> int:
        if raw_format not in self._schemas:
            schema = raw_format.schema.encode("utf-8")
            self._schemas[raw_format] = self._writer.register_schema(
                raw_format.schema_name, raw_format.schema_encoding, schema
            )
        number: int = self._writer.register_channel(topic, raw_format.message_encoding, self._schemas[raw_format])
        self._channels[topic, raw_format] = number
        return number


def complete(path: str, most_bytes: int) -> bool:
    """Completes a file that a killed process left; returns whether it had a message. Else it is removed.

    What was written up to the last complete chunk is kept, or up to one that unpacks to more than `most_bytes`. May
    raise OSError.
    """
    from mcap.writer import Writer

    target = path + COMPLETED + PART
    try:
        with open(path + PART, "rb") as source, open(target, "wb") as stream:
            writer = Writer(stream, chunk_size=_CHUNK_BYTES)
            if _copy(_records(source, most_bytes), writer):
                _complete(writer, stream, path, target)
            else:
                os.unlink(target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            os.unlink(target)
        if not isinstance(error, (ValueError, struct.error)):  # these: a number in the file is out of range
            raise
    os.unlink(path + PART)
    return os.path.exists(path)


def _records(source: IO[bytes], most_bytes: int) -> Iterator[Any]:
    """Yields the records of a file as far as they can be read."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    try:
        for record in StreamReader(source, emit_chunks=True).records:
            if not isinstance(record, Chunk):
                yield record
            elif record.compression in ("", "zstd") and record.uncompressed_size <= most_bytes + _CHUNK_BYTES:
                yield from breakup_chunk(_unpacked(record))
            else:
                return  # no black box writes such a chunk
    except OSError:
        raise
    except Exception:  # whatever damaged bytes make the libraries raise
        return


def _unpacked(chunk: Any) -> Any:
    """Unpacks a chunk to the size that it has by its header, whatever its content says."""
    import zstandard

    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as stream:
            chunk.data, chunk.compression = stream.read(chunk.uncompressed_size), ""
    return chunk


def _copy(records: Iterable[Any], writer: Any) -> int:
    """Copies messages with their schemas, channels and attachments; returns how many messages there were."""
    from mcap import records as kinds

    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    number = 0
    for record in records:
        if isinstance(record, kinds.Header):
            writer.start(record.profile, record.library)
        elif isinstance(record, kinds.Attachment):
            writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
        elif isinstance(record, kinds.Schema):
            if record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, kinds.Channel):
            if record.id not in channels and record.schema_id in schemas:
                schema = schemas[record.schema_id]
                channels[record.id] = writer.register_channel(record.topic, record.message_encoding, schema)
        elif isinstance(record, kinds.Message) and record.channel_id in channels:
            channel = channels[record.channel_id]
            writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
            number += 1
    return number


def _complete(writer: Any, stream: IO[bytes], path: str, part: str = "") -> None:
    writer.finish()
    stream.flush()
    os.fsync(stream.fileno())
    stream.close()
    os.replace(part or path + PART, path)
