"""`robot-health note`: a note on a past alert, beside a running monitor or without one."""

from __future__ import annotations

import argparse
import sqlite3
import sys
import time

from ...core.values import printable, with_hint
from ...ops.store import queries
from ...ops.store.notes import MOST_NOTES, MOST_TEXT, add_note
from ...runtime.interrupts import Interrupts
from ..arguments import Parser, add, alert_id
from ..history.history_file import add_author, add_history_options, author_of, change_history, history_file
from ..output.lines import readable


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Writes a note on a past alert into the history file, where the page and `history` show it. The monitor may "
        f"be running. At most {MOST_NOTES} notes per alert."
    )
    add(parser, "ID", "the alert, as `history` shows it: 41 or #41", type=alert_id)
    add(parser, "TEXT", f"one line of at most {MOST_TEXT} characters")
    add_author(parser)
    add_history_options(parser)


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Writes the note, and prints the alert.

    Raises ConfigError if the file cannot be used, there is no such alert, or the note is empty or too long.
    """

    def add_to(connection: sqlite3.Connection) -> str:
        add_note(connection, arguments.id, arguments.text, author_of(arguments), time.time())
        alert = queries.transition(connection, arguments.id)
        return "" if alert is None else f" {alert.robot}: {with_hint(alert.text, alert.hint)}"

    noted = change_history(history_file(arguments.history, arguments.ops), add_to)
    sys.stdout.write(readable(f"{printable(f'note on #{arguments.id}{noted}')}\n", sys.stdout))
