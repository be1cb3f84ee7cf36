"""The black box of a process: begins a recording at an alert, and writes all recordings in one thread.

An alert only notes that its recording begins: names, lists and a lock that is held for microseconds. Folder, disk and
library are the business of the thread. Whatever fails there is a fault, and the monitoring goes on.
"""

from __future__ import annotations

import re
import threading
import time
from dataclasses import dataclass, field
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Set

from robot_health_monitor.core.attachments import STATE, THRESHOLDS, SavedMonitor, thresholds_tree
from robot_health_monitor.core.config import MonitorConfig
from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.middleware import Middleware
from robot_health_monitor.core.model import Level
from robot_health_monitor.runtime.backoff import Backoff
from robot_health_monitor.runtime.libraries import libraries
from robot_health_monitor.runtime.threads import StepThread

from ..configuration import BlackBoxSettings
from .capture import is_pattern
from .folder import ENDING, Folder, FolderInUseError
from .recording_file import RecordingFile
from .ring import Message, Reader, Ring

PART = "black box"
"""The part whose fault says that recordings cannot be written."""
FULL_PART = "black box folder"
"""The part whose fault says that nothing is recorded because all recordings belong to open alerts."""
LOST_PART = "black box messages"
"""The part whose fault counts messages that are missing in a recording."""

LARGE_PART = "black box memory"
"""The part whose fault names a topic whose messages are too large for the memory."""

_READ_BYTES = 512 << 10  # that are written at a time
_STEP_S = 0.2
_IDLE_S = 5.0
_RETENTION_PERIOD_S = 60.0
_TOPICS_PERIOD_S = 5.0
_FIRST_RETRY_S, _LAST_RETRY_S = 5.0, 60.0
_CLOSE_TIMEOUT_S = 1.5
_WRITING_BYTES = 8e6  # of `memory_mb` for what is being written, at most half of it
_SHARE_OF_FOLDER = 0.25
_LONGEST_NAME = 60


@dataclass(eq=False)
class Recording:
    """A recording that has begun. `end_s` and `is_ended` belong to the node, what follows to the thread."""

    name: str
    """Name of the file."""
    robot: str
    reader: Reader
    offset_s: float
    """Seconds since 1970 minus the robot's steady clock."""
    saved: SavedMonitor
    """The states at its beginning; the times are on the steady clock."""
    config: MonitorConfig
    topics: Mapping[str, str]
    """The absolute name of each topic in the configuration."""
    use_sim_time: bool
    profile: str
    alert: str
    """The first alert line."""
    end_s: float
    """When it ends unless there is another alert, in s on the steady clock."""
    is_ended: bool = False
    is_failed: bool = False
    """Whether it cannot be written."""
    is_large: bool = False
    """Whether it should end, because it has its share of the folder."""
    file: Optional[RecordingFile] = field(default=None, repr=False)


