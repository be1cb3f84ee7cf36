"""Sends a test notification to one target, without the queue."""

from __future__ import annotations

import threading
import time
from typing import Callable, Dict, NamedTuple, Optional

from robot_health_monitor.core.formatting import duration_text
from robot_health_monitor.core.model import Level

from ..configuration import TargetSettings
from .alertmanager import ALERT, REPEAT_EVERY_S
from .notification import Notification
from .notifier import make_sender
from .sender import DeliveryError, Sender
from .webhook import HttpTarget

ALERTMANAGER_HOLD_S = 60.0
"""How long a test alert stays at Alertmanager by default, in s: it notifies after its `group_wait`, default 30 s."""


class Trial(NamedTuple):
    """How a target responded to a test."""

    name: str
    """The target's name."""
    succeeded: bool
    text: str
    """One line: where the target is, and its response or the failure. No secrets."""
    warning: str
    """One line about the target that is no failure; empty: none."""


def try_target(
    settings: TargetSettings,
    robot: str,
    hold_s: float = 0.0,
    stop: Optional[threading.Event] = None,
    on_firing: Callable[[str], object] = lambda text: None,
    wall_time_s: Callable[[], float] = time.time,
) -> Trial:
    """Sends a test alert of the target's `min_level` for the signal `test`, then resolves it; calls a heartbeat once.

    Args:
        settings: the target.
        robot: name of the robot in the alert.
        hold_s: for how long the alert stays, in s.
        stop: ends that early.
        on_firing: receives a line that says what to look for, if the alert stays.
        wall_time_s: seconds since 1970.
    """
    target = HttpTarget(settings) if settings.type == "heartbeat" else make_sender(settings, wall_time_s)
    try:
        if not isinstance(target, Sender):
            response = target.deliver(None)
        else:
            begin_s = wall_time_s()
            firing = Notification(_transition(robot, Level.OK, settings.min_level), False, begin_s, is_test=True)
            response = _retry_once(lambda: target.send(firing))
            if hold_s > 0.0:
                on_firing(f"firing: {target.place}: {response}; {_what_to_look_for(settings, firing, hold_s)}")
                _hold(hold_s, stop or threading.Event(), firing, target)
            ended = _transition(robot, settings.min_level, Level.OK)
            at_s = max(wall_time_s(), begin_s)
            target.send(Notification(ended, True, at_s, before=firing.sent, is_test=True))
    except DeliveryError as error:
        return Trial(settings.name, False, f"{target.place}: {error}", target.warning)
    return Trial(settings.name, True, f"{target.place}: {response}", target.warning)


def _what_to_look_for(settings: TargetSettings, firing: Notification, hold_s: float) -> str:
    text = f'look for "{firing.text}"; it is resolved in {duration_text(hold_s)}'
    if settings.type == "alertmanager":
        text += (
            ". Alertmanager notifies after its group_wait (default 30 s), or its group_interval (default 5 min) if the "
            "group has an alert already (then --hold 6m); its page shows "
            f"alertname={ALERT}, robot={firing.robot}, signal=test"
        )
    return text


def _hold(hold_s: float, stop: threading.Event, firing: Notification, target: Sender) -> None:
    """Waits; repeats the alert to a target that needs it.

    Raises:
        DeliveryError: a repetition failed.
    """
    end_s = time.monotonic() + hold_s
    while not stop.is_set() and time.monotonic() < end_s:
        if stop.wait(min(REPEAT_EVERY_S, end_s - time.monotonic())) or time.monotonic() >= end_s:
            return
        if target.repeat_every_s is not None:
            target.send(firing)


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
