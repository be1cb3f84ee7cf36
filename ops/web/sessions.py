"""Who may use the API: the token, or the cookie that a page gets for it.

The cookie proves knowledge of the token without containing it, and needs no memory: an expiry and a random number,
signed with the token (HMAC-SHA256). It survives a restart of the monitor and ends when the token changes.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections import deque
from typing import Callable, Deque, Dict, Mapping, Optional

__all__ = ["LoginLimit", "Sessions", "TooManyLoginsError"]

SESSION_S = 30 * 86_400
"""How long a cookie is valid, in s."""
_LONGEST_COOKIE = 200
_MOST_WRONG = 10
_MOST_WRONG_TOGETHER = 100
_PERIOD_S = 60.0
_MOST_CLIENTS = 1000


class TooManyLoginsError(Exception):
    """Too many wrong tokens."""

    def __init__(self, wait_s: float) -> None:
        """Creates the error.

        Args:
            wait_s: when the next attempt is possible, in s.
        """
        super().__init__(f"too many wrong tokens; try again in {wait_s:.0f} s")
        self.wait_s = wait_s


class LoginLimit:
    """Limits wrong tokens: ten per minute and client, a hundred of all clients together."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Starts without attempts; `clock` returns monotonic seconds."""
        self._clock = clock
        self._wrong: Dict[str, Deque[float]] = {}
        self._all: Deque[float] = deque(maxlen=_MOST_WRONG_TOGETHER)

    def check(self, client: str) -> None:
        """Call before each attempt.

        Raises:
            TooManyLoginsError: it is not possible now.
        """
        for times in (self._wrong.get(client), self._all):
            if times and len(times) == times.maxlen:
                wait_s = _PERIOD_S - (self._clock() - times[0])
                if wait_s > 0.0:
                    raise TooManyLoginsError(max(1.0, wait_s))

    def note_wrong(self, client: str) -> None:
        """Call after an attempt with a wrong token."""
        if client not in self._wrong and len(self._wrong) >= _MOST_CLIENTS:
            del self._wrong[next(iter(self._wrong))]
        self._wrong.setdefault(client, deque(maxlen=_MOST_WRONG)).append(self._clock())
        self._all.append(self._clock())


class Sessions:
    """Checks tokens and cookies. Without a token, everything is admitted."""

    def __init__(self, token: str, wall_time_s: Callable[[], float] = time.time) -> None:
        """Remembers the token.

        Args:
            token: what clients must present; empty: nothing.
            wall_time_s: seconds since 1970.
        """
        self._token = token.encode("utf-8", "surrogatepass")
        self._wall_time_s = wall_time_s
        # Cookies do not depend on the port: servers with other tokens on the same host need other names.
        self.cookie = f"robot_health_{self._sign('name')[:8]}"
        """Name of the cookie."""

    @property
    def required(self) -> bool:
        """Whether clients must present the token."""
        return self._token != b""

    def is_token(self, presented: object) -> bool:
        """Returns whether this is the token."""
        if not isinstance(presented, str):
            return False
        return hmac.compare_digest(presented.encode("utf-8", "surrogatepass"), self._token)

    def admits(self, headers: Mapping[str, str], cookies: Mapping[str, str]) -> bool:
        """Returns whether a request carries the token or a valid cookie, or none is required."""
        if not self.required:
            return True
        scheme, _, presented = headers.get("Authorization", "").partition(" ")
        if scheme.lower() == "bearer" and self.is_token(presented.strip()):
            return True
        return self._is_session(cookies.get(self.cookie, ""))

    def new_session(self) -> str:
        """Returns the value of a new cookie."""
        claim = f"{int(self._wall_time_s()) + SESSION_S}.{secrets.token_hex(16)}"
        return f"{claim}.{self._sign(claim)}"

    def _is_session(self, value: str) -> bool:
        claim, _, signature = value[:_LONGEST_COOKIE].rpartition(".")
        expires: Optional[str] = claim.partition(".")[0]
        if not expires or not (expires.isdigit() and expires.isascii()):
            return False
        expected = self._sign(claim)
        is_signed = hmac.compare_digest(signature.encode("utf-8", "surrogatepass"), expected.encode("ascii"))
        return is_signed and self._wall_time_s() < int(expires)

    def _sign(self, text: str) -> str:
        key = b"robot-health session\n" + self._token
        return hmac.new(key, text.encode("utf-8", "surrogatepass"), hashlib.sha256).hexdigest()
