"""What every database that the monitor uses must have: the present run, and the present state of what it watches.

It is kept in memory too, so that a new database, in a file or in memory, begins with it whatever became of the old one.
Used by the writer's thread only, inside its transactions.
"""

from __future__ import annotations

from sqlite3 import Connection
from typing import Any, Callable, Dict, Mapping, Sequence, Tuple

from ...core.config.signal_config import template_name
from ...core.nodes.outlets import json_line
from ...core.values.formatting import printable
from ...core.values.model import Level, Transition
from ...core.values.version import package_version
from . import schema
from .queries import configuration
from .queries import transition as stored_transition
from .rows import StoredTransition, select

_Name = Tuple[str, str]
"""Robot and signal."""

# Not REPLACE, which would change the indexes, too.
_STORE_STATE = """
    INSERT INTO signal_states (robot, signal, state) VALUES (?, ?, ?)
    ON CONFLICT (robot, signal) DO UPDATE SET state = excluded.state
"""
_ALERT_COLUMNS = "robot, signal, alert_id, transition_id, level, begun_s, at_s, fingerprint, transition_json"
_STORE_ALERT = f"""
    INSERT INTO open_alerts ({_ALERT_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)
    ON CONFLICT (robot, signal) DO UPDATE SET transition_id = excluded.transition_id, level = excluded.level,
        at_s = excluded.at_s, fingerprint = excluded.fingerprint, transition_json = excluded.transition_json
"""


def alert_json(transition: Transition, alert_id: int, **further: object) -> str:
    """Formats a transition as `--json` does, with its alert and what to do; the form in which notifications wait."""
    if transition.status.what_to_do:
        further["what_to_do"] = transition.status.what_to_do
    return json_line(transition, alert_id=alert_id, **further)


def _past_alert_json(connection: Connection, stored: StoredTransition) -> str:
    """Formats a transition of an earlier run as `alert_json`, with what to do by the configuration in force then."""
    kept = configuration(connection, stored.robot, stored.wall_s) or {}
    settings = kept.get(stored.signal) or kept.get(template_name(stored.signal))
    advice = settings.get("what_to_do") if isinstance(settings, dict) else None
    further = {"what_to_do": printable(advice)} if isinstance(advice, str) else {}
    return json_line(stored, alert_id=stored.alert_id, **further)


