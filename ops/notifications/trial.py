"""Sends a test notification to one target, without the queue."""

from __future__ import annotations

import time
from typing import Callable, Dict, NamedTuple

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level

from ..configuration import TargetSettings
from .heartbeat import Heartbeat
from .notification import Notification
from .sender import DeliveryError
from .senders import make_sender


class Trial(NamedTuple):
    """How a target responded to a test."""

    name: str
    """The target's name."""
    succeeded: bool
    text: str
    """One line: where the target is, and its response or the failure. No secrets."""
    warning: str
    """One line about the target that is no failure; empty: none."""


def try_target(settings: TargetSettings, robot: str, wall_time_s: Callable[[], float] = time.time) -> Trial:
    """Sends a test alert of the target's `min_level` for the signal `test`, then its end; calls a heartbeat once.

    Args:
        settings: the target.
        robot: name of the robot in the alert.
        wall_time_s: seconds since 1970.
    """
    target = Heartbeat(settings, Faults()) if settings.type == "heartbeat" else make_sender(settings, wall_time_s)
    try:
        if isinstance(target, Heartbeat):
            response = target.deliver(None)
        else:
            begin_s = wall_time_s()
            firing = Notification(_transition(robot, Level.OK, settings.min_level), False, begin_s, is_test=True)
            response = _retry_once(lambda: target.send(firing))
            ended = _transition(robot, settings.min_level, Level.OK)
            at_s = max(wall_time_s(), begin_s)
            target.send(Notification(ended, True, at_s, before=firing.sent, is_test=True))
    except DeliveryError as error:
        return Trial(settings.name, False, f"{target.place}: {error}", target.warning)
    return Trial(settings.name, True, f"{target.place}: {response}", target.warning)


def _retry_once(send: Callable[[], str]) -> str:
    """Sends, and again if the target's first response corrected something on this side, such as the clock."""
    try:
        return send()
    except DeliveryError as error:
        if not error.is_corrected:
            raise
        return send()


def _transition(robot: str, from_level: Level, to_level: Level) -> Dict[str, object]:
    """Returns a transition with the fields of `--json`."""
    return {
        "signal": "test",
        "from_level": from_level.name,
        "to_level": to_level.name,
        "value": None,
        "statistic": "last",
        "bound": None,
        "now_s": 0.0,
        "since_s": 0.0,
        "robot": robot,
        "fingerprint": "0" * 16,
        "text": f"test {to_level.name}: test notification of robot-health notify, nothing is wrong",
        "statistics": {},
        "repeat": False,
        "hint": "",
    }
