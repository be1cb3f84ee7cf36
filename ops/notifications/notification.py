"""What a target is sent about one alert: that it is open (firing), or that it ended (resolved)."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Mapping, Optional

from robot_health_monitor.core.formatting import with_hint
from robot_health_monitor.core.model import Level
from robot_health_monitor.runtime.times import utc_text


@dataclass(frozen=True)
class Notified:
    """What a target was last sent about an alert that is open there."""

    robot: str
    signal: str
    level: Level
    since_s: float
    """Wall time at which the level began, in s since 1970."""
    text: str
    """The alert line, after the name of the robot."""


@dataclass(frozen=True)
class Notification:
    """One message to one target."""

    transition: Mapping[str, Any] = field(hash=False)
    """The transition, with the fields of `--json`."""
    is_resolved: bool
    """True: the alert has ended, or is below the target's `min_level`."""
    at_s: float
    """Wall time of the transition, in s since 1970."""
    before: Optional[Notified] = None
    """What the target was last sent about this alert; None: nothing that is still open."""
    is_test: bool = False
    """Sent by `robot-health notify`."""

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return str(self.transition["robot"])

    @property
    def signal(self) -> str:
        """Name of the signal."""
        return str(self.transition["signal"])

    @property
    def level(self) -> Level:
        """The level after the transition."""
        return Level[self.transition["to_level"]]

    @property
    def text(self) -> str:
        """The alert line with its hint, after the name of the robot: many robots may share a channel."""
        return alert_line(self.transition)

    @property
    def sent(self) -> Notified:
        """What the target knows once it has received this."""
        return Notified(self.robot, self.signal, self.level, self.at_s, self.text)

    def as_json(self) -> str:
        """Formats the transition as `--json` does, but for `text`, and with `notification`, `time` (UTC) and `test`."""
        kind = "resolved" if self.is_resolved else "firing"
        fields = {**self.transition, "text": self.text, "notification": kind, "time": utc_text(self.at_s)}
        return json.dumps({**fields, "test": True} if self.is_test else fields)


def alert_line(transition: Mapping[str, Any]) -> str:
    """Returns the line of a transition, with its hint, after the name of its robot. Older files have no hint.

    >>> alert_line({"robot": "husky1", "text": "link ERROR: down: refused (was OK for 2 h)"})
    'husky1: link ERROR: down: refused (was OK for 2 h)'
    """
    return f"{transition['robot']}: {with_hint(str(transition['text']), str(transition.get('hint', '')))}"
