"""Who may connect, and what they may do besides reading."""

from __future__ import annotations

import fnmatch
import hashlib
import hmac
import ipaddress
from dataclasses import dataclass
from typing import Mapping, Sequence
from urllib.parse import urlsplit

from robot_health_monitor.core.middleware import resolve_name

from ..protocol import Auth

LOCAL_PAGES = ("http://localhost", "http://127.0.0.1", "http://[::1]")
"""Origins of web pages that this machine serves itself, on any port."""
_CLOCK_TOLERANCE_S = 5.0


@dataclass(frozen=True)
class Access:
    """What clients may do. Reading is open to whoever may connect; everything else is a list of name patterns."""

    publish: Sequence[str] = ()
    """Topics that clients may publish on; `*` and `?` as in file names."""
    services: Sequence[str] = ()
    """Services that clients may call; those of rosapi are always open, since they only tell."""
    offer: Sequence[str] = ()
    """Services that clients may offer to one another."""
    origins: Sequence[str] = LOCAL_PAGES
    """Origins (`https://studio.example.org`) from whose pages a browser may connect; without a port: any port."""
    token: str = ""
    """What a client has to show in the header `Authorization: Bearer TOKEN`, as `?token=` in the address, or as the
    secret of the operation `auth`; empty: nothing."""

    def origin_allowed(self, origin: str) -> bool:
        """Whether a browser may connect from a page of this origin. What is no browser sends none, and may."""
        if not origin:
            return True
        if "*" in self.origins or origin in self.origins:
            return True
        try:
            parts = urlsplit(origin)
            host = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname
        except ValueError:
            return False
        return f"{parts.scheme}://{host}" in self.origins

    def token_allowed(self, headers: Mapping[str, str], query: Mapping[str, str]) -> bool:
        """Whether a request shows the token, if one is needed."""
        if not self.token:
            return True
        scheme, _, credentials = headers.get("Authorization", "").partition(" ")
        shown = credentials.strip() if scheme.lower() == "bearer" else query.get("token", "")
        return hmac.compare_digest(shown.encode("utf-8"), self.token.encode("utf-8"))

    def auth_allowed(self, auth: Auth, time_s: float) -> bool:
        """Whether an `auth` operation proves knowledge of the token, as the package rosauth checks it.

        Args:
            auth: the operation.
            time_s: the time in s since 1970.
        """
        if abs(time_s - auth.t) > _CLOCK_TOLERANCE_S or auth.end <= time_s:
            return False
        text = f"{self.token}{auth.client}{auth.dest}{auth.rand}{int(auth.t)}{auth.level}{int(auth.end)}"
        expected = hashlib.sha512(text.encode("utf-8")).hexdigest()
        return hmac.compare_digest(auth.mac.encode("utf-8"), expected.encode("ascii"))


def monitor_access(
    alert_system: str, topics: Sequence[str], *, token: str = "", origins: Sequence[str] = LOCAL_PAGES
) -> Access:
    """Returns what clients of a health monitor may do: send samples of its signals, and call `reset` and `reload`.

    Args:
        alert_system: the fully qualified name of the alert node.
        topics: the topics of its signals, as the node names them.
        token: what a client has to show; empty: nothing.
        origins: from whose pages a browser may connect.
    """
    publish = sorted({resolve_name(topic, alert_system) for topic in topics if topic})
    return Access(publish, (f"{alert_system}/reset", f"{alert_system}/reload"), (), origins, token)


def allowed(name: str, patterns: Sequence[str]) -> bool:
    """Whether a topic's or service's name fits one of `patterns`."""
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


def is_loopback(host: str) -> bool:
    """Whether `host` can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
