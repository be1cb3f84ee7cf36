"""The state of the monitor itself, as the page, the API, /healthz and the metrics show it.

/diagnostics shows the same: the faults of a robot's monitor in the status of its alert_system, those of the process in
the status of the process.
"""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from robot_health_monitor.core.faults import Fault, summary_of
from robot_health_monitor.core.nodes import AlertSystem

__all__ = ["OwnState"]

Json = Dict[str, Any]


class OwnState:
    """The present faults of a process. May be read in any thread."""

    def __init__(
        self, robots: Callable[[], Sequence[AlertSystem]], process_faults: Callable[[], Mapping[str, Fault]]
    ) -> None:
        """Reads nothing yet.

        Args:
            robots: returns the alert_systems of the robots that are watched now.
            process_faults: returns the faults that belong to no robot, by part.
        """
        self._robots = robots
        self._process_faults = process_faults

    def count(self) -> int:
        """Returns the number of faults."""
        return len(self._faults())

    def texts(self) -> List[str]:
        """Returns a line per fault."""
        return [f"{name}: {fault.text}" for name, (_, _, fault) in self._faults().items()]

    def as_json(self) -> Json:
        """Returns the key `monitor` of `/api/state`."""
        faults = self._faults()
        level, message = summary_of({name: fault for name, (_, _, fault) in faults.items()})
        return {
            "level": level.name,
            "message": message,
            "faults": [
                {"robot": robot, "part": part, "level": fault.level.name, "text": fault.text}
                for robot, part, fault in faults.values()
            ],
        }

    def of_robot(self, robot: AlertSystem) -> Json:
        """Returns the key `monitor` of a robot: the faults of the process concern every robot."""
        level, message = summary_of({**self._process_faults(), **robot.own_faults()})
        return {"level": level.name, "message": message}

    def _faults(self) -> Dict[str, Tuple[Optional[str], str, Fault]]:
        """Returns robot (None: the process), part and fault, by a name for both; those of the process first."""
        robots = self._robots()
        found: Dict[str, Tuple[Optional[str], str, Fault]] = {
            part: (None, part, fault) for part, fault in self._process_faults().items()
        }
        for robot in robots:
            prefix = f"{robot.robot}: " if len(robots) > 1 else ""
            found.update((prefix + part, (robot.robot, part, fault)) for part, fault in robot.own_faults().items())
        return found
