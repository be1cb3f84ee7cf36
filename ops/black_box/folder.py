"""The folder of a black box: one monitor at a time, files of a killed process, and the limits of size and age.

Used by the thread of the black box only. Everything may raise OSError.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from typing import IO, Callable, Collection, List, NamedTuple, Optional

from robot_health_monitor.core.errors import ServiceError

from ..configuration import BlackBoxSettings
from . import recording_file
from .recording_file import PART

ENDING = ".mcap"
_LOCK = ".lock"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,200}\.mcap", re.ASCII)
_DAY_S = 86_400.0
_CLOCK_STEP_S = 3600.0


class FolderInUseError(ServiceError):
    """Another monitor writes into the folder. `str()` is one line."""


class _File(NamedTuple):
    name: str
    bytes: int
    modified_s: float


def is_file_name(name: str) -> bool:
    """Whether a text can be the name of a file of a black box: no path, no hidden file."""
    return _NAME.fullmatch(name) is not None and ".." not in name


def find_file(folder: str, name: str) -> Optional[str]:
    """Returns the path of a complete file, whatever a client sent as its name; None: there is none."""
    path = os.path.join(folder, name)
    is_there = is_file_name(name) and os.path.isfile(path) and not os.path.islink(path)
    return path if is_there else None


class Folder:
    """The folder, locked by this process."""

    def __init__(self, settings: BlackBoxSettings, wall_s: Callable[[], float]) -> None:
        """Creates and locks it. Raises FolderInUseError, or OSError."""
        self.path = settings.folder
        self._keep_bytes = settings.keep_mb * 1e6
        self._keep_s = settings.keep_days * _DAY_S
        self._wall_s = wall_s
        self._age_clock = wall_s() - _boot_s()
        os.makedirs(self.path, mode=0o750, exist_ok=True)
        self._lock: IO[str] = open(os.path.join(self.path, _LOCK), "a")
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock.close()
            raise FolderInUseError(f"{self.path}: another monitor writes into this folder") from None
        except BaseException:
            self._lock.close()
            raise

    def file(self, name: str) -> str:
        """Returns the path of a file."""
        return os.path.join(self.path, name)

    def is_there(self) -> bool:
        """Whether its path still leads to it: it may have been removed, or replaced."""
        try:
            return os.path.samestat(os.stat(os.path.join(self.path, _LOCK)), os.fstat(self._lock.fileno()))
        except OSError:
            return False

    def complete_files(self) -> List[OSError]:
        """Completes the files that a killed process left, or removes them; returns why one could be neither."""
        failed = []
        for name in sorted(os.listdir(self.path)):
            base, path = name[: -len(PART)], self.file(name)
            if not name.endswith(PART) or os.path.islink(path) or not os.path.isfile(path):
                continue
            try:
                if is_file_name(base):
                    recording_file.complete(self.file(base))
                else:
                    os.unlink(path)  # of a completion that was itself killed
            except OSError as error:
                failed.append(error)
        return failed

    def make_room(self, open_files: Collection[str], needed_bytes: int = 0) -> bool:
        """Deletes old files, the oldest first, never one of `open_files`; returns whether the limits hold.

        `needed_bytes` is the size of files that are being written.
        """
        files = sorted(self._files(), key=lambda file: (file.modified_s, file.name))
        total = needed_bytes + sum(file.bytes for file in files)
        oldest_s = self._now_s() - self._keep_s
        for file in files:
            if file.name not in open_files and (total > self._keep_bytes or file.modified_s < oldest_s):
                os.unlink(self.file(file.name))
                total -= file.bytes
        return total <= self._keep_bytes

    def close(self) -> None:
        """Unlocks it."""
        self._lock.close()

    def _files(self) -> List[_File]:
        found = []
        with os.scandir(self.path) as entries:
            for entry in entries:
                if is_file_name(entry.name) and entry.is_file(follow_symlinks=False):
                    status = entry.stat(follow_symlinks=False)
                    found.append(_File(entry.name, status.st_size, status.st_mtime))
        return found

    def _now_s(self) -> float:
        """Returns the time for ages: a wall clock that jumped ahead while this process ran would delete everything."""
        expected_s = self._age_clock + _boot_s()
        wall_s = self._wall_s()
        return expected_s if wall_s > expected_s + _CLOCK_STEP_S else wall_s


def _boot_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)
