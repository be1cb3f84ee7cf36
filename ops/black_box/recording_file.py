"""One MCAP file, written by the library mcap; and the completion of files that a killed process left."""

from __future__ import annotations

import os
from typing import IO, Any, Mapping, Sequence

from ...core.messages import RawFormat
from ...core.values import package_version
from .ring import Message

PART = ".part"
"""Ending of the name of a file that is not complete."""
MAGIC = b"\x89MCAP0\r\n"
"""How a file begins and ends."""
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
            self._writer.add_message(number, time_ns, data, time_ns)
            self.messages += 1
        self._stream.flush()

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Completes the file and gives it its name."""
        self._writer.add_metadata("robot-health", dict(metadata))
        self._writer.finish()
        _name(self._stream, self._path)

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


def complete(path: str) -> bool:
    """Ends a file that a killed process left after its last whole record; returns whether it had a message.

    Else it is removed. It gets an index of its attachments, but none of its messages: readers then read it from its
    beginning. Nothing is unpacked. May raise OSError.
    """
    from mcap.data_stream import RecordBuilder
    from mcap.records import Attachment, AttachmentIndex, Chunk, DataEnd, Footer
    from mcap.stream_reader import StreamReader

    end, has_messages = len(MAGIC), False
    builder: Any = RecordBuilder
    index, tail = builder(), builder()
    with open(path + PART, "r+b") as stream:
        try:
            for record in StreamReader(stream, emit_chunks=True).records:
                if isinstance(record, DataEnd):
                    break
                place, end = end, stream.tell()
                has_messages = has_messages or isinstance(record, Chunk)
                if isinstance(record, Attachment):
                    times, size = (record.log_time, record.create_time), len(record.data)
                    AttachmentIndex(place, end - place, *times, size, record.name, record.media_type).write(index)
        except OSError:
            raise
        except Exception:  # whatever damaged bytes make the library raise
            pass
        if not has_messages:
            os.unlink(path + PART)
            return False
        DataEnd(0).write(tail)
        summary = end + tail.count if index.count else 0
        tail.write(index.end())
        Footer(summary, 0, 0).write(tail)
        stream.seek(end)
        stream.truncate()
        stream.write(tail.end() + MAGIC)
        _name(stream, path)
    return True


def _name(stream: IO[bytes], path: str) -> None:
    """Gives a file its name when its content is on the disk."""
    stream.flush()
    os.fsync(stream.fileno())
    stream.close()
    os.replace(path + PART, path)
