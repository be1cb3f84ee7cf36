"""Notes that people write on alerts. They are kept as long as their alert, and never change what the monitor does.

A note has no number: those of two databases can be joined.
"""

from __future__ import annotations

from sqlite3 import Connection
from typing import NamedTuple

from ...core.values import ConfigError, printable
from .rows import records

MOST_TEXT = 1000
"""Longest note, in characters."""
MOST_AUTHOR = 200
"""Longest name of an author, in characters."""
MOST_NOTES = 20
"""Most notes on one alert."""


class Note(NamedTuple):
    """A note on an alert."""

    transition_id: int
    """Number of the alert's transition."""
    wall_s: float
    """When it was written, in s since 1970."""
    author: str
    """Who wrote it; may be empty."""
    text: str
    """One line."""


def add_note(connection: Connection, alert: int, text: str, author: str, now_s: float) -> Note:
    """Adds a note to the alert with this number, and returns it. Call inside a transaction.

    Line breaks and control characters of the text and the author become blanks. `now_s` is in s since 1970.

    Raises:
        ConfigError: there is no such alert, it has too many notes, or a text is empty or too long.
    """
    note = Note(alert, now_s, _one_line(author), _one_line(text))
    if not 0 < len(note.text) <= MOST_TEXT:
        length = f"{len(note.text)}" if note.text else "none"
        raise ConfigError(f"expected a note of 1 to {MOST_TEXT} characters, got {length}")
    if len(note.author) > MOST_AUTHOR:
        raise ConfigError(f"expected an author of at most {MOST_AUTHOR} characters, got {len(note.author)}")
    if connection.execute("SELECT 1 FROM transitions WHERE id = ?", (alert,)).fetchone() is None:
        raise ConfigError(f"there is no alert {alert} in this history")
    if len(notes_of(connection, alert)) >= MOST_NOTES:
        raise ConfigError(f"alert {alert} has {MOST_NOTES} notes, the largest number")
    connection.execute("INSERT OR IGNORE INTO notes VALUES (?, ?, ?, ?)", note)
    return note


def notes_of(connection: Connection, alert: int) -> list[Note]:
    """Returns the notes on an alert, oldest first."""
    tail = "WHERE transition_id = ? ORDER BY wall_s LIMIT ?"
    notes = records(connection, "notes", Note, tail, (alert, MOST_NOTES))
    return [note._replace(author=printable(note.author), text=printable(note.text)) for note in notes]


def _one_line(text: str) -> str:
    return " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
