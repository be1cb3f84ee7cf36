"""Copies the contents of one history database into another: from the file into memory, and back."""

from __future__ import annotations

import sqlite3
from typing import Tuple

from . import schema


def copy_state(
    source: sqlite3.Connection, target: sqlite3.Connection, tables: Tuple[str, ...] = schema.LIVE_TABLES
) -> bool:
    """Copies the tables of the present state, and the last number of each; returns whether all were readable."""
    is_complete = True
    for table in ("sqlite_sequence", *tables):
        try:
            copy_table(source, target, table)
        except sqlite3.Error:
            is_complete = False  # what could be read is there
    return is_complete


def copy_table(source: sqlite3.Connection, target: sqlite3.Connection, table: str) -> None:
    """Copies the rows of a table; those that the target refuses are left out.

    Raises:
        sqlite3.Error: the source cannot be read, or the target cannot be written.
    """
    rows = source.execute(f"SELECT * FROM {table}")
    insert = f"INSERT OR REPLACE INTO {table} VALUES ({', '.join('?' * len(rows.description))})"
    for row in rows:
        try:
            target.execute(insert, row)
        except sqlite3.IntegrityError:
            pass  # edited by hand


def number_from(connection: sqlite3.Connection, number: int, tables: Tuple[str, ...] = ()) -> None:
    """Makes the numbers of rows continue after `number` where they are below it; no tables: all."""
    for table in tables or schema.numbered_tables(connection):
        found = connection.execute("SELECT max(seq) FROM sqlite_sequence WHERE name = ?", (table,)).fetchone()[0]
        if not isinstance(found, int) or found < number:
            connection.execute("DELETE FROM sqlite_sequence WHERE name = ?", (table,))
            connection.execute("INSERT INTO sqlite_sequence (name, seq) VALUES (?, ?)", (table, number))
