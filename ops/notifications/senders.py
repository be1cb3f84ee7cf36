"""Makes the sender for a target of ops.yaml."""

from __future__ import annotations

import time
from typing import Callable, Mapping

from ..configuration import TargetSettings
from .alertmanager import Alertmanager
from .apprise import AppriseTarget
from .command import Command
from .sender import Sender
from .webhook import Webhook

_SENDERS: Mapping[str, Callable[[TargetSettings], Sender]] = {
    "webhook": Webhook,
    "command": Command,
    "apprise": AppriseTarget,
}


def make_sender(settings: TargetSettings, wall_time_s: Callable[[], float] = time.time) -> Sender:
    """Returns the sender for a target of any type except `heartbeat`, which sends no alerts.

    Args:
        settings: the target.
        wall_time_s: seconds since 1970.
    """
    if settings.type == "alertmanager":
        return Alertmanager(settings, wall_time_s)
    return _SENDERS[settings.type](settings)
