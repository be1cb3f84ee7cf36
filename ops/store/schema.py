"""The tables of the store, their version, and copies between databases.

The tables of notifications and silences are here too, so that one version describes the whole file.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing, contextmanager
from sqlite3 import Connection
from typing import Iterator, Mapping, Sequence

from ...core.values import ConfigError
from .rows import CheckedConnection

APPLICATION_ID = 0x524F4248
"""Identifies the file as a history, in the SQLite header: "ROBH"."""

SCHEMA_VERSION = 1
"""Version of the tables, in the SQLite header (`PRAGMA user_version`)."""

MIGRATIONS: Mapping[int, Sequence[str]] = {}
"""By version: the statements that turn its tables into those of the next version; see `migrate`."""

INDEX_STEP = 16
INDEXED = f"id % {INDEX_STEP} = 0"
"""The transitions that are in the index by time: each one takes a page that an alert has to write."""

# There is no index by robot and signal: each alert would write a page of it at another place of the disk, and so would
# each deleted one; together more than everything else.
_TABLES = f"""
-- Runs of the monitor. Between alive_s (or stopped_s) of one and started_s of the next is a gap.
CREATE TABLE runs (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    started_s REAL NOT NULL,             -- times: wall clock, seconds since 1970 (UTC)
    alive_s REAL NOT NULL,               -- the monitor was still running then
    stopped_s REAL,                      -- NULL: running, or killed
    version TEXT NOT NULL                -- of the software
);
-- Which robots a run watched, and when.
CREATE TABLE watches (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    run_id INTEGER NOT NULL REFERENCES runs(id),
    robot TEXT NOT NULL,
    started_s REAL NOT NULL,
    stopped_s REAL                       -- NULL: until the end of the run
);
CREATE INDEX watches_of_run ON watches(run_id);
CREATE TABLE transitions (
    id INTEGER PRIMARY KEY AUTOINCREMENT, -- the order of events, also when the wall clock is set back
    wall_s REAL NOT NULL,
    robot TEXT NOT NULL,
    signal TEXT NOT NULL,
    from_level INTEGER NOT NULL,         -- 0 OK, 1 WARN, 2 ERROR, 3 STALE
    to_level INTEGER NOT NULL,
    value,                               -- a number, or the text of a bad datum
    statistic TEXT NOT NULL,
    bound REAL,
    now_s REAL NOT NULL,                 -- on the adapter's clock, as since_s
    since_s REAL NOT NULL,
    fingerprint TEXT NOT NULL,
    text TEXT NOT NULL,
    statistics TEXT NOT NULL,            -- JSON object
    repeat INTEGER NOT NULL,             -- 1: a repetition (repeat_s), no change of level
    hint TEXT NOT NULL,                  -- why there were no samples
    black_box TEXT NOT NULL,             -- name of the file that records it
    alert_id INTEGER,                    -- the transition that began the alert; NULL: this one
    cause TEXT NOT NULL                  -- name of the alert whose effect the signal was
);
CREATE INDEX transitions_by_time ON transitions(wall_s) WHERE {INDEXED};
-- The samples of the window at the time of a transition; see rows.py.
CREATE TABLE evidence (
    transition_id INTEGER PRIMARY KEY REFERENCES transitions(id),
    samples BLOB NOT NULL
);
-- The signals that an alert kept from being announced, in the order in which they were noticed.
CREATE TABLE effects (
    transition_id INTEGER NOT NULL REFERENCES transitions(id),
    signal TEXT NOT NULL,
    PRIMARY KEY (transition_id, signal)
);
-- What happened to the samples of each signal; see samples.py.
CREATE TABLE samples (
    robot TEXT NOT NULL,
    signal TEXT NOT NULL,
    start_s REAL NOT NULL,               -- begin of the period
    seconds REAL NOT NULL,               -- its length: 10, after two days 300
    least REAL,                          -- of the judged statistic; NULL: undefined
    most REAL,
    mean REAL,
    last REAL,
    good INTEGER NOT NULL,               -- number of samples
    bad INTEGER NOT NULL,
    level INTEGER NOT NULL,              -- the worst one
    PRIMARY KEY (robot, signal, start_s)
) WITHOUT ROWID;
-- The worst level of each robot in the last two days; see samples.py.
CREATE TABLE robot_levels (
    robot TEXT NOT NULL,
    start_s REAL NOT NULL,               -- begin of a cell of 900 s
    level INTEGER NOT NULL,              -- the worst of its signals
    severity INTEGER NOT NULL,
    PRIMARY KEY (robot, start_s)
) WITHOUT ROWID;
-- What people wrote on transitions; see notes.py.
CREATE TABLE notes (
    transition_id INTEGER NOT NULL REFERENCES transitions(id),
    wall_s REAL NOT NULL,
    author TEXT NOT NULL,
    text TEXT NOT NULL,
    PRIMARY KEY (transition_id, wall_s, text)
) WITHOUT ROWID;
-- What a restarted monitor resumes from: the last state of each signal.
CREATE TABLE signal_states (
    robot TEXT NOT NULL,
    signal TEXT NOT NULL,
    state TEXT NOT NULL,                 -- JSON object
    PRIMARY KEY (robot, signal)
);
-- The alerts that are open, each with its latest level.
CREATE TABLE open_alerts (
    robot TEXT NOT NULL,
    signal TEXT NOT NULL,
    alert_id INTEGER NOT NULL,           -- the transition that began it
    transition_id INTEGER NOT NULL,      -- the one to its present level
    level INTEGER NOT NULL,
    begun_s REAL NOT NULL,
    at_s REAL NOT NULL,                  -- of its present level
    fingerprint TEXT NOT NULL,
    transition_json TEXT NOT NULL DEFAULT '', -- empty: there are no notifications yet
    silenced_s REAL NOT NULL DEFAULT 0,  -- for how long it has been silenced
    silenced_from_s REAL,                -- since when it has been silenced now
    PRIMARY KEY (robot, signal)
) WITHOUT ROWID;
CREATE TABLE resets (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    wall_s REAL NOT NULL,
    robot TEXT NOT NULL
);
-- Each distinct configuration once, and when it came into force.
CREATE TABLE configurations (
    hash TEXT PRIMARY KEY,               -- SHA-256 of the text
    text TEXT NOT NULL
) WITHOUT ROWID;
CREATE TABLE configuration_changes (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    wall_s REAL NOT NULL,
    robot TEXT NOT NULL,
    hash TEXT NOT NULL REFERENCES configurations(hash)
);
CREATE TABLE silences (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    matchers TEXT NOT NULL,              -- robot=r3,signal=battery*
    reason TEXT NOT NULL,
    author TEXT NOT NULL,
    created_s REAL NOT NULL,
    until_s REAL,                        -- NULL: without a time limit
    newest_alert INTEGER NOT NULL DEFAULT 0, -- only for open alerts up to this number, until they resolve; 0: for all
    ended_s REAL,                        -- NULL: not ended, except by until_s
    ended_by TEXT NOT NULL DEFAULT '',
    ended_reason TEXT NOT NULL DEFAULT '',
    every TEXT NOT NULL DEFAULT '',      -- when it recurs, such as mon-fri 22:00-06:00
    timezone TEXT NOT NULL DEFAULT ''
);
-- What each target of notifications was last sent about an alert that is open there.
CREATE TABLE notified (
    target TEXT NOT NULL,
    fingerprint TEXT NOT NULL,
    level INTEGER NOT NULL,
    at_s REAL NOT NULL,                  -- when the alert reached this level
    transition_json TEXT NOT NULL,
    PRIMARY KEY (target, fingerprint)
);
-- Transitions that targets may have to be sent; see notify/notification_queue.py.
CREATE TABLE notifications (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    target TEXT NOT NULL,
    robot TEXT NOT NULL,
    source TEXT NOT NULL,                -- robot and configured signal
    place REAL NOT NULL,                 -- order of the sources among each other
    fingerprint TEXT NOT NULL,
    level INTEGER NOT NULL,
    at_s REAL NOT NULL,
    queued_s REAL NOT NULL,              -- since when it waits
    transition_json TEXT NOT NULL,
    attempts INTEGER NOT NULL DEFAULT 0
);
CREATE INDEX notifications_by_alert ON notifications(target, fingerprint, id);
CREATE INDEX notifications_by_place ON notifications(target, attempts, place, id);
CREATE INDEX notifications_by_source ON notifications(target, source, place);
-- What belongs to a row is deleted with it.
CREATE TRIGGER evidence_of_deleted AFTER DELETE ON transitions
BEGIN DELETE FROM evidence WHERE transition_id = OLD.id; END;
CREATE TRIGGER notes_of_deleted AFTER DELETE ON transitions
BEGIN DELETE FROM notes WHERE transition_id = OLD.id; END;
CREATE TRIGGER effects_of_deleted AFTER DELETE ON transitions
BEGIN DELETE FROM effects WHERE transition_id = OLD.id; END;
CREATE TRIGGER watches_of_deleted AFTER DELETE ON runs
BEGIN DELETE FROM watches WHERE run_id = OLD.id; END;
CREATE TRIGGER text_of_deleted AFTER DELETE ON configuration_changes
BEGIN DELETE FROM configurations
    WHERE hash = OLD.hash AND hash NOT IN (SELECT hash FROM configuration_changes); END;
