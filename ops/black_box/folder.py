"""The folder of a black box: one monitor at a time, files of a killed process, and the limits of size and age.

Only files that a black box has written, by name and content, are deleted or count. Used by the thread of the black box
only. Everything may raise OSError.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from typing import Collection, Iterator, NamedTuple

from ...core.values import Clock
from ..configuration import BlackBoxSettings
from ..store.retention import AgeClock
from . import recording_file
from .recording_file import LIBRARY, MAGIC, PART

ENDING = ".mcap"
_OWN_NAME = re.compile(r"[\w-]{1,60}_\d{8}T\d{6}\.\d{3}Z_[\w-]{1,80}\.mcap", re.ASCII)
_HEADER_BYTES = 64
_DAY_S = 86_400.0


class _File(NamedTuple):
    modified_s: float  # first, so that the oldest comes first
    name: str
    bytes: int


def find_file(folder: str, name: str) -> str | None:
    """Returns the path of a complete recording, whatever a client sent as its name; None if there is none."""
    path = os.path.join(folder, name)
    is_there = _OWN_NAME.fullmatch(name) and os.path.isfile(path) and not os.path.islink(path)
    return path if is_there else None


class Folder:
    """The folder, locked by this process."""

    def __init__(self, settings: BlackBoxSettings, wall_s: Clock) -> None:
        """Creates and locks it. Raises OSError, also if another monitor writes into it."""
        self.path = settings.folder
        self.problem: OSError | None = None
        """Why an old file could not be deleted, the last time."""
        self._settings = settings
        self._wall_s = wall_s
        self._own: Collection[_File] = ()
        os.makedirs(self.path, mode=0o750, exist_ok=True)
        newest_s = max((file.modified_s for file in self._files()), default=wall_s())
        self._age_clock = AgeClock(min(newest_s, wall_s()))
        # The folder itself, not a file in it: systemd-tmpfiles removes old files, but none from a locked folder.
        self._directory = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(self._directory, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.close()
            raise OSError(error.errno, "another monitor writes into this folder", self.path) from None
        except OSError:
            pass  # NFS locks no folders

    def file(self, name: str) -> str:
        """Returns the path of a file."""
        return os.path.join(self.path, name)

    def is_there(self) -> bool:
        """Whether its path still leads to it: it may have been removed, or replaced."""
        try:
            return os.path.samestat(os.stat(self.path), os.fstat(self._directory))
        except OSError:
            return False

    def complete_files(self) -> Iterator[OSError]:
        """Completes the files that a killed process left, or removes them; yields why one could be neither."""
        for name in sorted(os.listdir(self.path)):
            base = name[: -len(PART)]
            if name.endswith(PART) and _OWN_NAME.fullmatch(base) and _is_own(self.file(name)):
                try:
                    recording_file.complete(self.file(base))
                except OSError as error:
                    yield error

    def make_room(self, open_files: Collection[str], needed_bytes: int = 0) -> bool:
        """Deletes old recordings, the oldest first, never one of `open_files`; returns whether the limits hold.

        `needed_bytes` is the size of files that are being written. Files of others are left alone and do not count.
        """
        keep_bytes = self._settings.keep_mb * 1e6
        oldest_s = self._age_clock.now_s(self._wall_s()) - self._settings.keep_days * _DAY_S
        self._own = files = sorted(self._files())
        self.problem = None
        total = needed_bytes + sum(file.bytes for file in files)
        for file in files:
            if file.name not in open_files and (total > keep_bytes or file.modified_s < oldest_s):
                try:
                    os.unlink(self.file(file.name))
                except OSError as error:
                    self.problem = error  # others may make enough room
                else:
                    total -= file.bytes
        return total <= keep_bytes

    def close(self) -> None:
        """Unlocks it."""
        os.close(self._directory)

    def _files(self) -> Iterator[_File]:
        """Yields the recordings. A file that is known need not be read again."""
        with os.scandir(self.path) as entries:
            for entry in entries:
                if _OWN_NAME.fullmatch(entry.name):
                    with contextlib.suppress(OSError):  # it was just deleted
                        status = entry.stat(follow_symlinks=False)
                        file = _File(status.st_mtime, entry.name, status.st_size)
                        if file in self._own or (file.bytes and _is_own(entry.path)):
                            yield file


def _is_own(path: str) -> bool:
    """Whether a black box wrote a file: its header names this program. One that was killed early is empty."""
    if os.path.islink(path) or not os.path.isfile(path):
        return False
    try:
        with open(path, "rb") as stream:
            begin = stream.read(_HEADER_BYTES)
    except OSError:
        return False
    return not begin or (begin.startswith(MAGIC) and LIBRARY.encode() in begin)
