"""Which history file a command means, how commands read and change it, and how they write its times in JSON and CSV."""

from __future__ import annotations

import argparse
import contextlib
import getpass
import os
import sqlite3
import sys
from typing import Callable, Iterator, TypeVar

from ...core.config import read_yaml
from ...core.values import ConfigError, printable
from ...ops.configuration import read_ops
from ...ops.store import schema
from ...ops.store.database_file import connected, reading
from ...ops.store.rows import CheckedConnection
from ...ops.store.silences import MOST_TEXT
from ..arguments import Parser, add

DEFAULT_FILE = "/var/lib/robot-health/history.db"
"""Where a monitor that runs as a service has its history."""

_BUSY_S = 5.0
"""How long to wait for a monitor that writes."""

Changed = TypeVar("Changed")


def add_history_options(parser: Parser) -> None:
    """Adds the options that name a history file, for `history_file`."""
    add(parser, "--history FILE", f"the history file (default: named by --ops, else {DEFAULT_FILE})")
    add(parser, "--ops FILE", "an ops.yaml that names the history")


def add_author(parser: Parser) -> None:
    """Adds the option for `author_of`."""
    add(parser, "--author NAME", "author (default: the login name)")


def author_of(arguments: argparse.Namespace) -> str:
    """Returns who changes something: as given, else the login name."""
    if arguments.author is not None:
        return str(arguments.author)
    try:
        return printable(getpass.getuser())[:MOST_TEXT]
    except (KeyError, OSError, ImportError):  # a user without an entry, as in containers
        return ""


def history_file(file: str | None, ops: str | None) -> str:
    """Returns the path of the history: `file` or that of an ops.yaml, if one of them was given.

    Raises:
        ConfigError: both were given, or the ops.yaml cannot be used or has no history.
    """
    if file is not None and ops is not None:
        raise ConfigError("expected either a history file or --ops, got both")
    if file is not None:
        return file
    if ops is None:
        if not os.path.exists(DEFAULT_FILE):
            raise ConfigError(f"no history file is given, and there is no {DEFAULT_FILE}")
        return DEFAULT_FILE
    history = read_ops(read_yaml(ops)).history
    if history is None:
        raise ConfigError("expected a section history, got none", file=ops)
    return history.file


@contextlib.contextmanager
def reading_history(file: str) -> Iterator[CheckedConnection]:
    """Opens a history file, as `reading`, and reports the rows that were skipped."""
    with reading(file) as connection:
        yield connection
        if connection.skipped_text:
            sys.stderr.write(f"{printable(file)}: {connection.skipped_text}\n")


def change_history(file: str, change: Callable[[sqlite3.Connection], Changed]) -> Changed:
    """Runs a function in one transaction on a history file, beside a running monitor or without one.

    Raises:
        ConfigError: the file cannot be used.
    """
    try:
        os.stat(file)
        with contextlib.closing(connected(file, "mode=rw", _BUSY_S)) as connection, schema.transaction(connection):
            return change(connection)
    except OSError as error:
        raise ConfigError(error.strerror or str(error), file=file) from None
    except (sqlite3.Error, schema.UnusableFileError) as error:
        raise ConfigError(f"cannot be used: {error}", file=file) from None
