"""The optional library Apprise, against a real server; and without the library."""

from __future__ import annotations

import importlib.util
import json
import logging
import sys
from pathlib import Path

import pytest
from harness.http_server import HttpServer, responding
from harness.transitions import transition

from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notify.apprise import AppriseTarget
from robot_health_monitor.ops.notify.sender import DeliveryError, Notification

needs_apprise = pytest.mark.skipif(importlib.util.find_spec("apprise") is None, reason="apprise is not installed")

FIELDS = json.loads(json_line(transition(robot="r3")))


def target(tmp_path: Path, *urls: str) -> AppriseTarget:
    file = tmp_path / "mail.url"
    file.write_text("\n".join(urls))
    file.chmod(0o600)
    return AppriseTarget(TargetSettings("mail", "apprise", url_file=str(file)))


@needs_apprise
def test_each_address_of_the_file_receives_the_alert_line(server: HttpServer, tmp_path: Path) -> None:
    url = server.url.replace("http://", "json://")
    mail = target(tmp_path, f"{url}/one/s3cret", "# a comment", f"{url}/two/s3cret")
    assert mail.send(Notification(FIELDS, False, 0.0)) == "delivered"
    first, second = server.next(), server.next()
    assert {first.path, second.path} == {"/one/s3cret", "/two/s3cret"}
    assert first.json["title"] == "r3: battery_level WARN" and first.json["type"] == "warning"
    assert first.json["message"] == "r3: battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)"
    assert mail.place == "json://..." and mail.warning == ""
    mail.send(Notification(FIELDS, True, 0.0, is_test=True))
    received = server.next()
    assert received.json["title"] == "TEST r3: battery_level resolved" and received.json["type"] == "success"


@needs_apprise
def test_a_failure_shows_and_logs_no_secret(
    server: HttpServer, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    server.behave = responding(500)
    with pytest.raises(DeliveryError, match=r"^Apprise could not deliver it to address 1$"):
        target(tmp_path, server.url.replace("http://", "json://alice:s3cret@")).send(Notification(FIELDS, False, 0.0))
    with pytest.raises(DeliveryError, match=r"^Apprise does not accept address 1$") as caught:
        target(tmp_path, "unknown-service://s3cret").send(Notification(FIELDS, False, 0.0))
    assert not caught.value.may_have_arrived
    assert "s3cret" not in caplog.text


@needs_apprise
def test_only_the_addresses_that_failed_are_sent_a_notification_again(server: HttpServer, tmp_path: Path) -> None:
    is_down = True
    server.behave = lambda handler: handler.respond(500 if is_down and handler.path == "/two" else 200)
    url = server.url.replace("http://", "json://")
    mail = target(tmp_path, f"{url}/one", f"{url}/two", "unknown-service://x", f"{url}/four")
    for alert in (FIELDS, {**FIELDS, "signal": "temperature"}):  # a failed notification waits behind other alerts
        with pytest.raises(DeliveryError, match=r"^Apprise could not deliver it to address 2$") as caught:
            mail.send(Notification(alert, False, 0.0))
        assert caught.value.may_have_arrived
        assert [request.path for request in server.all()] == ["/one", "/two", "/four"]
    is_down = False
    with pytest.raises(DeliveryError, match=r"^Apprise does not accept address 3$"):
        mail.send(Notification(FIELDS, False, 0.0))
    assert [request.path for request in server.all()] == ["/two"]


def test_a_missing_library_is_one_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "apprise", None)  # as if it were not installed
    with pytest.raises(DeliveryError, match=r"^apprise is not installed: pip install apprise$") as caught:
        target(tmp_path, "mailtos://s3cret").send(Notification(FIELDS, False, 0.0))
    assert not caught.value.may_have_arrived
