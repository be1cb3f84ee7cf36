"""Who may connect, and what clients may do besides reading: host, origin, token, permissions.

A client presents the token in the header `Authorization`, in the address, in the body of a login, or with the cookie
that it got for it: one check and one limit for all of these. The cookie proves knowledge of
the token without containing it, and needs no memory: an expiry and a random number, signed with the token
(HMAC-SHA256). It survives a restart and ends when the token changes. Nothing that a client gets before it has presented
the token depends on the token.
"""

from __future__ import annotations

import enum
import fnmatch
import hashlib
import hmac
import ipaddress
import secrets
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Sequence
from urllib.parse import urlsplit

from aiohttp import web

from ..core.values import Clock, describe
from .http_answers import json_error, json_response

_LOCAL_PAGES = ("http://localhost", "http://127.0.0.1", "http://[::1]")
"""Origins of the web pages of this machine, on any port."""
SESSION_S = 30 * 86_400
"""How long a cookie is valid, in s."""
_COOKIE = "robot_health"
_LONGEST_COOKIE = 200
_SCHEME = {"WWW-Authenticate": "Bearer"}
_LONGEST_PORT = 5
_MOST_WRONG = 10
_PERIOD_S = 60.0
_MOST_ADDRESSES = 1000


@dataclass(frozen=True)
class Access:
    """What clients may do. Every client that may connect may read; everything else needs a matching pattern.

    In patterns, `*` and `?` work as in file names.
    """

    publish: Sequence[str] = ()
    """Topics that clients may publish on."""
    services: Sequence[str] = ()
    """Services that clients may call, whether the robot or another client provides them. rosapi is always open."""
    offer: Sequence[str] = ()
    """Services that clients may provide to other clients."""
    origins: Sequence[str] = ()
    """Origins (`https://studio.example.org`) of web pages that may connect, besides those of this machine; without a
    port: any port; `*`: all."""
    token: str = field(default="", repr=False)
    """Token that clients must present: in the header `Authorization: Bearer TOKEN`, or as `?token=` in the address. If
    it is empty, none is required."""

    def origin_allowed(self, origin: str, host: str = "") -> bool:
        """Returns whether a web page of this `Origin` may send requests, also to its own `Host`.

        Clients other than browsers send no Origin and are allowed.
        """
        origins = {*_LOCAL_PAGES, *self.origins}
        without_port = origin.rpartition(":")[0]
        return not (origin and origins.isdisjoint(("*", origin, without_port))) or is_own_origin(origin, host)


READ_ONLY = Access()


def matches(name: str, patterns: Sequence[str]) -> bool:
    """Returns whether the name of a topic or service matches one of the patterns."""
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


def is_own_origin(origin: str, host: str) -> bool:
    """Returns whether a page of this `Origin` sends to its own `Host`, both as in the headers of a request.

    >>> is_own_origin("http://Robot:9090", "robot:9090")
    True
    """
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower() != ""


def is_loopback(host: str) -> bool:
    """Returns whether a host name or address, with or without a port, is that of the loopback interface."""
    try:
        name = urlsplit(f"//{host}").hostname or host
        return name == "localhost" or ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


def refusal_of(request: web.Request, access: Access, *, check_host: bool) -> str:
    """Returns why a request is refused by its host or its origin, whatever it asks for; empty if it may be served.

    With `check_host`, `Host` must be a loopback name. Otherwise a web page could reach a server on loopback through a
    name that resolves to 127.0.0.1 (DNS rebinding).
    """
    host, origin = request.headers.get("Host", ""), request.headers.get("Origin", "")
    if check_host and not is_loopback(host):
        return f"without a token, only loopback names are served, not {describe(host)}"
    return "" if access.origin_allowed(origin, host) else f"pages of {describe(origin)} may not connect"


class Credentials(enum.Enum):
    """Whether a client has presented the token."""

    VALID = "valid"
    """The right token, or none is required."""
    MISSING = "missing"
    WRONG = "wrong"


