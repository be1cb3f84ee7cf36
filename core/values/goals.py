"""The goals of an action, as its server publishes their states: action_msgs and actionlib_msgs GoalStatusArray."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Mapping

STATUS_TOPICS = ("/_action/status", "/status")
"""Topics of the states below an action's name: that of ROS 2 and that of ROS 1."""

STATUS_TYPES = ("action_msgs/GoalStatusArray", "actionlib_msgs/GoalStatusArray")
"""Their types."""

MOST_GOALS = 1000
"""Most goals of one action that are remembered; the server lists them until some seconds after their end."""

_SUCCEEDED, _ABORTED = 0.0, 1.0
_ENDS_OF_ROS2: Mapping[int, float | None] = {4: _SUCCEEDED, 5: None, 6: _ABORTED}
"""action_msgs/GoalStatus: SUCCEEDED, CANCELED, ABORTED."""
_ENDS_OF_ROS1: Mapping[int, float | None] = {
    2: None, 3: _SUCCEEDED, 4: _ABORTED, 5: _ABORTED, 8: None, 9: _ABORTED
}  # fmt: skip
"""actionlib_msgs/GoalStatus: PREEMPTED, SUCCEEDED, ABORTED, REJECTED, RECALLED, LOST."""


class Goals:
    """Finds the goals that end: each counts once. Those that had ended in the first message do not count."""

    def __init__(self) -> None:
        """Knows no goal."""
        self._has_begun = False
        self._ended: dict[str, None] = {}
        """The goals that have ended; the one that was listed longest ago comes first."""

    def take(self, message: Any) -> list[float]:
        """Returns a sample for each goal that has ended since the last message: 0 succeeded, 1 aborted.

        A message of another type has none. Of a longer list than `MOST_GOALS`, the newest goals are read: the last.
        """
        listed = message.get("status_list") if isinstance(message, Mapping) else None
        if not isinstance(listed, list):
            return []
        samples: list[float] = []
        for entry in listed[-MOST_GOALS:]:
            with suppress(KeyError, TypeError):  # also of a goal that has not ended
                is_ros2 = "goal_info" in entry
                goal = str(entry["goal_info"]["goal_id"]["uuid"] if is_ros2 else entry["goal_id"]["id"])[:200]
                end = (_ENDS_OF_ROS2 if is_ros2 else _ENDS_OF_ROS1)[entry["status"]]
                if end is not None and self._has_begun and goal not in self._ended:
                    samples.append(end)
                self._ended.pop(goal, None)
                self._ended[goal] = None
        self._has_begun = True
        while len(self._ended) > MOST_GOALS:
            del self._ended[next(iter(self._ended))]
        return samples
