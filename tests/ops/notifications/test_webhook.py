"""A webhook receives the JSON of a notification."""

from __future__ import annotations

import json

from harness.http_server import HttpServer
from harness.transitions import transition

from robot_health_monitor.core.transition_json import json_line
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notifications.notification import Notification
from robot_health_monitor.ops.notifications.webhook import Webhook


def test_a_notification_is_posted_as_json(server: HttpServer) -> None:
    notification = Notification(json.loads(json_line(transition())), False, 0.0)
    webhook = Webhook(TargetSettings("chat", "webhook", url=f"{server.url}/hook"))
    assert webhook.send(notification) == "200 OK"
    received = server.next()
    assert (received.method, received.path) == ("POST", "/hook")
    assert received.body == notification.as_json().encode()
    assert received.json["notification"] == "firing" and received.json["signal"] == "battery_level"
    assert (webhook.place, webhook.warning) == (server.url, "")
