"""The black box of a process: begins a recording at an alert, and writes all recordings in one thread.

An alert only notes that its recording begins: names, lists and a lock that is held for microseconds. Folder, disk and
library are the business of the thread. Whatever fails there is a fault, and the monitoring goes on.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Callable, Mapping

from ...core.values import Clock, Faults, Level
from ...runtime.libraries import libraries
from ...runtime.threads import StepThread
from ..configuration import BlackBoxSettings
from .folder import ENDING, Folder
from .recording_file import RecordingFile
from .ring import Reader, Ring

PART = "black box"
"""The part whose fault says that recordings cannot be written."""
FULL_PART = "black box folder"
"""The part whose fault says that there is no room, or that old recordings cannot be deleted."""
LOST_PART = "black box messages"
"""The part whose fault counts messages that are missing in a recording."""

LARGE_PART = "black box memory"
"""The part whose fault names a topic whose messages are too large for the memory."""

_READ_BYTES = 512 << 10  # that are written at a time
_STEP_S = 0.2
_IDLE_S = 5.0
_RETENTION_PERIOD_S = 60.0
_CLOSE_TIMEOUT_S = 1.7
_WRITING_BYTES = 8e6  # of `memory_mb` for what is being written, at most half of it
_SHARE_OF_FOLDER = 0.25
_LONGEST_NAME = 60
_KEPT_NAMES = 1000  # more recordings do not begin within a millisecond


@dataclass(eq=False)
class Recording:
    """A recording that has begun. `end_s` belongs to the node, what follows to the thread."""

    name: str
    """Name of the file."""
    metadata: Mapping[str, str]
    """Name of the robot, and the first alert line."""
    reader: Reader
    offset_s: float
    """Seconds since 1970 minus the robot's steady clock."""
    attachments: Callable[[], Mapping[str, str]]
    """Returns what is attached, by name: the thresholds, and the states at its beginning."""
    profile: str
    end_s: float
    """When it ends unless there is another alert, in s on the steady clock."""
    is_over: bool = False
    """Whether the node should end it, because it has its share of the folder or cannot be written."""
    file: RecordingFile | None = field(default=None, repr=False)