class PresentState:
    """The present run with its robots, the states of their signals, and the open alerts."""

    def __init__(self, wall_s: Callable[[], float]) -> None:
        """Knows nothing before `begin` or `write`; `wall_s` returns seconds since 1970."""
        self._wall_s = wall_s
        self.run_id = 0
        self._started_s = 0.0
        self._watches: Dict[str, Tuple[int, float]] = {}
        self._states: Dict[_Name, str] = {}
        self._alerts: Dict[_Name, Tuple[Any, ...]] = {}
        self._keeps_lines = False
        self._last_id = 0

    def begin(self, connection: Connection) -> float:
        """Begins the run in a database that earlier runs may have used; returns the latest time that they knew."""
        self._started_s = self._wall_s()
        last = select(connection, "runs", (float,), "SELECT alive_s FROM runs ORDER BY id DESC LIMIT 1")
        insert = "INSERT INTO runs (started_s, alive_s, version) VALUES (?, ?, ?)"
        row = (self._started_s, self._started_s, package_version())
        self.run_id = connection.execute(insert, row).lastrowid or 0
        query = "SELECT robot, signal, state FROM signal_states"
        for robot, signal, state in select(connection, "signal_states", (str, str, str), query):
            self._states.setdefault((robot, signal), state)
        for alert in connection.execute(f"SELECT {_ALERT_COLUMNS} FROM open_alerts"):
            self._alerts.setdefault(alert[:2], alert)
        return min(last[0][0], self._started_s) if last else self._started_s

    def write(self, connection: Connection, unreadable: Sequence[str]) -> None:
        """Writes all of it into a new database, which has a copy of the tables that were readable."""
        if not self.run_id:
            self.begin(connection)
        row = (self.run_id, self._started_s, self._wall_s(), package_version())
        connection.execute("INSERT OR REPLACE INTO runs (id, started_s, alive_s, version) VALUES (?, ?, ?, ?)", row)
        watches = [(number, self.run_id, robot, begin_s) for robot, (number, begin_s) in self._watches.items()]
        connection.executemany("INSERT INTO watches (id, run_id, robot, started_s) VALUES (?, ?, ?, ?)", watches)
        connection.executemany(_STORE_STATE, [(*name, state) for name, state in self._states.items()])
        if "open_alerts" in unreadable:
            connection.executemany(_STORE_ALERT, self._alerts.values())
        self.continue_numbers(connection)

    def keep_lines(self, connection: Connection) -> None:
        """From now on, stores the JSON of each open alert, which only notifications need: it takes most of the space.

        That of an alert of an earlier run is made from its transition.
        """
        self._keeps_lines = True
        for name, alert in self._alerts.items():
            line = alert[-1]
            stored = None if line else stored_transition(connection, alert[3])
            if stored is not None:
                line = _past_alert_json(connection, stored)
                self._alerts[name] = (*alert[:-1], line)
            update = (
                "UPDATE open_alerts SET transition_json = ? WHERE robot = ? AND signal = ? AND transition_json = ''"
            )
            connection.execute(update, (line, *name))

    def continue_numbers(self, connection: Connection) -> None:
        """Lets the numbers of transitions continue, also in a new file."""
        schema.number_from(connection, self._last_id, "transitions")

    def begin_watch(self, connection: Connection, robot: str) -> None:
        """Stores that a robot is watched from now on."""
        now_s = self._wall_s()
        insert = "INSERT INTO watches (run_id, robot, started_s) VALUES (?, ?, ?)"
        self._watches[robot] = connection.execute(insert, (self.run_id, robot, now_s)).lastrowid or 0, now_s

    def end_watch(self, connection: Connection, robot: str) -> None:
        """Stores that a robot is no longer watched."""
        number, _ = self._watches.pop(robot, (0, 0.0))
        connection.execute("UPDATE watches SET stopped_s = ? WHERE id = ?", (self._wall_s(), number))

    def note_alive(self, connection: Connection, has_stopped: bool = False) -> None:
        """Stores a sign of life of the run, or its end."""
        now_s = self._wall_s()
        update = "UPDATE runs SET alive_s = ?, stopped_s = ? WHERE id = ?"
        connection.execute(update, (now_s, now_s if has_stopped else None, self.run_id))

    def write_states(self, connection: Connection, robot: str, states: Mapping[str, str]) -> None:
        """Stores the states of signals of a robot in JSON; `{}` deletes one."""
        for signal, state in states.items():  # first: a statement may fail
            if state == "{}":
                self._states.pop((robot, signal), None)
            else:
                self._states[robot, signal] = state
        for signal, state in states.items():
            if state == "{}":
                connection.execute("DELETE FROM signal_states WHERE robot = ? AND signal = ?", (robot, signal))
            else:
                connection.execute(_STORE_STATE, (robot, signal, state))

    def alert_of(self, transition: Transition) -> int:
        """Returns the number of the transition that began the alert of this one; 0 if this one begins it."""
        name = printable(transition.robot), printable(transition.signal)
        known = self._alerts.get(name)
        return 0 if known is None or transition.from_level is Level.OK else int(known[2])

    def note_transition(
        self, connection: Connection, number: int, alert: int, transition: Transition, wall_s: float
    ) -> None:
        """Stores that a transition with this number opens, changes or ends an alert (`alert_of`, 0: this one)."""
        self._last_id = max(self._last_id, number)
        name = printable(transition.robot), printable(transition.signal)
        if transition.to_level is Level.OK:
            self._alerts.pop(name, None)
            connection.execute("DELETE FROM open_alerts WHERE robot = ? AND signal = ?", name)
        elif not transition.repeat:
            known = self._alerts.get(name)
            begun_s = known[5] if alert and known is not None else wall_s
            line = alert_json(transition, alert or number)
            row = (*name, alert or number, number, int(transition.to_level), begun_s, wall_s, transition.fingerprint)
            if not alert:
                connection.execute("DELETE FROM open_alerts WHERE robot = ? AND signal = ?", name)
            self._alerts[name] = (*row, line)
            connection.execute(_STORE_ALERT, (*row, line if self._keeps_lines else ""))
