"""What every database that the monitor uses must have: the present run, and the present state of what it watches.

Used by the writer's thread only, inside its transactions.
"""

from __future__ import annotations

from sqlite3 import Connection
from typing import Any, Mapping, Sequence

from ...core.config import template_name
from ...core.nodes.outlets import json_line
from ...core.values import Clock, Level, Transition, package_version, printable
from .queries import configuration
from .queries import transition as stored_transition
from .rows import INSERT_TRANSITION, select

_DELETE_STATE = "DELETE FROM signal_states WHERE robot = ? AND signal = ?"
# Not REPLACE, which would change the indexes, too.
_STORE_STATE = """
    INSERT INTO signal_states (robot, signal, state) VALUES (?, ?, ?)
    ON CONFLICT (robot, signal) DO UPDATE SET state = excluded.state
"""
_STORE_ALERT = """
    INSERT INTO open_alerts
        (robot, signal, alert_id, transition_id, level, begun_s, at_s, fingerprint)
    VALUES (?, ?, ?, ?, ?, ?, ?, ?)
    ON CONFLICT (robot, signal) DO UPDATE SET transition_id = excluded.transition_id, level = excluded.level,
        at_s = excluded.at_s, fingerprint = excluded.fingerprint, transition_json = ''
"""


class PresentRun:
    """The present run with the robots that it watches. It is stored again in each new database."""

    def __init__(self, wall_s: Clock) -> None:
        """Stores nothing before `write`; `wall_s` returns seconds since 1970."""
        self._wall_s = wall_s
        self.id = 0
        self._started_s = 0.0
        self._watches: dict[str, tuple[int, float]] = {}

    def write(self, connection: Connection) -> float:
        """Stores the run in a database that earlier runs may have used; returns the latest time that they knew."""
        now_s = self._wall_s()
        self._started_s = self._started_s or now_s
        last = select(connection, "runs", (float,), "SELECT alive_s FROM runs ORDER BY id DESC LIMIT 1")
        insert = "INSERT OR REPLACE INTO runs (id, started_s, alive_s, version) VALUES (?, ?, ?, ?)"
        row = (self.id or None, self._started_s, now_s, package_version())
        self.id = connection.execute(insert, row).lastrowid or 0
        watches = [(number, self.id, robot, begin_s) for robot, (number, begin_s) in self._watches.items()]
        connection.executemany("INSERT INTO watches (id, run_id, robot, started_s) VALUES (?, ?, ?, ?)", watches)
        return min(last[0][0], now_s) if last else now_s

    def begin_watch(self, connection: Connection, robot: str) -> None:
        """Stores that a robot is watched from now on."""
        now_s = self._wall_s()
        insert = "INSERT INTO watches (run_id, robot, started_s) VALUES (?, ?, ?)"
        self._watches[robot] = connection.execute(insert, (self.id, robot, now_s)).lastrowid or 0, now_s

    def end_watch(self, connection: Connection, robot: str) -> None:
        """Stores that a robot is no longer watched."""
        number, _ = self._watches.pop(robot, (0, 0.0))
        connection.execute("UPDATE watches SET stopped_s = ? WHERE id = ?", (self._wall_s(), number))

    def note_alive(self, connection: Connection, has_stopped: bool = False) -> None:
        """Stores a sign of life of the run, or its end."""
        now_s = self._wall_s()
        update = "UPDATE runs SET alive_s = ?, stopped_s = ? WHERE id = ?"
        connection.execute(update, (now_s, now_s if has_stopped else None, self.id))


def keep_lines(connection: Connection) -> None:
    """Stores the JSON of each open alert that began without notifications; see `keep_line`.

    What to do is that of the configuration in force then.
    """
    query = "SELECT robot, signal, transition_id FROM open_alerts WHERE transition_json = ''"
    for robot, signal, number in connection.execute(query).fetchall():
        stored = stored_transition(connection, number)
        if stored is not None:
            kept = configuration(connection, stored.robot, stored.wall_s) or {}
            settings = kept.get(stored.signal) or kept.get(template_name(stored.signal))
            advice = settings.get("what_to_do") if isinstance(settings, dict) else None
            further = {"what_to_do": printable(advice)} if isinstance(advice, str) else {}
            keep_line(connection, robot, signal, json_line(stored, alert_id=stored.alert_id, **further))


def keep_line(connection: Connection, robot: object, signal: object, line: str) -> None:
    """Stores the JSON of an open alert, which only notifications need: it takes most of the space."""
    connection.execute(
        "UPDATE open_alerts SET transition_json = ? WHERE robot = ? AND signal = ?", (line, robot, signal)
    )


def write_states(connection: Connection, robot: str, states: Mapping[str, str]) -> None:
    """Stores the states of signals of a robot in JSON; `{}` deletes one."""
    for signal, state in states.items():
        if state == "{}":
            connection.execute(_DELETE_STATE, (robot, signal))
        else:
            connection.execute(_STORE_STATE, (robot, signal, state))


def store_transition(
    connection: Connection, row: Sequence[Any], transition: Transition, wall_s: float
) -> tuple[int, int]:
    """Stores a transition, by its row, and that it opens, changes or ends an alert.

    Returns its number, and that of the transition that began the alert.
    """
    name = row[1:3]
    is_ok, is_new = transition.to_level is Level.OK, transition.from_level is Level.OK
    query = "SELECT alert_id FROM open_alerts WHERE robot = ? AND signal = ?"
    known = None if is_new else connection.execute(query, name).fetchone()
    number = connection.execute(INSERT_TRANSITION, (*row[:-1], known and known[0])).lastrowid or 0
    alert = number if known is None else int(known[0])
    if is_ok or (known is None and not transition.repeat):
        connection.execute("DELETE FROM open_alerts WHERE robot = ? AND signal = ?", name)
    if not (is_ok or transition.repeat):
        values = (*name, alert, number, int(transition.to_level), wall_s, wall_s, transition.fingerprint)
        connection.execute(_STORE_ALERT, values)
    return number, alert
