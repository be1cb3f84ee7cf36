"""Opening a history file: by the monitor that writes it, with its lock, and by others that read it meanwhile.

SQLite's write-ahead log (WAL) is used with synchronous=NORMAL: a commit hands its pages to the kernel, which keeps them
when the process is killed. A thread flushes the log to the disk each second if something was written, so that a power
cut loses no more than the last second, and copies the log into the file when it has grown. The writer itself waits for
the disk only when the kernel makes it wait.

SQLite starts the log again only when all of it has been copied and no reader uses it. Under load that never happens by
itself: the thread makes the writer wait while it copies the last few pages. If the log grows faster, the writer copies
it itself.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import sqlite3
import stat
import time
from datetime import timezone
from pathlib import Path
from typing import Iterator
from urllib.parse import quote

from ...core.values import ConfigError
from ...runtime.threads import StepThread
from ...runtime.times import local_time
from . import schema
from .rows import CheckedConnection

SYNC_PERIOD_S = 1.0
"""A power cut loses at most what was written in this time, in s."""

# Python before 3.11 does not give SQLite's error codes: errors are recognized by their texts (`sqlite3ErrStr`).
_DAMAGE = (schema.ALTERED, "malformed", "not a database")
_FILE = ("is full", "I/O error", "readonly", "is locked", "unable to open", "permission denied", "locking protocol")

_BUSY_S = 3.0  # how long to wait for another process that writes, such as `robot-health silence`
_READ_BUSY_S = 2.0
_PAGE_BYTES = 512  # an alert changes a few hundred bytes in each of several pages, which are written as a whole
_READERS_S = 0.02  # how long the writer may have to wait for readers of the log
_SQLITE_MAGIC = b"SQLite format 3\0"
_MAX_ASIDE = 100


def is_damage(error: BaseException) -> bool:
    """Whether an error says that the file's contents are damaged."""
    return isinstance(error, sqlite3.DatabaseError) and any(text in str(error) for text in _DAMAGE)


def is_file_error(error: BaseException) -> bool:
    """Whether an error comes from the file or its disk, not from a mistake in an SQL statement."""
    return is_damage(error) or (isinstance(error, sqlite3.Error) and any(text in str(error) for text in _FILE))


class DatabaseFile:
    """An open history file that no other monitor writes."""

    def __init__(self, path: str, log_bytes: float = 4e6) -> None:
        """Opens or creates a file, and migrates an older version.

        Args:
            path: a symbolic link is followed; missing folders are created.
            log_bytes: size from which on the log is copied into the file, in bytes.

        Raises:
            UnusableFileError: another monitor writes it, or it must not be touched.
            OSError, sqlite3.Error: it cannot be written, or is damaged (`is_damage`).
        """
        self._given_path = path
        self.path = os.path.realpath(path)
        self.problem = ""
        """Why the latest flush to the disk failed; empty if it did not."""
        self._log_bytes = log_bytes
        self._flush_began_s: float | None = None
        _require_history_or_nothing(self.path)
        os.makedirs(os.path.dirname(self.path), exist_ok=True)
        with contextlib.ExitStack() as on_error:
            self._lock: int | None = _lock(lock_path(self.path))
            on_error.callback(os.close, self._lock)
            self.connection = CheckedConnection(self.path, _BUSY_S)
            on_error.callback(self.connection.close)
            schema.version_of(self.connection)  # what follows would change a file that must not be touched
            for setting in (
                f"page_size = {_PAGE_BYTES}",  # these two have an effect in a new file only
                "auto_vacuum = INCREMENTAL",
                "synchronous = FULL",
                "wal_autocheckpoint = 0",
                "journal_size_limit = 0",  # shortens the log when it begins anew
                "secure_delete = OFF",  # Debian's SQLite overwrites what is deleted
            ):
                self.connection.execute(f"PRAGMA {setting}")
            # Without a WAL (some network file systems) only FULL survives a power cut.
            if self.connection.execute("PRAGMA journal_mode = WAL").fetchone()[0] == "wal":
                self.connection.execute("PRAGMA synchronous = NORMAL")
            schema.prepare(self.connection)
            self._identity = _identity(self.path)
            self._thread = StepThread("history sync", self._sync, self._note_problem)
            self._thread.start()
            on_error.pop_all()

    @property
    def flushing_s(self) -> float:
        """For how long the flush that is under way has lasted, in s; 0 if none is."""
        began_s = self._flush_began_s
        return 0.0 if began_s is None else time.monotonic() - began_s

    def log_bytes(self) -> int:
        """Returns the size of the log, in bytes."""
        return _log_bytes(self.path)

    def copy_log(self) -> None:
        """Copies the log into the file, and empties it if no reader uses it."""
        # A second connection: the writer goes on while all but the last few pages are copied.
        with contextlib.closing(CheckedConnection(f"file:{quote(self.path)}?mode=rw", _READERS_S)) as connection:
            for mode in ("PASSIVE", "TRUNCATE"):
                connection.execute(f"PRAGMA wal_checkpoint({mode})").fetchone()

    def is_in_place(self) -> bool:
        """Whether the path still leads to the open file, also through links, and the log is still beside it."""
        return os.path.realpath(self._given_path) == self.path and _identity(self.path) == self._identity

    def close(self) -> None:
        """Closes the file and releases its lock; the last connection copies the log into the file."""
        self._thread.close()
        self._thread.join(SYNC_PERIOD_S)  # not longer: the disk may hang
        with contextlib.suppress(OSError, sqlite3.Error):  # its disk fails
            self.connection.close()
        lock, self._lock = self._lock, None
        if lock is not None:  # closing a number twice could close another file
            os.close(lock)

    def _sync(self) -> float:
        """Flushes what was written since the last call, and copies a long log; returns the time until the next one."""
        self._flush_began_s = time.monotonic()
        try:
            with contextlib.suppress(FileNotFoundError):
                log = os.open(f"{self.path}-wal", os.O_RDONLY | os.O_CLOEXEC)
                try:
                    os.fdatasync(log)
                finally:
                    os.close(log)  # SQLite holds no locks on it; closing the database file here would release them
            if self.log_bytes() >= self._log_bytes:
                self.copy_log()
            self.problem = ""
        finally:
            self._flush_began_s = None
        return SYNC_PERIOD_S

    def _note_problem(self, error: Exception) -> None:
        self.problem = getattr(error, "strerror", None) or str(error)


