"""The JSON of a notification."""

from __future__ import annotations

import json

from harness.transitions import transition

from robot_health_monitor.core import Level
from robot_health_monitor.core.outlets import json_line
from robot_health_monitor.ops.notifications.notification import Notification, Notified


def test_the_json_is_that_of_the_transition_with_kind_and_time() -> None:
    fields = json.loads(json_line(transition()))
    written = json.loads(Notification(fields, False, 1_700_000_000.5).as_json())
    assert fields["text"] == "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)"
    assert written == {
        **fields,
        "text": f"{fields['robot']}: {fields['text']}",
        "notification": "firing",
        "time": "2023-11-14T22:13:20.500Z",
    }
    resolved = json.loads(Notification(fields, True, 0.0, is_test=True).as_json())
    assert (resolved["notification"], resolved["test"]) == ("resolved", True)


def test_the_text_ends_with_the_hint_also_for_a_notification_stored_by_a_version_without_hints() -> None:
    fields = json.loads(
        json_line(transition(text="battery STALE: silent", robot="r3", hint="no publisher on /battery"))
    )
    written = json.loads(Notification(fields, False, 0.0).as_json())
    assert (written["text"], written["hint"]) == (
        "r3: battery STALE: silent [no publisher on /battery]",
        "no publisher on /battery",
    )
    del fields["hint"]
    assert Notification(fields, False, 0.0).text == "r3: battery STALE: silent"


def test_what_a_target_knows_after_a_notification() -> None:
    notification = Notification(json.loads(json_line(transition(robot="r3"))), False, 12.0)
    text = "r3: battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)"
    assert notification.sent == Notified("r3", "battery_level", Level.WARN, 12.0, text)