"""

_CREATE = (*_TABLES.split(";\n"), f"PRAGMA application_id = {APPLICATION_ID}")

SHARED_TABLE = "silences"
"""Other processes write it, too."""

LIVE_TABLES = ("signal_states", "open_alerts", "notified", "notifications", SHARED_TABLE)
"""Tables whose rows are the present state, not the past: retention leaves them alone, and while the file cannot be
written the monitor goes on with a copy of them in memory."""


class UnusableFileError(ConfigError):
    """A file that cannot be used, and is left alone: in use, of a newer version, or no history. `str()` says which."""


def prepare(connection: Connection) -> None:
    """Creates the tables in an empty database, or migrates those of an older version, in one transaction.

    Raises:
        UnusableFileError: the file is no history, or from a newer version; it is unchanged.
        sqlite3.Error: the file is damaged or cannot be written.
    """
    if version_of(connection) != SCHEMA_VERSION:
        with transaction(connection):
            migrate(connection, version_of(connection))


def migrate(connection: Connection, version: int) -> None:
    """Turns the tables of a version into those of the present one; version 0 is an empty database.

    Call inside a transaction: a step that fails changes nothing. To change the tables, change `_TABLES`, add 1 to
    `SCHEMA_VERSION`, and give `MIGRATIONS` the statements that do the same to a file of the version before, such as
    `ALTER TABLE resets ADD COLUMN author TEXT NOT NULL DEFAULT ''`. Tables that were released stay there for ever.
    """
    steps = [MIGRATIONS[number] for number in range(version, SCHEMA_VERSION)] if version else [_CREATE]
    for step in steps:
        for statement in step:
            connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")


@contextmanager
def transaction(connection: Connection) -> Iterator[None]:
    """Runs a block in one transaction of a connection in autocommit mode; rolled back if it or the commit fails."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        try:
            if connection.in_transaction:  # otherwise SQLite has rolled it back because of its error
                connection.execute("ROLLBACK")
        except sqlite3.Error:
            pass  # the first error is the one that matters
        raise


