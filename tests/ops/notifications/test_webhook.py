"""A webhook, and responses of any target over HTTP: which are success, which are retried, and what is shown of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from harness.http_server import Behaviour, Handler, HttpServer, redirecting_to_itself, responding
from harness.transitions import transition

from robot_health_monitor.core.outlets import json_line
from robot_health_monitor.notify_command import try_target
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notifications.notification import Notification
from robot_health_monitor.ops.notifications.sender import DeliveryError
from robot_health_monitor.ops.notifications.webhook import HttpTarget, Webhook


@pytest.mark.parametrize("status", [200, 201, 202, 204])
def test_success(server: HttpServer, status: int) -> None:
    server.behave = responding(status)
    assert HttpTarget(TargetSettings("chat", "webhook", url=server.url)).deliver("{}").startswith(str(status))


@pytest.mark.parametrize(
    ("status", "is_refused"),
    [(400, True), (401, True), (404, True), (410, True), (408, False), (429, False), (500, False), (503, False)],
)
def test_only_4xx_is_a_refusal_except_408_and_429(server: HttpServer, status: int, is_refused: bool) -> None:
    server.behave = responding(status, Retry_After="7")
    with pytest.raises(DeliveryError) as caught:
        HttpTarget(TargetSettings("chat", "webhook", url=server.url)).deliver("{}")
    assert (caught.value.is_refused, caught.value.may_have_arrived) == (is_refused, True)
    assert caught.value.retry_after_s == 7.0


def test_a_redirect_is_reported_and_retried(server: HttpServer) -> None:
    server.behave = redirecting_to_itself
    with pytest.raises(DeliveryError, match=r"^response 302 Found; redirects are not followed$") as caught:
        HttpTarget(TargetSettings("chat", "webhook", url=server.url)).deliver("{}")
    assert not caught.value.is_refused


def test_nothing_of_a_secret_address_is_shown(server: HttpServer, tmp_path: Path) -> None:
    file = tmp_path / "chat.url"
    file.write_text(f"{server.url}/hooks/s3cret")
    target = HttpTarget(TargetSettings("chat", "webhook", url_file=str(file)))
    server.behave = responding(404, b"no such page: /hooks/s3cret")
    with pytest.raises(DeliveryError, match=r"^response 404 Not Found$"):
        target.deliver("{}")
    assert server.next().path == "/hooks/s3cret" and target.place == server.url


def giving_reason(status: int, reason: str) -> Behaviour:
    def behave(handler: Handler) -> None:
        handler.send_response(status, reason)
        handler.send_header("Content-Length", "0")
        handler.end_headers()

    return behave


@pytest.mark.parametrize(("status", "shown"), [(404, "404 Not Found"), (499, "499"), (301, "301 Moved Permanently")])
def test_the_servers_reason_is_not_shown_if_the_address_is_secret(
    server: HttpServer, tmp_path: Path, status: int, shown: str
) -> None:
    server.behave = giving_reason(status, "no such page: /hooks/s3cret")
    file = tmp_path / "chat.url"
    file.write_text(f"{server.url}/hooks/s3cret")
    secret = HttpTarget(TargetSettings("chat", "webhook", url_file=str(file)))
    with pytest.raises(DeliveryError, match=rf"^response {shown}(; redirects are not followed)?$"):
        secret.deliver("{}")
    known = HttpTarget(TargetSettings("chat", "webhook", url=server.url))
    with pytest.raises(DeliveryError, match=rf"^response {status} no such page: /hooks/s3cret"):
        known.deliver("{}")


def test_the_reason_of_a_success_is_not_shown_either(server: HttpServer, tmp_path: Path) -> None:
    server.behave = giving_reason(200, "thanks for /hooks/s3cret")
    file = tmp_path / "chat.url"
    file.write_text(f"{server.url}/hooks/s3cret")
    for kind in ("webhook", "alertmanager"):
        assert try_target(TargetSettings("chat", kind, url_file=str(file)), "r3").text == f"{server.url}: 200 OK"


def test_a_path_is_appended_once(server: HttpServer) -> None:
    for url in ("", "/", "/api/v2/alerts", "/am/"):
        HttpTarget(TargetSettings("pager", "alertmanager", url=server.url + url)).call("[]", "/api/v2/alerts")
    assert [request.path for request in server.all()] == ["/api/v2/alerts"] * 3 + ["/am/api/v2/alerts"]


def test_a_notification_is_posted_as_json(server: HttpServer) -> None:
    notification = Notification(json.loads(json_line(transition())), False, 0.0)
    webhook = Webhook(TargetSettings("chat", "webhook", url=f"{server.url}/hook"))
    assert webhook.send(notification) == "200 OK"
    received = server.next()
    assert (received.method, received.path) == ("POST", "/hook")
    assert received.body == notification.as_json().encode()
    assert received.json["notification"] == "firing" and received.json["signal"] == "battery_level"
    assert (webhook.place, webhook.warning) == (server.url, "")
