"""rosbag2's sqlite3 files (`.db3`), every schema version, read with Python's own sqlite3."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from .recording import Channel, RawMessage, RecordingError, Target, canonical_type, in_time_order, until

_FORMATS = {"ros2msg": "msg", "ros2idl": "idl"}
_MAGIC = b"SQLite format 3\0"
_BATCH = 1024
_BATCH_BYTES = 4_000_000
"""Messages that are read together: at most so many, and about so many bytes."""

_Columns = Tuple[Sequence[int], Sequence[int], Sequence[bytes]]
_DAMAGE = (sqlite3.Error, ValueError, OverflowError)
"""What reading a damaged file raises."""


class SqliteFile:
    """A `.db3` file; implements `recording.RecordedFile`."""

    def __init__(self, path: str, name: str = "") -> None:
        """Reads topics, definitions and time span.

        Args:
            path: the file.
            name: path to show, if it differs.

        Raises:
            RecordingError: it cannot be opened or is not a recording of rosbag2.
        """
        self.name = name or path
        self.problem = ""
        self._path = path
        self._channels: Dict[int, Channel] = {}
        self.span_ns: Optional[Tuple[int, int]] = None
        try:
            with open(path, "rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    raise RecordingError(f"{self.name}: expected an SQLite file")
            database = self._open()
        except OSError as error:
            raise RecordingError(f"{self.name}: cannot be read: {error.strerror or error}") from None
        try:
            self._channels = _read_channels(database)
            try:
                first, last = database.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
                self.span_ns = None if first is None else (int(first), int(last))
            except (*_DAMAGE, TypeError):
                self._scan(database)
        except _DAMAGE as error:
            raise RecordingError(f"{self.name}: cannot be read as a recording of rosbag2: {error}") from None
        finally:
            database.close()

    @property
    def channels(self) -> List[Channel]:
        """The channels, each once, in the order of the file."""
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, targets: Mapping[Channel, Target]) -> Iterator[RawMessage[Target]]:
        """Yields the messages of some channels; see `recording.RecordedFile`."""
        wanted = {number: targets[channel] for number, channel in self._channels.items() if channel in targets}
        last_ns = 0
        try:
            for numbers, times, data in self._columns(wanted, "WHERE {} ORDER BY timestamp, id"):
                last_ns = times[-1]
                yield from zip(times, map(wanted.__getitem__, numbers), data)
        except _DAMAGE as error:
            self._note_damage(error)
            for message in in_time_order(self._remaining(wanted, last_ns)):
                last_ns = message[0]
                yield message
            self.span_ns = until(self.span_ns, last_ns)

    def _remaining(self, wanted: Mapping[int, Target], last_ns: int) -> Iterator[List[RawMessage[Target]]]:
        """Yields the messages after a time in the order of recording, which needs no index."""
        try:
            for numbers, times, data in self._columns(wanted, "NOT INDEXED WHERE {} ORDER BY id"):
                rows = zip(times, map(wanted.__getitem__, numbers), data)
                yield [message for message in rows if message[0] > last_ns]
        except _DAMAGE as error:
            self._note_damage(error)

    def _columns(self, wanted: Mapping[int, Any], condition: str) -> Iterator[_Columns]:
        """Yields numbers of topics, times and data of the next rows: few if they are large."""
        places = ",".join("?" * len(wanted))
        query = "SELECT topic_id, timestamp, data FROM messages " + condition.format(f"topic_id IN ({places})")
        database = self._open()
        try:
            cursor = database.execute(query, list(wanted))
            count = 1
            while True:
                rows = cursor.fetchmany(count)
                if not rows:
                    return
                columns = _columns(rows)
                if set(map(type, columns[1])) != {int} or set(map(type, columns[2])) != {bytes}:
                    self.problem = self.problem or f"{self.name}: a row without a time or data is left out"
                    columns = _columns([row for row in rows if type(row[1]) is int and type(row[2]) is bytes])
                if columns[0]:
                    count = min(_BATCH, 1 + _BATCH_BYTES * len(columns[0]) // (1 + sum(map(len, columns[2]))))
                    yield columns
        finally:
            database.close()

    def _note_damage(self, error: Exception) -> None:
        self.problem = f"{self.name}: damaged ({error}): read as far as possible"

    def _open(self) -> sqlite3.Connection:
        # A recording is never written here. `immutable` reads it where no journal can be written; a journal that a
        # crashed recorder left behind must be applied, which needs the ordinary mode.
        mode = "mode=ro" if _has_journal(self._path) else "mode=ro&immutable=1"
        try:
            return sqlite3.connect(f"{Path(os.path.abspath(self._path)).as_uri()}?{mode}", uri=True)
        except sqlite3.Error as error:
            raise RecordingError(f"{self.name}: cannot be opened: {error}") from None

    def _scan(self, database: sqlite3.Connection) -> None:
        """Finds the time span of a file that is damaged, as far as it can be read."""
        times: List[int] = []
        try:
            for (time_ns,) in database.execute("SELECT timestamp FROM messages NOT INDEXED"):
                if type(time_ns) is int:
                    times = [min(times[0], time_ns), max(times[1], time_ns)] if times else [time_ns, time_ns]
        except _DAMAGE as error:
            self._note_damage(error)
        self.span_ns = (times[0], times[1]) if times else None


def _columns(rows: Sequence[Tuple[Any, Any, Any]]) -> _Columns:
    numbers, times, data = zip(*rows) if rows else ((), (), ())
    return numbers, times, data


def _has_journal(path: str) -> bool:
    return any(os.path.exists(path + ending) for ending in ("-wal", "-journal"))


def _read_channels(database: sqlite3.Connection) -> Dict[int, Channel]:
    definitions: Dict[str, Tuple[str, str]] = {}
    if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        for type_name, encoding, text in database.execute(query):
            if encoding in _FORMATS and text:
                definitions[str(type_name)] = str(text), _FORMATS[encoding]
    channels: Dict[int, Channel] = {}
    for number, topic, type_name, encoding in database.execute(
        "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
    ):
        if encoding == "cdr":
            definition, definition_format = definitions.get(str(type_name), ("", ""))
            name = "/" + str(topic).strip("/")
            channels[number] = Channel(name, canonical_type(str(type_name)), "cdr", definition, definition_format)
    return channels