def require_known(connection: Connection) -> None:
    """Raises UnusableFileError unless the file is a history of this version."""
    version = version_of(connection)
    if version == 0:
        raise UnusableFileError("it is empty: no monitor has written it yet")
    if version != SCHEMA_VERSION:
        raise UnusableFileError("it is from an older version of the monitor, which has to open it once")


def version_of(connection: Connection) -> int:
    """Returns the version of the tables; 0 if there are none. Changes nothing.

    Raises:
        UnusableFileError: the file is no history, or from a newer version.
        sqlite3.Error: the file is damaged or cannot be read.
    """
    version: int = connection.execute("PRAGMA user_version").fetchone()[0]
    application_id: int = connection.execute("PRAGMA application_id").fetchone()[0]
    if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0:
        return 0
    if application_id != APPLICATION_ID:
        raise UnusableFileError("it is an SQLite database, but not a history")
    if version > SCHEMA_VERSION:
        raise UnusableFileError(
            f"it was written by a newer version (schema {version}; this version knows up to {SCHEMA_VERSION}): "
            "install that version again, or name another file"
        )
    return version


def tables(connection: Connection) -> list[str]:
    """Returns the names of the tables."""
    query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite~_%' ESCAPE '~'"
    return [name for (name,) in connection.execute(query)]