class BlackBox:
    """The recordings of all robots of a process. Methods may be called from any thread unless they say otherwise."""

    def __init__(
        self,
        settings: BlackBoxSettings,
        faults: Faults,
        wall_time_s: Callable[[], float] = time.time,
    ) -> None:
        """Starts the thread; whatever is wrong with the folder is a fault.

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
        self.is_broken = not self._has_library(faults)
        """Whether nothing can be recorded in this run."""
        self.lost = 0
        """Messages that are missing in recordings."""
        self._faults = faults
        self._lock = threading.Lock()
        self._names: Set[str] = set()
        self._recordings: List[Recording] = []
        self._open_files: Dict[str, Mapping[str, str]] = {}
        self._folder: Optional[Folder] = None
        self._backoff = Backoff(_FIRST_RETRY_S, _LAST_RETRY_S)
        self._retry_s = 0.0
        self._retention_s = time.monotonic() + _RETENTION_PERIOD_S  # by then the open alerts are known
        self._is_closing = False
        self._idle = threading.Condition(self._lock)
        self._thread = StepThread("black box", self._step, self._note_error)
        self._robots: Dict[str, Callable[[Mapping[str, str]], None]] = {}
        self._middlewares: Dict[str, Middleware] = {}
        self._topics_thread = StepThread("black box topics", self._look_for_topics, lambda error: None)
        if not self.is_broken:
            self._thread.start()
            if any(map(is_pattern, settings.topics)):
                self._topics_thread.start()

    def new_name(self, robot: str, signal: str) -> str:
        """Returns the name of a file that begins now."""
        wall_s = self.wall_time_s()
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime(wall_s)) + f".{int(wall_s % 1.0 * 1000):03d}Z"
        base = f"{_as_name(robot)}_{stamp}_{_as_name(signal)}"
        with self._lock:
            name, number = base + ENDING, 2
            while name in self._names:
                name, number = f"{base}_{number}{ENDING}", number + 1
            self._names.add(name)
        return name

    def begin(self, recording: Recording) -> None:
        """Begins to write a recording, in the thread."""
        with self._lock:
            self._recordings.append(recording)
        self._thread.wake()

    def note_open(self, robot: str, files: Mapping[str, str]) -> None:
        """Notes the file of each open alert of a robot, by its signal: they are not deleted."""
        with self._lock:
            self._open_files[robot] = dict(files)

    def watch_topics(self, robot: str, middleware: Middleware, receive: Callable[[Mapping[str, str]], None]) -> None:
        """Passes the topics of a robot with their types to a function from time to time, if there are patterns."""
        with self._lock:
            self._middlewares[robot], self._robots[robot] = middleware, receive
        self._topics_thread.wake()

    def forget(self, robot: str) -> None:
        """Ends `watch_topics`, and `note_open` for a robot."""
        with self._lock:
            self._middlewares.pop(robot, None)
            self._robots.pop(robot, None)
            self._open_files.pop(robot, None)

    def wake(self) -> None:
        """Makes the thread look at the recordings at once."""
        self._thread.wake()

    def wait_until_written(self, timeout_s: float) -> bool:
        """Waits until no recording is being written; returns whether that is so."""
        with self._idle:
            return self._idle.wait_for(lambda: not self._recordings, timeout_s)

    def close(self) -> None:
        """Completes the recordings, which must have ended, within 1.5 s; else the next start does."""
        self._is_closing = True
        self._topics_thread.close()
        self._thread.wake()
        if self._thread.is_alive():
            self.wait_until_written(_CLOSE_TIMEOUT_S)
            self._thread.close()
            self._thread.join(0.2)
        if not self._thread.is_alive() and self._folder is not None:
            self._folder.close()

    def _has_library(self, faults: Faults) -> bool:
        try:
            with libraries("mcap"):
                import mcap.writer  # noqa: F401
        except ServiceError as error:
            faults.report(PART, f"nothing is recorded: {error}")
            return False
        return True

    # The thread

    def _step(self) -> float:
        if self._folder is not None and not self._folder.is_there():
            self._folder.close()
            self._folder = None
        folder = self._folder or self._open_folder()
        with self._lock:
            recordings = list(self._recordings)
        for recording in recordings:
            if folder is None or recording.is_failed:
                self._give_up(recording)
            else:
                self._write(folder, recording)
        if folder is not None and time.monotonic() >= self._retention_s:
            self._retention_s = time.monotonic() + _RETENTION_PERIOD_S
            self._attempt(lambda: folder.make_room(self._protected()))
        self._report_lost()
        with self._lock:
            return _STEP_S if self._recordings else _IDLE_S

    def _open_folder(self) -> Optional[Folder]:
        if self.is_broken or time.monotonic() < self._retry_s:
            return None
        try:
            folder = Folder(self.settings, self.wall_time_s)
            failed = folder.complete_files()
        except FolderInUseError as error:
            self.is_broken = True
            self._faults.report(PART, f"nothing is recorded: {error}")
            return None
        except OSError as error:
            self._retry_s = time.monotonic() + self._backoff.next_s()
            self._faults.report(PART, _reason(error, self.settings.folder))
            return None
        self._folder = folder
        if failed:  # the next file that is written ends the fault
            self._faults.report(PART, _reason(failed[0], self.settings.folder))
        else:
            self._faults.clear(PART)
        return folder

    def _write(self, folder: Folder, recording: Recording) -> None:
        try:
            if recording.file is None:
                recording.file = RecordingFile(
                    folder.file(recording.name), recording.profile, _begin_ns(recording), _attachments(recording)
                )
                recording.file.write(recording.reader.first.quiet, recording.offset_s)
            is_cut = False
            while not is_cut:
                messages = recording.reader.read(_READ_BYTES)
                if not messages:
                    break
                is_cut = not self._has_room(folder, messages)
                if not is_cut:
                    recording.file.write(messages, recording.offset_s)
                    recording.is_large = recording.file.bytes > _SHARE_OF_FOLDER * self.settings.keep_mb * 1e6
            recording.is_failed = is_cut  # the node begins another one at the next alert
            if is_cut and not recording.file.messages:
                self._give_up(recording)
            elif is_cut or (recording.is_ended and recording.reader.is_complete):
                lost = recording.reader.lost
                recording.file.finish({"robot": recording.robot, "alert": recording.alert, "lost": str(lost)})
                self._end(recording)
                self._faults.clear(PART)
                folder.make_room(self._protected(), self._bytes_being_written())
        except OSError as error:
            self._faults.report(PART, _reason(error, folder.file(recording.name)))
            self._give_up(recording)
        except Exception as error:
            self._note_error(error)
            self._give_up(recording)

    def _has_room(self, folder: Folder, messages: Sequence[Message]) -> bool:
        """Returns whether messages can be written without exceeding the limit of the folder."""
        needed_bytes = sum(len(data) for _, _, data in messages) + self._bytes_being_written()
        has_room = folder.make_room(self._protected(), needed_bytes)
        if has_room:
            self._faults.clear(FULL_PART)
        else:
            self._report_full()
        return has_room

    def _bytes_being_written(self) -> int:
        with self._lock:
            return sum(recording.file.bytes for recording in self._recordings if recording.file is not None)

    def _protected(self) -> Set[str]:
        with self._lock:
            return {name for files in self._open_files.values() for name in files.values()}

    def _give_up(self, recording: Recording) -> None:
        recording.is_failed = True
        if recording.file is not None:
            recording.file.discard()
            recording.file = None
        self._end(recording)

    def _end(self, recording: Recording) -> None:
        recording.reader.close()
        self.lost += recording.reader.lost
        with self._idle:
            if recording in self._recordings:
                self._recordings.remove(recording)
            self._idle.notify_all()

    def _report_lost(self) -> None:
        with self._lock:
            lost = self.lost + sum(recording.reader.lost for recording in self._recordings)
        if lost:
            memory_mb = f"memory_mb {self.settings.memory_mb:g}"
            text = f"{lost} messages are missing in recordings: the disk was too slow for {memory_mb}"
            self._faults.report(LOST_PART, text, Level.WARN)

        if self.ring.too_large is not None:
            topic, size = self.ring.too_large
            text = f"{topic} is not recorded: a message of {size / 1e6:.3g} MB is too large for memory_mb"
            self._faults.report(LARGE_PART, f"{text} {self.settings.memory_mb:g}", Level.WARN)

    def _report_full(self) -> None:
        text = f"nothing is recorded: the recordings of open alerts take keep_mb ({self.settings.keep_mb:g})"
        self._faults.report(FULL_PART, text, Level.WARN)

    def _attempt(self, function: Callable[[], object]) -> None:
        try:
            if function():
                self._faults.clear(FULL_PART)
        except OSError as error:
            self._faults.report(PART, _reason(error, self.settings.folder))

    def _note_error(self, error: Exception) -> None:
        self._faults.report(PART, f"{type(error).__name__}: {error}")

    # The other thread

    def _look_for_topics(self) -> float:
        with self._lock:
            robots = [(self._middlewares[name], receive) for name, receive in self._robots.items()]
        for middleware, receive in robots:
            try:
                receive(middleware.topic_types())
            except (ServiceError, RuntimeError):
                continue  # it does not answer, or its topics are changing
        return _TOPICS_PERIOD_S


def _attachments(recording: Recording) -> Dict[str, str]:
    import yaml

    tree = thresholds_tree(recording.config, recording.robot, recording.topics, use_sim_time=recording.use_sim_time)
    thresholds: str = yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    return {THRESHOLDS: thresholds, STATE: recording.saved.moved(recording.offset_s).to_json()}


def _begin_ns(recording: Recording) -> int:
    return max(0, round((recording.saved.time_s + recording.offset_s) * 1e9))


def _as_name(text: str) -> str:
    """Returns a text as a part of a file's name."""
    return re.sub(r"[^A-Za-z0-9-]+", "_", text)[:_LONGEST_NAME].strip("_") or "x"


def _reason(error: OSError, path: str) -> str:
    return f"{error.filename or path}: {error.strerror or error}"
