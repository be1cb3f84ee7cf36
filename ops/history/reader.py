"""Reads a history file, also while a monitor writes it."""

from __future__ import annotations

import errno
import os
import sqlite3
from pathlib import Path
from types import TracebackType
from typing import Any, Iterator, List, Optional, Sequence, Tuple, Type, Union
from urllib.parse import quote

from robot_health_monitor.core.errors import ConfigError

from . import queries, schema
from .checked_rows import CheckedConnection
from .database_file import require_regular_file
from .rows import StoredTransition

_BUSY_S = 2.0


class HistoryReader:
    """A read-only connection to a history file. Use it in one thread; it may be opened and closed for each request."""

    def __init__(self, file: Union[str, Path]) -> None:
        """Opens a file.

        Raises:
            ConfigError: it does not exist, cannot be read, or is no history of this version.
        """
        try:
            self.connection = open_read_only(str(file))
            """The connection, for functions of `queries`."""
        except OSError as error:
            raise ConfigError(error.strerror or str(error), file=str(file)) from None
        except schema.UnknownSchemaError as error:
            raise ConfigError(str(error), file=str(file)) from None
        except sqlite3.Error as error:
            raise ConfigError(f"cannot be read: {error}", file=str(file)) from None

    def __enter__(self) -> HistoryReader:
        """Returns itself."""
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], traceback: Optional[TracebackType]
    ) -> None:
        """Closes the file."""
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self.connection.close()

    def transitions(self, **options: Any) -> Iterator[StoredTransition]:
        """Yields transitions; the options are those of `queries.transitions`."""
        return queries.transitions(self.connection, **options)

    def evidence(self, transition_id: int) -> Sequence[Tuple[float, float]]:
        """Returns the samples of the window at a transition: wall time in s since 1970, value."""
        return queries.evidence(self.connection, transition_id)

    def gaps(self, since_s: float = 0.0) -> List[queries.Gap]:
        """Returns the times in which the monitor did not run."""
        return queries.gaps(self.connection, since_s)


def open_read_only(path: str) -> CheckedConnection:
    """Opens a history file that another process may be writing.

    Raises:
        OSError: it does not exist or cannot be read.
        UnknownSchemaError: it is no history, or one of another version.
        sqlite3.Error: it is damaged.
    """
    require_regular_file(path)
    os.stat(path)  # for an error that names the reason; SQLite's own does not
    if not os.access(path, os.R_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)
    try:
        return _connected(path, "mode=ro")
    except sqlite3.OperationalError:
        if _has_log(path):
            raise
    # Without a log nothing writes the file. SQLite would create one, which needs permission to write to the folder.
    return _connected(path, "immutable=1")


def _connected(path: str, options: str) -> CheckedConnection:
    uri = f"file:{quote(os.path.abspath(path))}?{options}"
    connection = sqlite3.connect(
        uri, uri=True, timeout=_BUSY_S, isolation_level=None, check_same_thread=False, factory=CheckedConnection
    )
    try:
        schema.require_known(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _has_log(path: str) -> bool:
    try:
        return os.stat(f"{os.path.realpath(path)}-wal").st_size > 0
    except OSError:
        return False
