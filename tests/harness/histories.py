"""Histories for tests: transitions, and waiting for the writer's thread."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from harness.waiting import WAIT_S
from robot_health_monitor.core import Level
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.core.values.model import Status, Transition
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store import queries
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.ops.store.history import History


def transition(
    number: int = 0,
    to_level: Level = Level.WARN,
    *,
    from_level: Level = Level.OK,
    robot: str = "r1",
    signal: str = "battery_level",
    **fields: Any,
) -> Transition:
    """Returns a transition whose text contains a number."""
    values = {
        "value": 15.0,
        "statistic": "last",
        "bound": 20.0,
        "now_s": 100.0 + number,
        "since_s": 90.0,
        "fingerprint": "0123456789abcdef",
        "text": f"{signal} {to_level.name}: number {number}",
        "status": Status(signal, to_level, f"number {number}", robot, {}),
        **fields,
    }
    return Transition(signal=signal, robot=robot, from_level=from_level, to_level=to_level, **values)


def opened(file: Path, faults: Faults | None = None, **settings: Any) -> History:
    """Returns an open history in a file."""
    return History(HistorySettings(str(file), **settings), faults=faults)


def texts(history: History) -> list[str]:
    """Returns the texts of all transitions in the database in use, in their order."""
    query = "SELECT text FROM transitions ORDER BY id"
    return [text for (text,) in history.run(lambda connection: connection.execute(query).fetchall(), WAIT_S)]


def stored_texts(file: Path) -> list[str]:
    """Returns the texts of all transitions in a file, in their order."""
    with reading(file) as connection:
        return [each.text for each in queries.transitions(connection)]


def fault_texts(faults: Faults) -> list[tuple[str, str]]:
    """Returns the parts and texts of the faults."""
    return [(part, fault.text) for part, fault in faults.current().items()]
