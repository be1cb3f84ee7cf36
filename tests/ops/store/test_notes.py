"""Notes on alerts: what is stored, what is refused, and how long they stay."""

from __future__ import annotations

import sqlite3
from typing import Iterator

import pytest
from harness.histories import transition

from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.notes import Note, add_note, notes_of
from robot_health_monitor.ops.store.rows import INSERT_TRANSITION, CheckedConnection, transition_row


@pytest.fixture
def connection() -> Iterator[sqlite3.Connection]:
    """Returns a history in memory with the alerts 1 and 2."""
    database = CheckedConnection(":memory:")
    schema.prepare(database)
    for number in (1, 2):
        database.execute(INSERT_TRANSITION, transition_row(transition(number), 100.0 + number))
    yield database
    database.close()


def test_notes_belong_to_their_alert_oldest_first(connection: sqlite3.Connection) -> None:
    add_note(connection, 1, "cleaned", "ben", 50.0)
    assert add_note(connection, 1, "blocked", "ana", 40.0) == Note(1, 40.0, "ana", "blocked")
    add_note(connection, 2, "later", "", 60.0)
    assert notes_of(connection, 1) == [Note(1, 40.0, "ana", "blocked"), Note(1, 50.0, "ben", "cleaned")]
    assert notes_of(connection, 2) == [Note(2, 60.0, "", "later")]
    assert notes_of(connection, 3) == []


def test_control_characters_and_line_breaks_become_blanks(connection: sqlite3.Connection) -> None:
    note = add_note(connection, 1, "  two\r\nlines \x1b[31m\u202e\ud800 <b>é 日本</b>\x00 ", "a\tna", 1.0)
    assert (note.text, note.author) == ("two lines [31m <b>é 日本</b>", "a na")
    assert notes_of(connection, 1) == [note]


@pytest.mark.parametrize(
    ("text", "author", "problem"),
    [
        ("", "ana", "expected a note of 1 to 1000 characters, got none"),
        (" \n\t\x07", "ana", "expected a note of 1 to 1000 characters, got none"),
        ("x" * 1001, "ana", "expected a note of 1 to 1000 characters, got 1001"),
        ("x", "y" * 201, "expected an author of at most 200 characters, got 201"),
    ],
)
def test_a_note_is_bounded(connection: sqlite3.Connection, text: str, author: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=f"^{problem}$"):
        add_note(connection, 1, text, author, 1.0)
    add_note(connection, 1, "x" * 1000, "y" * 200, 1.0)


def test_an_alert_that_does_not_exist_has_no_notes(connection: sqlite3.Connection) -> None:
    with pytest.raises(ConfigError, match=r"^there is no alert 3 in this history$"):
        add_note(connection, 3, "text", "ana", 1.0)


def test_an_alert_has_at_most_20_notes(connection: sqlite3.Connection) -> None:
    for number in range(20):
        add_note(connection, 1, f"note {number}", "ana", float(number))
    with pytest.raises(ConfigError, match=r"^alert 1 has 20 notes, the largest number$"):
        add_note(connection, 1, "one more", "ana", 20.0)
    add_note(connection, 2, "of the other", "ana", 20.0)


def test_odd_rows_are_skipped(connection: sqlite3.Connection) -> None:
    for row in ((1, "noon", "ana", "text"), (1, 1e300, "ana", "text"), (1, 1.0, b"\xff", "text"), (1, 2.0, "", b"x")):
        connection.execute("INSERT INTO notes VALUES (?, ?, ?, ?)", row)
    connection.execute("INSERT INTO notes VALUES (1, 3.0, 'an\x1ba', 'be\u202ell')")
    assert notes_of(connection, 1) == [Note(1, 3.0, "an?a", "be?ll")]
    assert isinstance(connection, CheckedConnection)
    assert connection.skipped_text.endswith("(notes 1)")


def test_notes_that_two_processes_wrote_at_the_same_time_are_all_kept(connection: sqlite3.Connection) -> None:
    """The monitor writes into memory while its disk fails, and the command line into the file."""
    file = CheckedConnection(":memory:")
    schema.prepare(file)
    for table in ("transitions", "notes"):
        schema.copy_table(connection, file, table)
    from_page = add_note(connection, 1, "from the page", "ana", 5.0)
    from_command = add_note(file, 1, "from the command line", "ben", 5.0)
    schema.copy_table(connection, file, "notes")
    assert sorted(notes_of(file, 1)) == [from_page, from_command]
    file.close()
