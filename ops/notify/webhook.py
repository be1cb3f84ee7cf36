"""Target `webhook`: posts each notification as JSON. Also what all targets over HTTP have in common.

A request is bounded in time and size, whatever the server does. The proxy variables of the environment (`http_proxy`,
`https_proxy`, `no_proxy`) are respected. Redirects are not followed: the address, which may contain a secret, goes to
the configured host only. Standard library only: aiohttp would take 16 MB more, also on robots that serve no page.
"""

from __future__ import annotations

import base64
import contextlib
import email.utils
import functools
import http.client
import io
import socket
import ssl
import time
import urllib.error
import urllib.request
from typing import Any, NamedTuple, Optional, Sequence
from urllib.parse import unquote, urlsplit, urlunsplit

from ...core.values.errors import LinkError
from ...core.values.formatting import duration_text, printable
from ...core.values.version import package_version
from .sender import DeliveryError, Notification, Sender

_RETRIED = (408, 429)  # temporary: Request Timeout, Too Many Requests
_MOST_SHOWN = 200  # characters of a response

LONGEST_WAIT_S = 3600.0
"""Longest wait that a server may request, in s: a target cannot keep alerts back for longer."""


class Answer(NamedTuple):
    """The response of a server."""

    status: int
    reason: str  # the server's name of the status; printable. It may repeat a secret of the address
    text: str  # beginning of the body of a response other than 2xx, on one line; printable
    date_s: Optional[float]  # the server's clock, in s since 1970; None: not stated
    retry_after_s: float  # wait that the server requests, in s; 0: none


class Webhook(Sender):
    """Posts the JSON of `--json`, with the fields `notification` (firing or resolved) and `time`."""

    def send(self, notification: Notification) -> str:
        """Posts a notification."""
        return self.deliver(notification.as_json())

    def repeat(self, alerts: Sequence[Notification]) -> None:
        """Calls the address of a heartbeat."""
        self.deliver(None)

    def call(self, body: Optional[str], path: str = "") -> Answer:
        """Returns the response to `request`, with a path appended to the address."""
        url = self.http_address()
        if path:
            url = url.rstrip("/")
            url = url if url.endswith(path) else url + path
        return request(url, None if body is None else body.encode(), self._settings.timeout_s)

    def deliver(self, body: Optional[str]) -> str:
        """Sends a request, as `call`, and returns the status of its response, as `status_of`."""
        return self.status_of(self.call(body))

    def status_of(self, answer: Answer) -> str:
        """Returns the status of a response; raises DeliveryError if that is not success (2xx)."""
        status, is_secret = answer.status, bool(self._settings.url_file)
        reason = http.client.responses.get(status, "") if is_secret else answer.reason
        title = f"{status} {reason}".strip()
        if 200 <= status < 300:
            return title
        text = f"response {title}"
        if 300 <= status < 400:
            text += "; redirects are not followed"
        elif answer.text and not is_secret:  # a page that says "not found" may repeat the address
            text += f": {answer.text}"
        if answer.retry_after_s:
            text += f"; the server asks to wait {duration_text(answer.retry_after_s)}"
        is_refused = 400 <= status < 500 and status not in _RETRIED
        raise DeliveryError(text, is_refused=is_refused, retry_after_s=answer.retry_after_s)


class _NotConnectedError(LinkError):
    """The connection could not be established, because of `__cause__`: the request was not sent."""


def request(url: str, body: Optional[bytes], timeout_s: float) -> Answer:
    """Sends JSON (POST), or nothing (GET), and returns the response, of any status.

    A user and password in the address are sent as basic authentication. The time limit in s is for everything; only
    the resolution of a host name may take longer. Raises DeliveryError, without the address, if there is no response.
    """
    parts = urlsplit(url)
    headers = {"User-Agent": f"robot-health/{package_version()}", "Accept": "*/*"}
    if body is not None:
        headers["Content-Type"] = "application/json"
    if "@" in parts.netloc:
        user = f"{unquote(parts.username or '')}:{unquote(parts.password or '')}"
        headers["Authorization"] = f"Basic {base64.b64encode(user.encode()).decode()}"
        url = urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    opener = urllib.request.OpenerDirector()
    for handler in (urllib.request.ProxyHandler(), urllib.request.UnknownHandler(), _Handler()):
        opener.add_handler(handler)
    try:
        with opener.open(urllib.request.Request(url, body, headers), timeout=timeout_s) as response:
            return _answer(response)
    except Exception as error:  # the text of some exceptions contains the address
        cause = error.reason if isinstance(error, urllib.error.URLError) else error
        if isinstance(cause, _NotConnectedError):
            problem = _problem(cause.__cause__, "no connection", timeout_s)
            raise DeliveryError(problem, may_have_arrived=False) from None
        raise DeliveryError(_problem(cause, "no response", timeout_s)) from None


