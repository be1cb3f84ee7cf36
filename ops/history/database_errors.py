"""The kinds of errors of SQLite that matter here, and their texts.

Python before 3.11 does not give SQLite's error codes, so they are recognized by SQLite's texts (`sqlite3ErrStr`).
"""

from __future__ import annotations

import os
import sqlite3
from typing import Union

_DAMAGE = ("malformed", "not a database")
_FILE = ("is full", "I/O error", "readonly", "is locked", "unable to open", "permission denied", "locking protocol")


def is_damage(error: BaseException) -> bool:
    """Whether an error says that the file's contents are damaged."""
    return isinstance(error, sqlite3.DatabaseError) and any(text in str(error) for text in _DAMAGE)


def is_file_error(error: BaseException) -> bool:
    """Whether an error comes from the file or its disk, not from a mistake in an SQL statement."""
    return is_damage(error) or (isinstance(error, sqlite3.Error) and any(text in str(error) for text in _FILE))


def reason(error: Union[BaseException, str], file: str) -> str:
    """Returns one line that names the file and what is wrong with it."""
    if isinstance(error, OSError):
        path = os.fsdecode(error.filename) if isinstance(error.filename, (str, bytes)) else file
        return f"{path}: {error.strerror or error}"
    return f"{file}: {error}"
