"""`robot-health silence`: the silences in a history file, beside a running monitor or without one."""

from __future__ import annotations

import argparse
import json
import sqlite3
import sys
import time
from typing import Any

from ...core.judge import is_source
from ...core.values import count_text, list_text, printable
from ...ops.store.matchers import parse_matchers
from ...ops.store.queries import configuration
from ...ops.store.recurrence import parse_recurrence
from ...ops.store.silences import (
    Silence,
    add_silence,
    expire_silence,
    open_alerts,
    read_silences,
    silence_json,
    silenced_transitions,
    time_text,
)
from ...runtime.interrupts import Interrupts
from ...runtime.times import iso_time
from ..arguments import Parser, add, duration, identifier
from ..history.history_file import (
    add_author,
    add_history_options,
    author_of,
    change_history,
    history_file,
    reading_history,
)
from ..output.lines import plain_table

_SHOWN_S = 86_400.0
"""How long ago a silence may have ended to be listed without --all."""
_MOST_NAMED = 5
_HEAD = ("id", "state", "open", "alerts", "matchers", "reason", "author")


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Silences suppress notifications only: silenced alerts stay visible, marked as silenced. They are "
        "stored in the history file, where a running monitor finds them within about a second."
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=Parser)
    adding = actions.add_parser(
        "add",
        help="add a silence",
        description="Adds a silence. With --for and --until-resolved it ends with whichever comes first.",
    )
    add(
        adding,
        "MATCHERS",
        "which alerts, such as robot=r3,signal=battery* (labels robot and signal, = and !=, * and ? as in file names)",
    )
    add(adding, "--for TIME", "how long: 30m, 1h30m, 7d", type=duration, dest="for_s")
    add(adding, "--until-resolved", "acknowledge: only the alerts that are open now, each until it resolves")
    add(
        adding,
        "--every RULE",
        'a time that comes again, such as "mon-fri 22:00-06:00" or "20:00-06:00"; an end before the begin is the next '
        "day",
    )
    add(adding, "--timezone ZONE", "of --every, such as Europe/Berlin (default: this machine's)")
    adding.check = _check_end
    lists = actions.add_parser(
        "list",
        help="list silences, and how many alerts each silences",
        description="Lists active silences, and silences that ended within a day. `open`: alerts that it silences now. "
        "`alerts`: those that it has silenced so far.",
    )
    add(lists, "--all", "also those that ended earlier")
    add(lists, "--json", "one JSON object per silence")
    expire = actions.add_parser("expire", help="end silences now", description="Ends silences now.")
    add(expire, "ID...", "as shown by `list`", type=identifier("the id of a silence"), dest="ids")
    for change, why in ((adding, "why, shown with the alerts"), (expire, "why, shown in the history")):
        add(change, "--reason TEXT", why, default="")
        add_author(change)
    for action in (adding, lists, expire):
        add_history_options(action)


def _check_end(arguments: argparse.Namespace) -> str:
    if arguments.timezone is not None and arguments.every is None:
        return "--timezone: expected --every as well"
    is_ended = arguments.for_s is not None or arguments.until_resolved or arguments.every is not None
    return "" if is_ended else "expected --for TIME, --until-resolved or --every RULE, got neither"


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Adds, lists or expires silences; raises ConfigError if the file cannot be used, or what is asked for is wrong."""
    now_s = time.time()
    file = history_file(arguments.history, arguments.ops)
    if arguments.action == "list":
        with reading_history(file) as connection:
            lines = _list(connection, arguments, now_s)
    else:
        change = _add if arguments.action == "add" else _expire
        lines = change_history(file, lambda connection: change(connection, arguments, now_s))
    for line in lines:
        sys.stdout.write(f"{printable(line)}\n")


def _add(connection: sqlite3.Connection, arguments: argparse.Namespace, now_s: float) -> list[str]:
    added = add_silence(
        connection,
        parse_matchers(arguments.matchers),
        now_s,
        for_s=arguments.for_s,
        until_resolved=arguments.until_resolved,
        every=None if arguments.every is None else parse_recurrence(arguments.every, arguments.timezone or ""),
        reason=arguments.reason,
        author=author_of(arguments),
    )
    is_in_force = added.in_force(now_s)
    covered = [alert for alert in open_alerts(connection) if is_in_force and added.covers(*alert)]
    names = list_text([f"{robot} {signal}" for robot, signal in covered], _MOST_NAMED)
    opened = f"{count_text(len(covered), 'open alert')}: {names}" if covered else "no open alert matches now"
    lines = [f"silence {added.id}: {added.matchers}, {_state(added, now_s)}; {opened}"]
    for robot, signal in covered[:_MOST_NAMED]:
        kept = configuration(connection, robot, now_s) or {}
        if is_source(signal) or any(signal in each.get("depends_on", ()) for each in kept.values()):
            lines.append(f"{robot} {signal}: covers the signals that it affects, as long as it lasts")
    known = connection.execute("SELECT robot, signal FROM signal_states")
    if not covered and not any(added.matches(*row) for row in known):
        lines.append(f"so far, no signal in this history matches {added.matchers}")
    return lines


def _list(connection: sqlite3.Connection, arguments: argparse.Namespace, now_s: float) -> list[str]:
    listed = sorted(read_silences(connection), key=lambda each: (not each.is_active(now_s), -each.id))
    if not arguments.all:
        listed = [each for each in listed if each.is_active(now_s) or now_s - each.end_s(now_s) < _SHOWN_S]
    opened = open_alerts(connection)
    rows = []
    for each in listed:
        is_in_force = each.in_force(now_s)
        is_open = sum(is_in_force and each.covers(*alert) for alert in opened)
        rows.append((each, is_open, silenced_transitions(connection, each, now_s)))
    if arguments.json:
        return [json.dumps(_as_json(each, now_s, is_open, alerts)) for each, is_open, alerts in rows]
    if not rows:
        return ["no silences" if arguments.all else "no active silences"]
    shown = [
        (
            str(each.id), _state(each, now_s), str(is_open), str(alerts), each.matchers, each.reason,
            each.author,
        )
        for each, is_open, alerts in rows
    ]  # fmt: skip
    return plain_table([_HEAD, *shown], len(_HEAD))


def _expire(connection: sqlite3.Connection, arguments: argparse.Namespace, now_s: float) -> list[str]:
    lines = []
    for number in arguments.ids:
        expired = expire_silence(connection, number, now_s, reason=arguments.reason, author=author_of(arguments))
        lines.append(f"silence {number} ended: {expired.matchers}")
    return lines


def _state(each: Silence, now_s: float) -> str:
    if not each.is_active(now_s):
        return f"ended {time_text(each.end_s(now_s))}" + (f" by {each.ended_by}" if each.ended_by else "")
    return each.end_text + ("" if each.in_force(now_s) else "; not in force now")


def _as_json(each: Silence, now_s: float, is_open: int, alerts: int) -> dict[str, Any]:
    active = each.is_active(now_s)
    return {
        **silence_json(each, now_s),
        "id": each.id,
        "state": "active" if active else "ended",
        "ended": None if active else iso_time(each.end_s(now_s)),
        "ended_by": each.ended_by,
        "ended_reason": each.ended_reason,
        "open_alerts": is_open,
        "alerts": alerts,
    }
