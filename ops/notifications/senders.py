"""Makes the sender for a target of ops.yaml."""

from __future__ import annotations

from typing import Callable, Mapping

from ..configuration import TargetSettings
from .alertmanager import Alertmanager
from .apprise import AppriseTarget
from .command import Command
from .sender import Sender
from .webhook import Webhook

_SENDERS: Mapping[str, Callable[[TargetSettings], Sender]] = {
    "alertmanager": Alertmanager,
    "webhook": Webhook,
    "command": Command,
    "apprise": AppriseTarget,
}


def make_sender(settings: TargetSettings) -> Sender:
    """Returns the sender for a target of any type except `heartbeat`, which sends no alerts."""
    return _SENDERS[settings.type](settings)