ALTERED = "was altered"
"""What an error says of a table that another program has dropped or altered."""


def altered_error(connection: Connection) -> sqlite3.DatabaseError | None:
    """Returns an error that names a table that lacks a column; None if all tables are as they were made."""
    query = "SELECT made.name, had.name FROM sqlite_master AS made, pragma_table_info(made.name) AS had"
    with closing(in_memory()) as intact:
        missing = {*intact.execute(query)} - {*connection.execute(query)}
    return sqlite3.DatabaseError(f"its table {min(missing)[0]} {ALTERED}") if missing else None


def in_memory() -> CheckedConnection:
    """Returns a connection to a new database in memory, with the tables."""
    connection = CheckedConnection(":memory:")
    prepare(connection)
    return connection


def mirror(connection: Connection) -> None:
    """Copies the tables of the present state into memory, and keeps the copies up to date with what is written.

    They last as long as the connection, whatever happens to the file: see `copy_state`. What other processes write is
    copied by `mirror_shared`.
    """
    connection.execute("PRAGMA temp_store = MEMORY")
    for table in LIVE_TABLES:
        columns = connection.execute(f"PRAGMA main.table_info({table})").fetchall()
        keys = ", ".join(row[1] for row in columns if row[5])
        connection.execute(f"CREATE TEMP TABLE mirrored_{table} AS SELECT * FROM main.{table}")
        connection.execute(f"CREATE UNIQUE INDEX temp.key_of_{table} ON mirrored_{table} ({keys})")
        delete = f"DELETE FROM mirrored_{table} WHERE ({keys}) ="
        insert = f"INSERT INTO mirrored_{table} VALUES ({_of('NEW', ', '.join(row[1] for row in columns))});"
        for event, row, further in (("INSERT", "NEW", insert), ("UPDATE", "OLD", insert), ("DELETE", "OLD", "")):
            connection.execute(
                f"CREATE TEMP TRIGGER {event}_{table} AFTER {event} ON main.{table} "
                f"BEGIN {delete} ({_of(row, keys)}); {further} END"
            )


def _of(row: str, columns: str) -> str:
    return f"{row}.{columns}".replace(", ", f", {row}.")


def mirror_shared(connection: Connection) -> None:
    """Copies the table that other processes write into memory again, for `mirror`. Call inside a transaction."""
    connection.execute(f"DELETE FROM mirrored_{SHARED_TABLE}")
    connection.execute(f"INSERT INTO mirrored_{SHARED_TABLE} SELECT * FROM main.{SHARED_TABLE}")


def copy_state(source: Connection, target: Connection) -> bool:
    """Copies the present state as `mirror` has it, and the last number of each table; returns whether all was read."""
    try:
        for table in LIVE_TABLES:
            copy_table(source, target, table, f"mirrored_{table}")
        copy_numbers(source, target)
    except sqlite3.Error:
        return False
    return True


def copy_table(source: Connection, target: Connection, table: str, original: str = "") -> None:
    """Copies the rows of a table, or of an `original` with the same columns; those that it refuses are left out."""
    names = [row[1] for row in target.execute(f"PRAGMA table_info({table})")]
    columns = ", ".join(names)
    insert = f"INSERT OR REPLACE INTO {table} ({columns}) VALUES ({', '.join('?' * len(names))})"
    for row in source.execute(f"SELECT {columns} FROM {original or table}"):
        try:
            target.execute(insert, row)
        except sqlite3.IntegrityError:
            pass  # edited by hand


def copy_numbers(source: Connection, target: Connection) -> None:
    """Lets the numbers of rows continue where they are in another database; SQLite gives none that is in use."""
    target.execute("DELETE FROM sqlite_sequence")
    copy_table(source, target, "sqlite_sequence")


def number_from(connection: Connection, number: int) -> None:
    """Makes the numbers of all rows to come continue after `number`, which no row exceeds."""
    connection.execute("DELETE FROM sqlite_sequence")
    query = "SELECT name, ? FROM sqlite_master WHERE type = 'table' AND sql LIKE '%AUTOINCREMENT%'"
    connection.execute(f"INSERT INTO sqlite_sequence {query}", (number,))
