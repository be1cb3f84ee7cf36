"""A webhook, one HTTP request against a real server, and responses of any target over HTTP."""

from __future__ import annotations

import base64
import json
import os
import socket
import ssl
import threading
from pathlib import Path

import pytest
import trustme
from harness.http_server import (
    Behaviour,
    Handler,
    HttpServer,
    closing_at_once,
    dripping,
    flooding,
    garbling,
    hanging,
    redirecting_to_itself,
    responding,
)
from harness.reserved import free_port
from harness.transitions import transition

from robot_health_monitor.cli.commands.notify_command import try_target
from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notify.sender import DeliveryError, Notification
from robot_health_monitor.ops.notify.webhook import Webhook, request


@pytest.mark.parametrize("status", [200, 201, 202, 204])
def test_success(server: HttpServer, status: int) -> None:
    server.behave = responding(status)
    assert Webhook(TargetSettings("chat", "webhook", url=server.url)).deliver("{}").startswith(str(status))


@pytest.mark.parametrize(
    ("status", "is_refused"),
    [(400, True), (401, True), (404, True), (410, True), (408, False), (429, False), (500, False), (503, False)],
)
def test_only_4xx_is_a_refusal_except_408_and_429(server: HttpServer, status: int, is_refused: bool) -> None:
    server.behave = responding(status, Retry_After="7")
    with pytest.raises(DeliveryError) as caught:
        Webhook(TargetSettings("chat", "webhook", url=server.url)).deliver("{}")
    assert (caught.value.is_refused, caught.value.may_have_arrived) == (is_refused, True)
    assert caught.value.retry_after_s == 7.0


def test_a_redirect_is_reported_and_retried(server: HttpServer) -> None:
    server.behave = redirecting_to_itself
    with pytest.raises(DeliveryError, match=r"^response 302 Found; redirects are not followed$") as caught:
        Webhook(TargetSettings("chat", "webhook", url=server.url)).deliver("{}")
    assert not caught.value.is_refused


def test_nothing_of_a_secret_address_is_shown(server: HttpServer, tmp_path: Path) -> None:
    file = tmp_path / "chat.url"
    file.write_text(f"{server.url}/hooks/s3cret")
    target = Webhook(TargetSettings("chat", "webhook", url_file=str(file)))
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
def test_the_reason_that_a_server_gives_is_not_shown(server: HttpServer, status: int, shown: str) -> None:
    server.behave = giving_reason(status, "no such page: /hooks/s3cret")
    with pytest.raises(DeliveryError, match=rf"^response {shown}(; redirects are not followed)?$"):
        Webhook(TargetSettings("chat", "webhook", url=server.url)).deliver("{}")


def test_the_reason_of_a_success_is_not_shown_either(server: HttpServer) -> None:
    server.behave = giving_reason(200, "thanks for /hooks/s3cret")
    for kind in ("webhook", "alertmanager"):
        text = try_target(TargetSettings("chat", kind, url=server.url), "r3").text
        assert text.startswith(f"{server.url}: 200 OK; 2 messages sent: ")


def test_a_path_is_appended_once(server: HttpServer) -> None:
    for url in ("", "/", "/api/v2/alerts", "/am/"):
        Webhook(TargetSettings("pager", "alertmanager", url=server.url + url)).call("[]", "/api/v2/alerts")
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


TIMEOUT_S = 20.0
SHORT_S = 0.3


def test_a_post_carries_json_and_returns_the_status(server: HttpServer) -> None:
    answer = request(f"{server.url}/hook?key=1", b'{"a": 1}', TIMEOUT_S)
    assert answer.status == 200
    received = server.next()
    assert (received.method, received.path, received.json) == ("POST", "/hook?key=1", {"a": 1})
    assert received.headers["Content-Type"] == "application/json"


def test_without_a_body_it_is_a_get(server: HttpServer) -> None:
    request(server.url, None, TIMEOUT_S)
    assert server.next().method == "GET"


def test_a_user_and_password_become_basic_authentication(server: HttpServer) -> None:
    request(server.url.replace("//", "//al%40ice:s3cret@"), b"{}", TIMEOUT_S)
    scheme, _, credentials = server.next().headers["Authorization"].partition(" ")
    assert (scheme, base64.b64decode(credentials)) == ("Basic", b"al@ice:s3cret")


@pytest.mark.parametrize("behaviour", [hanging, dripping])
def test_the_limit_holds_for_the_whole_request(server: HttpServer, behaviour: Behaviour) -> None:
    server.behave = behaviour
    with pytest.raises(DeliveryError, match=r"^no response within 0\.3 s$") as caught:
        request(server.url, b"{}", SHORT_S)
    assert caught.value.may_have_arrived and not caught.value.is_refused


def test_a_response_without_end_is_not_read_to_its_end(server: HttpServer) -> None:
    server.behave = flooding
    assert request(server.url, b"{}", TIMEOUT_S).status == 500


def test_redirects_are_not_followed(server: HttpServer) -> None:
    server.behave = redirecting_to_itself
    assert request(server.url, b"{}", TIMEOUT_S).status == 302
    assert len(server.all()) == 1


@pytest.mark.parametrize(
    ("behaviour", "text"),
    [
        (closing_at_once, "Remote end closed connection without response"),
        (garbling, "the response is not HTTP (BadStatusLine)"),
    ],
)
def test_a_response_that_is_none_is_a_failure(server: HttpServer, behaviour: Behaviour, text: str) -> None:
    server.behave = behaviour
    with pytest.raises(DeliveryError) as caught:
        request(server.url, b"{}", TIMEOUT_S)
    assert str(caught.value) == text and caught.value.may_have_arrived