class BlackBox:
    """The recordings of all robots of a process. Methods may be called from any thread unless they say otherwise."""

    def __init__(
        self,
        settings: BlackBoxSettings,
        faults: Faults,
        wall_time_s: Clock = time.time,
    ) -> None:
        """Starts the thread; whatever is wrong with the folder is a fault.

        Raises ServiceError if the library mcap is not installed.

        Args:
            settings: what to record, and for how long to keep it.
            faults: receives what does not work.
            wall_time_s: seconds since 1970.
        """
        self.settings = settings
        self.wall_time_s = wall_time_s
        memory_bytes = settings.memory_mb * 1e6
        self.ring = Ring(max(0.5 * memory_bytes, memory_bytes - _WRITING_BYTES))
        """The messages of all robots."""
        self._lost = 0
        self._faults = faults
        self._lock = threading.Lock()
        self._names: deque[str] = deque(maxlen=_KEPT_NAMES)
        self._recordings: list[Recording] = []
        self.open_files: dict[str, Mapping[str, str]] = {}
        """By robot: the file of each open alert by its signal; they are not deleted. Each robot changes its own."""
        self._folder: Folder | None = None
        self._retention_s = time.monotonic() + _RETENTION_PERIOD_S  # by then the open alerts are known
        self._is_closing = False
        self._thread = StepThread("black box", self._step, lambda error: self._report(error, settings.folder))
        with libraries("mcap"):
            import mcap.writer  # noqa: F401
        self._thread.start()

    def new_name(self, robot: str, signal: str) -> str:
        """Returns the name of a file that begins now."""
        wall_s = self.wall_time_s()
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(wall_s)) + f".{int(wall_s % 1.0 * 1000):03d}Z"
        base = f"{_as_name(robot)}_{stamp}_{_as_name(signal)}"
        with self._lock:
            name, number = base + ENDING, 2
            while name in self._names:
                name, number = f"{base}_{number}{ENDING}", number + 1
            self._names.append(name)
        return name

    def begin(self, recording: Recording) -> None:
        """Begins to write a recording, in the thread, when it wakes up."""
        with self._lock:
            self._recordings.append(recording)

    def wake(self) -> None:
        """Makes the thread look at the recordings at once."""
        self._thread.wake()

    def close(self) -> None:
        """Completes the recordings, which must have ended, within 1.7 s; else the next start does."""
        self._is_closing = True
        self._thread.wake()
        self._thread.join(_CLOSE_TIMEOUT_S)
        self._thread.close()
        if not self._thread.is_alive() and self._folder is not None:
            self._folder.close()

    # The thread

    def _step(self) -> float:
        folder = self._usable_folder()
        with self._lock:
            recordings = list(self._recordings)
        for recording in recordings:
            if folder is None:
                self._give_up(recording)
                continue
            try:
                self._write(folder, recording)
            except Exception as error:  # of the disk, or of the library
                self._report(error, folder.file(recording.name))
                self._give_up(recording)
        if folder is not None and time.monotonic() >= self._retention_s:
            self._retention_s = time.monotonic() + _RETENTION_PERIOD_S
            self._has_room(folder)
        self._report_lost()
        with self._lock:
            if self._recordings:
                return _STEP_S
        if self._is_closing:
            self._thread.close()
        return _IDLE_S

    def _usable_folder(self) -> Folder | None:
        """Opens the folder at first, and anew if it was removed or replaced; returns None if that is not possible."""
        if self._folder is not None and not self._folder.is_there():
            self._folder.close()
            self._folder = None
        if self._folder is None:
            try:
                self._folder = Folder(self.settings, self.wall_time_s)
                self._faults.clear(PART)
                for error in self._folder.complete_files():  # the next file that is written ends the fault
                    self._report(error, self.settings.folder)
            except OSError as error:
                self._report(error, self.settings.folder)
        return self._folder

    def _write(self, folder: Folder, recording: Recording) -> None:
        """Writes what has come since, and completes the file at its end, or if there is no room for more."""
        file, reader, has_room = recording.file, recording.reader, True
        if file is None:
            begin_ns = max(0, round((reader.first.begin_s + recording.offset_s) * 1e9))
            path, attachments = folder.file(recording.name), recording.attachments()
            file = recording.file = RecordingFile(path, recording.profile, begin_ns, attachments)
            file.write(reader.first.quiet, recording.offset_s)
        for messages in iter(lambda: reader.read(_READ_BYTES), []):
            has_room = self._has_room(folder, sum(len(data) for *_, data in messages))
            if not has_room:
                break
            file.write(messages, recording.offset_s)
            recording.is_over = file.bytes > _SHARE_OF_FOLDER * self.settings.keep_mb * 1e6
        if not (has_room or file.messages):
            self._give_up(recording)
        elif not has_room or reader.is_complete:
            recording.is_over = True
            file.finish({**recording.metadata, "lost": str(reader.lost)})
            self._end(recording)
            self._faults.clear(PART)
            self._retention_s = 0.0

    def _has_room(self, folder: Folder, needed_bytes: int = 0) -> bool:
        """Deletes old files; returns whether so much can be written without exceeding the limit of the folder."""
        with self._lock:
            needed_bytes += sum(recording.file.bytes for recording in self._recordings if recording.file is not None)
        protected = {name for files in tuple(self.open_files.values()) for name in tuple(files.values())}
        has_room, text = folder.make_room(protected, needed_bytes), ""
        if not has_room:
            text = f"nothing is recorded: the recordings of open alerts take keep_mb ({self.settings.keep_mb:g})"
        elif folder.problem is not None:
            text = f"an old recording cannot be deleted: {_reason(folder.problem, folder.path)}"
        self._faults.report(FULL_PART, text, Level.WARN)
        return has_room

    def _give_up(self, recording: Recording) -> None:
        recording.is_over = True
        if recording.file is not None:
            recording.file.discard()
            recording.file = None
        self._end(recording)

    def _end(self, recording: Recording) -> None:
        recording.reader.close()
        with self._lock:
            self._lost += recording.reader.lost
            self._recordings.remove(recording)

    def _report_lost(self) -> None:
        memory_mb = f"memory_mb {self.settings.memory_mb:g}"
        with self._lock:
            lost = self._lost + sum(recording.reader.lost for recording in self._recordings)
        if lost:
            text = f"{lost} messages are missing in recordings: the disk was too slow for {memory_mb}"
            self._faults.report(LOST_PART, text, Level.WARN)
        if self.ring.too_large is not None:
            topic, size = self.ring.too_large
            text = f"{topic} is not recorded: a message of {size / 1e6:.3g} MB is too large for {memory_mb}"
            self._faults.report(LARGE_PART, text, Level.WARN)

    def _report(self, error: Exception, path: str) -> None:
        self._faults.report(PART, _reason(error, path))


def _as_name(text: str) -> str:
    """Returns a text as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9-]+", "_", text)[:_LONGEST_NAME].strip("_") or "x"


def _reason(error: Exception, path: str) -> str:
    if isinstance(error, OSError):
        return f"{error.filename or path}: {error.strerror or error}"
    return f"{type(error).__name__}: {error}"
