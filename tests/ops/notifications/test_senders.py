"""Each type of target has a sender."""

from __future__ import annotations

import pytest

from robot_health_monitor.ops.configuration import TARGET_TYPES, TargetSettings
from robot_health_monitor.ops.notifications.senders import make_sender


@pytest.mark.parametrize("type_name", [name for name in TARGET_TYPES if name != "heartbeat"])
def test_a_sender_can_be_made_for_each_type_and_contacts_nothing(type_name: str) -> None:
    sender = make_sender(TargetSettings("target", type_name, url="http://host.invalid", command=("horn",)))
    assert sender.place and not sender.warning
    assert (sender.repeat_every_s is not None) == (type_name == "alertmanager")
    sender.close()