def lock_path(path: str) -> str:
    """Returns the path of the file that the writing monitor holds a lock on."""
    return f"{path}.lock"


def set_aside(path: str, wall_s: float) -> str:
    """Renames a damaged file, with its log, at a time in s since 1970; returns its new path, or raises OSError."""
    path = os.path.realpath(path)
    when = local_time(wall_s, "%Y%m%dT%H%M%SZ", timezone.utc)
    aside = f"{path}.damaged-{when}"
    number = 1
    while os.path.lexists(aside) and number < _MAX_ASIDE:
        number += 1
        aside = f"{path}.damaged-{when}-{number}"
    # The log first: a log that is left alone beside a new file would be applied to it.
    for suffix in ("-wal", "-shm", ""):
        with contextlib.suppress(FileNotFoundError):
            os.rename(path + suffix, aside + suffix)
    return aside


@contextlib.contextmanager
def reading(file: str | Path) -> Iterator[CheckedConnection]:
    """Opens a history file that a monitor may be writing, for queries in one thread.

    Raises:
        ConfigError: it does not exist, cannot be read (also in the block), or is no history of this version.
    """
    path = str(file)
    try:
        try:
            _require_regular_file(path)
            if not os.access(path, os.R_OK):  # SQLite's error does not name the reason
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
            try:
                connection = connected(path, "mode=ro", _READ_BUSY_S)
            except sqlite3.OperationalError:
                if _log_bytes(os.path.realpath(path)):
                    raise
                # Without a log nothing writes the file. SQLite would create one, which needs permission to write to the
                # folder.
                connection = connected(path, "immutable=1", _READ_BUSY_S)
        except (OSError, schema.UnusableFileError) as error:
            raise ConfigError(getattr(error, "strerror", None) or str(error), file=path) from None
        with contextlib.closing(connection):
            yield connection
    except sqlite3.Error as error:
        raise ConfigError(f"cannot be read: {error}", file=path) from None


def connected(path: str, options: str, timeout_s: float) -> CheckedConnection:
    """Returns a connection to an existing history, beside the one of the monitor that writes it.

    `options` are those of SQLite's URI, such as `mode=rw`. Raises UnusableFileError or sqlite3.Error.
    """
    connection = CheckedConnection(f"file:{quote(os.path.abspath(path))}?{options}", timeout_s)
    try:
        schema.require_known(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _require_regular_file(path: str) -> None:
    """Raises OSError if the path does not lead to a regular file; a pipe would block."""
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "not a regular file", path)


def _require_history_or_nothing(path: str) -> None:
    """Protects files that were named by mistake: a damaged history is renamed, other files must not be."""
    try:
        _require_regular_file(path)
        with open(path, "rb") as file:
            begin = file.read(4096)
    except FileNotFoundError:
        return
    # The lock beside it shows that a monitor has written it; the begin of the file may be damaged, but it is no text.
    is_odd = begin and not begin.startswith(_SQLITE_MAGIC)
    if is_odd and (_is_text(begin) or not os.path.exists(lock_path(path))):
        raise schema.UnusableFileError("it is not a history file")


def _is_text(begin: bytes) -> bool:
    try:
        begin[:-4].decode("utf-8")  # the last character may be cut
    except UnicodeDecodeError:
        return False
    return b"\0" not in begin


def _lock(path: str) -> int:
    """Takes the lock that the kernel releases when the process ends, and returns its descriptor."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise schema.UnusableFileError("it is in use by another monitor") from None
        raise
    return descriptor


def _identity(path: str) -> object:
    """Returns what changes when the file or its log is replaced or deleted."""
    identity = []
    for name in (path, f"{path}-wal"):
        try:
            status = os.stat(name)
            identity.append((status.st_dev, status.st_ino))
        except OSError:
            identity.append((0, 0))
    return identity


def _log_bytes(path: str) -> int:
    try:
        return os.stat(f"{path}-wal").st_size
    except OSError:
        return 0