def test_a_refused_connection_certainly_did_not_deliver() -> None:
    with pytest.raises(DeliveryError, match=r"^Connection refused$") as caught:
        request(f"http://127.0.0.1:{free_port()}", b"{}", TIMEOUT_S)
    assert not caught.value.may_have_arrived


def test_a_host_that_does_not_exist_is_named_as_the_cause() -> None:
    with pytest.raises(DeliveryError, match=r"^(Name|Temporary failure in name|No address)") as caught:
        request("http://robot.invalid", b"{}", TIMEOUT_S)
    assert not caught.value.may_have_arrived


def test_a_certificate_that_is_not_trusted_is_refused(tmp_path: Path) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    trustme.CA().issue_cert("127.0.0.1").configure_cert(context)
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept() -> None:
            connection, _ = listener.accept()
            with connection:
                try:
                    context.wrap_socket(connection, server_side=True)
                except OSError:
                    pass  # the client refuses the certificate

        thread = threading.Thread(target=accept)
        thread.start()
        with pytest.raises(DeliveryError, match=r"certificate verify failed") as caught:
            request(f"https://127.0.0.1:{listener.getsockname()[1]}/secret", b"{}", TIMEOUT_S)
        thread.join()
    assert not caught.value.may_have_arrived and "secret" not in str(caught.value)


def test_https_works_with_a_trusted_certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    authority = trustme.CA()
    authority.cert_pem.write_to_path(str(tmp_path / "ca.pem"))
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "ca.pem"))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert("127.0.0.1").configure_cert(context)
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            connection, _ = listener.accept()
            with context.wrap_socket(connection, server_side=True) as secured:
                received = piece = secured.recv(65536)
                while piece and not received.endswith(b"{}"):  # the body may come after the head
                    piece = secured.recv(65536)
                    received += piece
                secured.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")

        thread = threading.Thread(target=serve)
        thread.start()
        assert request(f"https://127.0.0.1:{listener.getsockname()[1]}/", b"{}", TIMEOUT_S).status == 204
        thread.join()


def test_the_proxy_of_the_environment_is_used(server: HttpServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", server.url)
    assert request("http://chat.invalid/hook", b"{}", TIMEOUT_S).status == 200
    assert server.next().path == "http://chat.invalid/hook"


def test_the_user_of_a_proxy_is_sent_to_it_and_the_requested_host_is_named(
    server: HttpServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("http_proxy", server.url.replace("//", "//ana:s3cret@"))
    assert request("http://chat.invalid:81/hook?a=1", None, TIMEOUT_S).status == 200
    found = server.next()
    assert (found.path, found.headers["Host"]) == ("http://chat.invalid:81/hook?a=1", "chat.invalid:81")
    assert base64.b64decode(found.headers["Proxy-Authorization"].partition(" ")[2]) == b"ana:s3cret"
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    assert request(f"{server.url}/direct", None, TIMEOUT_S).status == 200
    assert server.next().path == "/direct"


def test_https_goes_through_a_tunnel_of_the_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                while not b"".join(received).endswith(b"\r\n\r\n"):
                    received.append(connection.recv(65536))
                connection.sendall(b"HTTP/1.1 403 not allowed\r\n\r\n")

        thread = threading.Thread(target=serve)
        thread.start()
        monkeypatch.setenv("https_proxy", f"http://ana:s3cret@127.0.0.1:{listener.getsockname()[1]}")
        with pytest.raises(DeliveryError, match=r"^Tunnel connection failed: 403 not allowed$") as caught:
            request("https://chat.invalid/hook/secret", b"{}", TIMEOUT_S)
        thread.join()
    head = b"".join(received)
    assert head.startswith(b"CONNECT chat.invalid:443 HTTP/1.")
    assert b"Proxy-Authorization: Basic YW5hOnMzY3JldA==\r\n" in head and b"hook" not in head
    assert not caught.value.may_have_arrived


def test_the_servers_clock_and_requested_wait_are_read(server: HttpServer) -> None:
    # BaseHTTPRequestHandler sends its own Date first; the last one counts.
    server.behave = responding(429, Retry_After="17", Date="Thu, 01 Jan 1970 00:01:40 GMT")
    answer = request(server.url, b"{}", TIMEOUT_S)
    assert (answer.date_s, answer.retry_after_s) == (100.0, 17.0)
    server.behave = responding(503, Retry_After="9" * 30, Date="yesterday")
    answer = request(server.url, b"{}", TIMEOUT_S)
    assert (answer.date_s, answer.retry_after_s) == (None, 3600.0)


@pytest.mark.parametrize("wait", ["soon", "-5", "Thu, 01 Jan 1970 00:02:10 GMT"])
def test_a_requested_wait_that_is_no_number_of_seconds_is_ignored(server: HttpServer, wait: str) -> None:
    server.behave = responding(503, Retry_After=wait)
    assert request(server.url, b"{}", TIMEOUT_S).retry_after_s == 0.0


def test_no_file_descriptor_is_left_open(server: HttpServer) -> None:
    def open_files() -> int:
        return len([name for name in os.listdir("/proc/self/fd") if _is_client_socket(int(name), server)])

    server.behave = hanging
    for _ in range(3):
        with pytest.raises(DeliveryError):
            request(server.url, b"{}", 0.05)
    server.behave = flooding
    request(server.url, b"{}", TIMEOUT_S)
    assert open_files() == 0


def _is_client_socket(number: int, server: HttpServer) -> bool:
    try:
        with socket.socket(fileno=os.dup(number)) as found:
            return found.family == socket.AF_INET and f"http://127.0.0.1:{found.getpeername()[1]}" == server.url
    except OSError:
        return False