class _Handler(urllib.request.AbstractHTTPHandler):
    def http_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_Connection, request)

    def https_open(self, request: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_TlsConnection, request, context=ssl.create_default_context())

    http_request = https_request = urllib.request.AbstractHTTPHandler.do_request_


class _Connection(http.client.HTTPConnection):
    """Applies its timeout to the whole request: a socket's own one begins again with every byte."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._deadline_s = time.monotonic() + (self.timeout or 0.0)
        self.response_class: Any = functools.partial(_Response, deadline_s=self._deadline_s)

    def connect(self) -> None:
        try:
            super().connect()
        except OSError as error:
            raise _NotConnectedError from error
        _limit(self.sock, self._deadline_s)


class _TlsConnection(_Connection, http.client.HTTPSConnection):
    """The same with TLS; the server's certificate is verified."""


class _Response(http.client.HTTPResponse):
    def __init__(self, sock: socket.socket, *arguments: Any, deadline_s: float, **options: Any) -> None:
        super().__init__(sock, *arguments, **options)
        self.fp = io.BufferedReader(_DeadlineReader(self.fp.detach(), sock, deadline_s))


class _DeadlineReader(io.RawIOBase):
    """Reads until a deadline, whatever the pace of the server."""

    def __init__(self, raw: io.RawIOBase, sock: socket.socket, deadline_s: float) -> None:
        self._raw = raw
        self._sock = sock
        self._deadline_s = deadline_s

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> Optional[int]:
        _limit(self._sock, self._deadline_s)
        count: Optional[int] = self._raw.readinto(buffer)
        return count

    def close(self) -> None:
        self._raw.close()
        super().close()


def _limit(sock: socket.socket, deadline_s: float) -> None:
    """Lets the next use of a socket end at the deadline."""
    remaining_s = deadline_s - time.monotonic()
    if remaining_s <= 0.0:
        raise socket.timeout("timed out")
    sock.settimeout(remaining_s)


def _answer(response: http.client.HTTPResponse) -> Answer:
    text = ""
    if not 200 <= response.status < 300:
        with contextlib.suppress(OSError, ValueError, http.client.HTTPException):  # the status says enough
            text = " ".join(response.read(4 * _MOST_SHOWN).decode("utf-8", "replace").split())
    date_s = _date_s(response.headers.get("date", ""))
    wait_s = _wait_s(response.headers.get("retry-after", ""), date_s)
    reason = printable(str(response.reason))[:_MOST_SHOWN]
    return Answer(response.status, reason, printable(text)[:_MOST_SHOWN], date_s, wait_s)


def _date_s(text: str) -> Optional[float]:
    try:
        return email.utils.parsedate_to_datetime(text).timestamp()
    except (TypeError, ValueError, IndexError, OverflowError):
        return None


def _wait_s(text: str, date_s: Optional[float]) -> float:
    """Returns the wait of `Retry-After`, in s: a number, or a date by the server's clock (RFC 9110, 10.2.3)."""
    if text.isascii() and text.isdigit():
        return float(min(int(text[:10]), LONGEST_WAIT_S))
    until_s = _date_s(text)
    if until_s is None:
        return 0.0
    return min(max(until_s - (time.time() if date_s is None else date_s), 0.0), LONGEST_WAIT_S)


def _problem(error: object, on_timeout: str, timeout_s: float) -> str:
    """Describes an exception, without the address: the texts of other classes may contain it."""
    if isinstance(error, (socket.timeout, TimeoutError)):
        return f"{on_timeout} within {timeout_s:g} s"
    if isinstance(error, OSError):
        return printable(error.strerror or str(error))[:_MOST_SHOWN]
    return f"the response is not HTTP ({type(error).__name__})"
