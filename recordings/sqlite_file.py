"""rosbag2's sqlite3 files (`.db3`), every schema version, read with Python's own sqlite3."""

from __future__ import annotations

import itertools
import os
import sqlite3
import struct
from pathlib import Path
from typing import Any, BinaryIO, Iterator, Mapping

from ..core.messages import RawFormat
from .recording import LARGEST, Damaged, Messages, RawMessage, RecordedFile, RecordingError, in_time_order

_FORMATS = ("ros2msg", "ros2idl")
_BATCH = 1024
_BATCH_BYTES = 4_000_000  # messages that are read together: at most so many, and about so many bytes

_MOST_TOPICS = 10_000
_LONGEST_TEXT = 2_000_000  # bytes of a definition
_STEPS = 10_000  # steps of SQLite's virtual machine between two looks at how many are left
_STEPS_PER_BYTE, _LEAST_STEPS = 10, 1_000_000
"""Reading a row takes about 25 steps, and a row takes about 20 bytes. A page that is its own child has no end."""

_header = struct.Struct(">16sH6xII60xI").unpack_from
"""Of the file: magic, bytes per page (1: 65536), change counter, pages, change counter when `pages` was written."""
_DAMAGE = (sqlite3.Error, ValueError, OverflowError, Damaged)  # what reading a damaged file raises


class SqliteFile(RecordedFile):
    """A `.db3` file."""

    MAGIC = b"SQLite format 3\0"
    EXPECTED = "an SQLite file"

    def _open(self, file: BinaryIO) -> None:
        file.seek(0)
        self._missing = self._missing_bytes(file.read(100).ljust(100, b"\0"))
        database = self._connect()
        try:
            _check_tables(database)
            self._read_channels(database)
            try:
                if self._missing:
                    raise ValueError
                first, last = database.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
                self.span_ns = None if first is None else (int(first), int(last))
            except (*_DAMAGE, TypeError):
                self.span_ns = self._span_of(self._batches(database, self._channels))
        except _DAMAGE as error:
            problem = f"cannot be read as a recording of rosbag2: {error}"
            if self._missing:
                problem = f"{self.problem[len(self.name) + 2 :]}, but nothing can be read"
            raise RecordingError(problem, file=self.name) from None
        finally:
            database.close()

    def _messages(self, wanted: Mapping[int, Any]) -> Iterator[RawMessage[Any]]:
        database = self._connect()
        try:
            yield from in_time_order(self._batches(database, wanted))
        finally:
            database.close()

    def _batches(self, database: sqlite3.Connection, wanted: Mapping[int, Any]) -> Iterator[Messages]:
        """Yields messages in the order of recording, which needs no index: that may be damaged."""
        places = ",".join("?" * len(wanted))
        # Other topics are included, without data: their rows show where a file ends that was cut off.
        data_column = f"CASE WHEN length(data) <= {LARGEST} THEN data END"
        selected = f"CASE WHEN topic_id IN ({places}) THEN {data_column} WHEN topic_id > 0 THEN x'' END"
        query = f"SELECT topic_id, timestamp, {selected} FROM messages NOT INDEXED ORDER BY id"
        batch: Messages = []
        size, left, last_ns = 0, os.path.getsize(self._path), 0
        problem = self.problem if self._missing else ""
        try:
            for number, time_ns, data in database.execute(query, list(wanted)):
                if type(time_ns) is not int or type(data) is not bytes or (self._missing and self._is_cut(data)):
                    self.has_holes = True
                    if self._missing:
                        break  # the rest of the page is missing, too
                    self.problem = self.problem or f"{self.name}: a row without a time or data is left out"
                elif number in wanted:
                    size += len(data)
                    batch.append((time_ns, wanted[number], data))
                    if len(batch) == _BATCH or size > _BATCH_BYTES:
                        left -= size
                        if left < 0:
                            raise Damaged("it has more data than bytes")
                        last_ns = max(last_ns, time_ns)
                        yield batch
                        batch, size = [], 0
        except _DAMAGE as error:
            problem = problem or f"{self.name}: damaged ({error}): read as far as possible"
        if problem:
            self.has_holes, self.problem = True, problem
            self._end_span(max(last_ns, batch[-1][0]) if batch else last_ns)
        yield batch

    def _is_cut(self, data: bytes) -> bool:
        """Returns whether data may go beyond the end of the file: SQLite fills its last page with zeros."""
        return bool(data) and data.endswith(bytes(min(self._missing, len(data))))

    def _missing_bytes(self, header: bytes) -> int:
        """Returns how many bytes its last page lacks if the file is shorter than its header says, which is a problem.

        At least 1 then.
        """
        _, page_size, changes, pages, changes_of_pages = _header(header)
        page_size = 65536 if page_size == 1 else page_size
        expected = page_size * pages
        size = os.path.getsize(self._path)
        if size >= expected or changes != changes_of_pages or _has_journal(self._path):
            return 0
        self.problem = f"{self.name}: ends at byte {size} of {expected}: read as far as possible"
        return int(page_size - size % page_size)

    def _connect(self) -> sqlite3.Connection:
        # A recording is never written here. `immutable` reads it where no journal can be written; a journal that a
        # crashed recorder left behind must be applied, which needs the ordinary mode.
        mode = "mode=ro" if _has_journal(self._path) else "mode=ro&immutable=1"
        steps = itertools.repeat(False, (_LEAST_STEPS + _STEPS_PER_BYTE * os.path.getsize(self._path)) // _STEPS)
        try:
            database = sqlite3.connect(f"{Path(os.path.abspath(self._path)).as_uri()}?{mode}", uri=True)
            database.set_progress_handler(lambda: next(steps, True), _STEPS)
            database.execute("PRAGMA writable_schema=ON")  # otherwise SQLite refuses a file that was cut off
            return database
        except sqlite3.Error as error:
            raise RecordingError(f"cannot be opened: {error}", file=self.name) from None

    def _read_channels(self, database: sqlite3.Connection) -> None:
        definitions: dict[str, tuple[str, str]] = {}
        if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
            query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            for type_name, encoding, text in database.execute(f"{query} LIMIT {_MOST_TOPICS}"):
                if encoding in _FORMATS and text and len(text) <= _LONGEST_TEXT:
                    definitions[str(type_name)] = str(text), encoding
        query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        for number, topic, type_name, encoding in database.execute(f"{query} LIMIT {_MOST_TOPICS}"):
            if encoding == "cdr":
                text, form = definitions.get(str(type_name), ("", ""))
                self._add_channel(number, str(topic), RawFormat("cdr", str(type_name), form, text))


def _has_journal(path: str) -> bool:
    journals = [path + ending for ending in ("-wal", "-journal") if os.path.exists(path + ending)]
    for journal in journals:
        if not os.path.isfile(journal):
            raise RecordingError("is not a file", file=journal)
    return bool(journals)


def _check_tables(database: sqlite3.Connection) -> None:
    """Raises ValueError unless all that is read is stored: a view or a generated column may be endless."""
    query = "SELECT name, type, rootpage FROM sqlite_master WHERE name IN ('messages', 'topics', 'message_definitions')"
    for name, kind, page in database.execute(query).fetchmany(10):
        hidden = [column[6] for column in database.execute(f"PRAGMA table_xinfo({name})").fetchmany(1000)]
        if kind != "table" or not page or any(hidden):
            raise ValueError(f"{name} is not an ordinary table")
