"""Target `webhook`: posts each notification as JSON. Also what all targets over HTTP have in common.

A request is bounded in time and size, whatever the server does. The proxy variables of the environment (`http_proxy`,
`https_proxy`, `no_proxy`) are respected. Redirects are not followed: the address, which may contain a secret, goes to
the configured host only. Standard library only: aiohttp would take 16 MB more, also on robots that serve no page.
"""

from __future__ import annotations

import base64
import contextlib
import email.utils
import http.client
import socket
import threading
import time
import urllib.request
from typing import NamedTuple, Sequence
from urllib.parse import SplitResult, unquote, urlsplit, urlunsplit

from ...core.values import duration_text, package_version, printable
from .sender import DeliveryError, Notification, Sender

_RETRIED = (408, 429)  # temporary: Request Timeout, Too Many Requests
_MOST_SHOWN = 200  # characters of an error

LONGEST_WAIT_S = 3600.0
"""Longest wait that a server may request, in s: a target cannot keep alerts back for longer."""


class Answer(NamedTuple):
    """The response of a server, without its body."""

    status: int
    date_s: float | None  # the server's clock, in s since 1970; None if it does not state it
    retry_after_s: float  # wait that the server requests, in s; 0 if it requests none


class Webhook(Sender):
    """Posts the JSON of `--json`, with the fields `notification` (firing or resolved) and `time`."""

    def send(self, notification: Notification) -> str:
        """Posts a notification."""
        return self.deliver(notification.as_json())

    def repeat(self, alerts: Sequence[Notification]) -> None:
        """Calls the address of a heartbeat."""
        self.deliver(None)

    def call(self, body: str | None, path: str = "") -> Answer:
        """Returns the response to `request`, with a path appended to the address."""
        url = self.http_address()
        if path:
            url = url.rstrip("/")
            url = url if url.endswith(path) else url + path
        return request(url, None if body is None else body.encode(), self._settings.timeout_s)

    def deliver(self, body: str | None) -> str:
        """Sends a request, as `call`, and returns the status of its response, as `status_of`."""
        return self.status_of(self.call(body))

    def status_of(self, answer: Answer) -> str:
        """Returns the status of a response; raises DeliveryError if that is not success (2xx)."""
        status = answer.status
        # Not what the server says about it, which may repeat a secret of the address.
        title = f"{status} {http.client.responses.get(status, '')}".strip()
        if 200 <= status < 300:
            return title
        text = f"response {title}"
        if 300 <= status < 400:
            text += "; redirects are not followed"
        if answer.retry_after_s:
            text += f"; the server asks to wait {duration_text(answer.retry_after_s)}"
        is_refused = 400 <= status < 500 and status not in _RETRIED
        raise DeliveryError(text, is_refused=is_refused, retry_after_s=answer.retry_after_s)


def request(url: str, body: bytes | None, timeout_s: float) -> Answer:
    """Sends JSON (POST), or nothing (GET), and returns the response, of any status.

    A user and password in the address are sent as basic authentication. The time limit in s is for everything; only
    the resolution of a host name may take longer. Raises DeliveryError, without the address, if there is no response.
    """
    deadline_s, parts = time.monotonic() + timeout_s, urlsplit(url)
    headers = {
        "User-Agent": f"robot-health/{package_version()}",
        "Accept": "*/*",
        **_credentials("Authorization", parts),
    }
    if body is not None:
        headers["Content-Type"] = "application/json"
    connection, target = _connection(parts, timeout_s, headers)
    try:
        connection.connect()
    except Exception as error:  # the text of some exceptions contains the address, here and below
        problem = _problem(error, "no connection", timeout_s)
        raise DeliveryError(problem, may_have_arrived=False) from None
    # A socket's own limit begins again with every byte.
    guard = threading.Timer(max(0.0, deadline_s - time.monotonic()), _end_at_once, (connection.sock,))
    guard.daemon = True
    guard.start()
    try:
        connection.request("GET" if body is None else "POST", target, body, headers)
        response = connection.getresponse()
        if time.monotonic() >= deadline_s:  # its head may end where the guard cut it off
            raise TimeoutError
        wait = response.headers.get("retry-after", "")  # a date, which RFC 9110 also allows, is ignored
        wait_s = float(min(int(wait[:10]), LONGEST_WAIT_S)) if wait.isascii() and wait.isdigit() else 0.0
        return Answer(response.status, _date_s(response.headers.get("date", "")), wait_s)
    except Exception as error:
        reason = TimeoutError() if time.monotonic() >= deadline_s else error
        raise DeliveryError(_problem(reason, "no response", timeout_s)) from None
    finally:
        guard.cancel()
        connection.close()


def _connection(
    parts: SplitResult, timeout_s: float, headers: dict[str, str]
) -> tuple[http.client.HTTPConnection, str]:
    """Returns a connection to an address, through the proxy of the environment, and what to request there."""
    host, is_tls = parts.netloc.rpartition("@")[2], parts.scheme == "https"
    proxy = "" if urllib.request.proxy_bypass(host) else urllib.request.getproxies().get(parts.scheme, "")
    via = urlsplit(proxy if "://" in proxy else f"http://{proxy}") if proxy else parts
    kind = http.client.HTTPSConnection if is_tls else http.client.HTTPConnection
    connection = kind(via.hostname or "", via.port, timeout=timeout_s)
    target = urlunsplit(("", "", parts.path or "/", parts.query, ""))
    if proxy and is_tls:
        connection.set_tunnel(parts.hostname or "", parts.port, _credentials("Proxy-Authorization", via))
    elif proxy:
        headers.update(_credentials("Proxy-Authorization", via))
        target = f"http://{host}{target}"
    return connection, target


def _credentials(header: str, parts: SplitResult) -> dict[str, str]:
    """Returns the header of basic authentication for the user and password of an address; empty if it has none."""
    if "@" not in parts.netloc:
        return {}
    user = f"{unquote(parts.username or '')}:{unquote(parts.password or '')}"
    return {header: f"Basic {base64.b64encode(user.encode()).decode()}"}


def _end_at_once(sock: socket.socket) -> None:
    with contextlib.suppress(OSError):  # it has been closed
        sock.shutdown(socket.SHUT_RDWR)


def _date_s(text: str) -> float | None:
    try:
        return email.utils.parsedate_to_datetime(text).timestamp()
    except (TypeError, ValueError, IndexError, OverflowError):
        return None


def _problem(error: object, on_timeout: str, timeout_s: float) -> str:
    """Describes an exception, without the address: the texts of other classes may contain it."""
    if isinstance(error, (socket.timeout, TimeoutError)):
        return f"{on_timeout} within {timeout_s:g} s"
    if isinstance(error, OSError):
        return printable(error.strerror or str(error))[:_MOST_SHOWN]
    return f"the response is not HTTP ({type(error).__name__})"