class TokenCheck:
    """Checks tokens and cookies. Without a token, every client is valid.

    Wrong tokens are counted per address. The right one is always accepted, so that no client can lock out others.
    """

    def __init__(self, token: str, wall_time_s: Clock = time.time, clock: Clock = time.monotonic) -> None:
        """Remembers the token; `wall_time_s` returns seconds since 1970, `clock` monotonic ones."""
        self._wall_time_s = wall_time_s
        self._clock = clock
        self._wrong: dict[str, deque[float]] = {}
        """When the latest wrong tokens of an address came."""
        self.use(token)

    def use(self, token: str) -> None:
        """Requires another token from now on, or none if it is empty. Cookies for the old one are no longer valid."""
        self._token = _bytes(token)
        self.required = bool(token)
        """Whether clients must present a token."""

    def judge(self, presented: object) -> Credentials:
        """Returns whether this is the token; None is none."""
        if not self.required:
            return Credentials.VALID
        if presented is None:
            return Credentials.MISSING
        is_token = isinstance(presented, str) and hmac.compare_digest(_bytes(presented), self._token)
        return Credentials.VALID if is_token else Credentials.WRONG

    def judge_cookie(self, value: str) -> Credentials:
        """Returns whether this is the value of a valid cookie; one that has expired is none."""
        claim, _, signature = value[:_LONGEST_COOKIE].rpartition(".")
        if not value:
            return Credentials.MISSING
        if not hmac.compare_digest(_bytes(signature), self._sign(claim).encode("ascii")):
            return Credentials.WRONG
        is_expired = self._wall_time_s() >= int(claim.partition(".")[0])
        return Credentials.MISSING if is_expired else Credentials.VALID

    def refuse(self, address: str, credentials: Credentials) -> web.Response:
        """Returns the answer for a client that is not admitted. A wrong token counts."""
        if credentials is Credentials.MISSING:
            return json_error(401, "a token is required", _SCHEME)
        now_s = self._clock()
        if address not in self._wrong and len(self._wrong) >= _MOST_ADDRESSES:
            del self._wrong[next(iter(self._wrong))]
        times = self._wrong.setdefault(address, deque(maxlen=_MOST_WRONG))
        wait_s = times[0] + _PERIOD_S - now_s if len(times) == _MOST_WRONG else 0.0
        if wait_s <= 0.0:
            times.append(now_s)
            return json_error(401, "wrong token", _SCHEME)
        seconds = f"{max(1.0, wait_s):.0f}"
        text = f"too many wrong tokens; try again in {seconds} s"
        response = json_error(429, text, {"Retry-After": seconds})
        response.force_close()  # each further guess costs a connection
        return response

    def new_cookie(self) -> str:
        """Returns the value of a new cookie."""
        claim = f"{int(self._wall_time_s()) + SESSION_S}.{secrets.token_hex(16)}"
        return f"{claim}.{self._sign(claim)}"

    def _sign(self, text: str) -> str:
        return hmac.new(b"robot-health session\n" + self._token, _bytes(text), hashlib.sha256).hexdigest()


class Client:
    """Who sends a request."""

    def __init__(self, check: TokenCheck, request: web.Request) -> None:
        """Judges what the request presents."""
        self._check, self._request = check, request
        presented = request.query.get("token")
        if "Authorization" in request.headers:
            scheme, _, token = request.headers["Authorization"].partition(" ")
            presented = token.strip() if scheme.lower() == "bearer" else ""
        self.token = check.judge(presented)
        """Of the token in the request itself."""
        self.cookie = check.judge_cookie(request.cookies.get(_cookie_name(request), ""))
        """Of the cookie, which browsers add to each request."""

    @property
    def admitted(self) -> bool:
        """Whether it has presented the token, or none is required."""
        return self.token is Credentials.VALID or (self.token, self.cookie) == (Credentials.MISSING, Credentials.VALID)

    def refusal(self) -> web.Response:
        """Returns the answer for a client that is not admitted."""
        is_wrong = Credentials.WRONG in (self.token, self.cookie)
        return self._check.refuse(self._request.remote or "", Credentials.WRONG if is_wrong else Credentials.MISSING)

    def login(self, presented: object) -> web.Response:
        """Returns the answer to a login: with the cookie, if this is the token."""
        credentials = self._check.judge(presented)
        if credentials is not Credentials.VALID:
            return self._check.refuse(self._request.remote or "", credentials)
        return self._answer(self._check.new_cookie(), SESSION_S)

    def logout(self) -> web.Response:
        """Returns the answer that deletes the cookie."""
        return self._answer("", 0)

    def _answer(self, cookie: str, max_age_s: int) -> web.Response:
        response = json_response({"ok": True})
        if self._check.required:
            secure = "; Secure" if self._request.secure else ""
            attributes = f"Path=/; Max-Age={max_age_s}; HttpOnly; SameSite=Strict{secure}"
            # set_cookie of aiohttp 3.6 knows no SameSite
            response.headers.add("Set-Cookie", f"{_cookie_name(self._request)}={cookie}; {attributes}")
        return response


def _cookie_name(request: web.Request) -> str:
    """Returns the name of the cookie. Browsers send cookies to every port of a host: each port has another name."""
    _, _, port = request.headers.get("Host", "").rpartition(":")
    return f"{_COOKIE}_{port}" if port.isascii() and port.isdigit() and len(port) <= _LONGEST_PORT else _COOKIE


def _bytes(text: str) -> bytes:
    # aiohttp decodes invalid UTF-8 in a header to lone surrogates.
    return text.encode("utf-8", "surrogatepass")
