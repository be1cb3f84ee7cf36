"""Who has presented the token: one check and one limit for every way to present it.

A client presents it in the header `Authorization`, in the address, in the body of a login, with the operation `auth`,
or with the cookie that it got for it. The cookie proves knowledge of the token without containing it, and needs no
memory: an expiry and a random number, signed with the token (HMAC-SHA256). It survives a restart and ends when the
token changes. Nothing that a client gets before it has presented the token depends on the token.
"""

from __future__ import annotations

import enum
import hashlib
import hmac
import secrets
import time
from collections import deque
from typing import Callable, Deque, Dict, NamedTuple, Tuple

from aiohttp import web

from ..protocol.operations import Auth
from .connections import json_error

SESSION_S = 30 * 86_400
"""How long a cookie is valid, in s."""
_COOKIE = "robot_health"
_LONGEST_COOKIE = 200
_LONGEST_PORT = 5
_CLOCK_TOLERANCE_S = 5.0
_MOST_WRONG = 10
_PERIOD_S = 60.0
_MOST_ADDRESSES = 1000


class Credentials(enum.Enum):
    """Whether a client has presented the token."""

    VALID = "valid"
    """The right token, or none is required."""
    MISSING = "missing"
    WRONG = "wrong"


class WrongTokens:
    """Counts wrong tokens per address. The right token is always accepted, so that no client can lock out others."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Starts without attempts; `clock` returns monotonic seconds."""
        self._clock = clock
        self._times: Dict[str, Deque[float]] = {}

    def note(self, address: str) -> float:
        """Notes a wrong token; returns how long the address has to wait, in s: 0 for the first ten in a minute."""
        now_s = self._clock()
        times = self._times.get(address)
        if times is None:
            if len(self._times) >= _MOST_ADDRESSES:
                del self._times[next(iter(self._times))]
            times = self._times[address] = deque(maxlen=_MOST_WRONG)
        wait_s = _PERIOD_S - (now_s - times[0]) if len(times) == _MOST_WRONG else 0.0
        if wait_s > 0.0:
            return max(1.0, wait_s)
        times.append(now_s)
        return 0.0


class TokenCheck:
    """Checks tokens and cookies. Without a token, every client is valid."""

    def __init__(
        self, token: str, wall_time_s: Callable[[], float] = time.time, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Remembers the token; `wall_time_s` returns seconds since 1970, `clock` monotonic ones."""
        self._token = _bytes(token)
        self._wall_time_s = wall_time_s
        self._wrong = WrongTokens(clock)

    def use(self, token: str) -> None:
        """Requires another token from now on; empty: none. Cookies for the old one are no longer valid."""
        self._token = _bytes(token)

    @property
    def required(self) -> bool:
        """Whether clients must present a token."""
        return self._token != b""

    def client(self, request: web.Request) -> Client:
        """Returns who sends a request."""
        cookie = request.cookies.get(_cookie_name(request), "")
        return Client(self, request, self._judge_request(request), self.judge_cookie(cookie))

    def judge(self, presented: object) -> Credentials:
        """Returns whether this is the token."""
        if not self._token:
            return Credentials.VALID
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

    def is_proof(self, auth: Auth) -> bool:
        """Returns whether an `auth` operation proves knowledge of the token, by the rules of the package rosauth."""
        time_s = self._wall_time_s()
        if abs(time_s - auth.t) > _CLOCK_TOLERANCE_S or auth.end <= time_s:
            return False
        text = f"{auth.client}{auth.dest}{auth.rand}{int(auth.t)}{auth.level}{int(auth.end)}"
        expected = hashlib.sha512(self._token + _bytes(text)).hexdigest()
        return hmac.compare_digest(_bytes(auth.mac), expected.encode("ascii"))

    def refusal(self, address: str, credentials: Credentials) -> Tuple[str, float]:
        """Returns why a client is refused, and how long it has to wait, in s. A wrong token counts."""
        if credentials is Credentials.MISSING:
            return "a token is required", 0.0
        wait_s = self._wrong.note(address)
        return (f"too many wrong tokens; try again in {wait_s:.0f} s" if wait_s else "wrong token"), wait_s

    def new_cookie(self) -> str:
        """Returns the value of a new cookie."""
        claim = f"{int(self._wall_time_s()) + SESSION_S}.{secrets.token_hex(16)}"
        return f"{claim}.{self._sign(claim)}"

    def _judge_request(self, request: web.Request) -> Credentials:
        authorization = request.headers.get("Authorization")
        if authorization is not None:
            scheme, _, presented = authorization.partition(" ")
            return self.judge(presented.strip() if scheme.lower() == "bearer" else "")
        if "token" in request.query or not self._token:
            return self.judge(request.query.get("token"))
        return Credentials.MISSING

    def _sign(self, text: str) -> str:
        return hmac.new(b"robot-health session\n" + self._token, _bytes(text), hashlib.sha256).hexdigest()


class Client(NamedTuple):
    """Who sends a request."""

    check: TokenCheck
    request: web.Request
    token: Credentials
    """Of the token in the request itself."""
    cookie: Credentials
    """Of the cookie, which browsers add to each request."""

    @property
    def admitted(self) -> bool:
        """Whether it has presented the token, or none is required."""
        return self.token is Credentials.VALID or (self.token, self.cookie) == (Credentials.MISSING, Credentials.VALID)

    def refusal(self) -> web.Response:
        """Returns the answer for a client that is not admitted."""
        is_wrong = Credentials.WRONG in (self.token, self.cookie)
        return self._refusal(Credentials.WRONG if is_wrong else Credentials.MISSING)

    def login(self, presented: object) -> web.Response:
        """Returns the answer to a login: with the cookie, if this is the token."""
        credentials = self.check.judge(presented)
        if credentials is not Credentials.VALID:
            return self._refusal(credentials)
        return self._answer(self.check.new_cookie(), SESSION_S)

    def logout(self) -> web.Response:
        """Returns the answer that deletes the cookie."""
        return self._answer("", 0)

    def _refusal(self, credentials: Credentials) -> web.Response:
        text, wait_s = self.check.refusal(self.request.remote or "", credentials)
        if not wait_s:
            return json_error(401, text, {"WWW-Authenticate": "Bearer"})
        response = json_error(429, text, {"Retry-After": f"{wait_s:.0f}"})
        response.force_close()  # each further guess costs a connection
        return response

    def _answer(self, cookie: str, max_age_s: int) -> web.Response:
        response = web.json_response({"ok": True}, headers={"Cache-Control": "no-store"})
        if self.check.required:
            secure = "; Secure" if self.request.secure else ""
            attributes = f"Path=/; Max-Age={max_age_s}; HttpOnly; SameSite=Strict{secure}"
            # set_cookie of aiohttp 3.6 knows no SameSite
            response.headers.add("Set-Cookie", f"{_cookie_name(self.request)}={cookie}; {attributes}")
        return response


def _cookie_name(request: web.Request) -> str:
    """Returns the name of the cookie. Browsers send cookies to every port of a host: each port has another name."""
    _, _, port = request.headers.get("Host", "").rpartition(":")
    return f"{_COOKIE}_{port}" if port.isascii() and port.isdigit() and len(port) <= _LONGEST_PORT else _COOKIE


def _bytes(text: str) -> bytes:
    # aiohttp decodes invalid UTF-8 in a header to lone surrogates.
    return text.encode("utf-8", "surrogatepass")
