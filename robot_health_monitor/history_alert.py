"""A past alert, as a history has it, for its unit test."""

from __future__ import annotations

import math
import sqlite3
from typing import Dict, List, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.kept_settings import read_kept
from robot_health_monitor.core.signal_config import SignalConfig, template_name
from robot_health_monitor.ops.history import queries, samples
from robot_health_monitor.ops.history.rows import StoredTransition

from .alert_attempts import LONGEST_BEFORE_S, SAME_TIME_S, RecordedAlert, Samples, depends_on
from .past_alert import FROM_ALERT, PastAlert, needed_settings

_MOST_BEFORE = 5
_MOST_READ = 500


def history_alert(connection: sqlite3.Connection, number: int) -> PastAlert:
    """Returns the alert with this id.

    Raises:
        ConfigError: there is no such alert, or no test can have its input.
    """
    transition = queries.transition(connection, number)
    if transition is None:
        raise ConfigError(f"there is no alert {number} in this history")
    if transition.repeat:
        raise ConfigError(f"{FROM_ALERT}: {number} repeats an earlier alert; expected the id of that one")
    robot = printable(transition.robot)
    kept = queries.configuration(connection, transition.robot, transition.wall_s)
    if kept is None:
        raise ConfigError(f"{FROM_ALERT}: this history has no configuration of {robot}")
    try:
        signals = read_kept(kept)
    except ConfigError as error:
        raise ConfigError(f"{FROM_ALERT}: the configuration of {robot} cannot be read: {error}") from None
    settings = needed_settings(signals, transition.signal, robot)
    before = [_recorded(connection, each) for each in _before(connection, transition)]
    return PastAlert(
        f"alert {transition.id} of {transition.robot}", transition.text, settings,
        _recorded(connection, transition)._replace(before=before), _others(connection, transition, signals),
    )  # fmt: skip


def _recorded(connection: sqlite3.Connection, transition: StoredTransition) -> RecordedAlert:
    stored = queries.evidence(connection, transition.id)
    return RecordedAlert(
        transition.signal, transition.from_level, transition.to_level, transition.wall_s, transition.value,
        transition.bound, [each for each in stored if math.isfinite(each[0])],
    )  # fmt: skip


def _before(connection: sqlite3.Connection, transition: StoredTransition) -> Sequence[StoredTransition]:
    """Returns some transitions of the signal before this one, oldest first."""
    found: List[StoredTransition] = []
    read = queries.transitions(
        connection,
        robot=transition.robot,  # with a `*` in the names they match others, too
        signal=transition.signal,
        before_id=transition.id,
        newest_first=True,
        limit=_MOST_READ,
    )
    for each in read:
        if (each.robot, each.signal) == (transition.robot, transition.signal) and not each.repeat:
            found.append(each)
        if len(found) == _MOST_BEFORE:
            break
    return found[::-1]


def _others(
    connection: sqlite3.Connection, transition: StoredTransition, signals: Dict[str, SignalConfig]
) -> Dict[str, Samples]:
    """Returns the stored values of the signals that it depends on, 10 s or 5 min apart."""
    found: Dict[str, Samples] = {}
    for name in depends_on(signals[template_name(transition.signal)]):
        other = signals.get(template_name(name))
        if other is not None and other.statistic == "last":
            rows = samples.read(
                connection,
                robot=transition.robot,
                signal=name,
                since_s=transition.wall_s - LONGEST_BEFORE_S,
                until_s=transition.wall_s + SAME_TIME_S,
            )
            named = [each for each in rows if (each.robot, each.signal) == (transition.robot, name)]
            found[name] = [
                (min(each.start_s + each.seconds, transition.wall_s), each.last)
                for each in named
                if each.last is not None
            ]
    return found
