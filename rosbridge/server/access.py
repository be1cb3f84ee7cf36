"""Which requests are served, and what clients may do besides reading."""

from __future__ import annotations

import fnmatch
import ipaddress
from dataclasses import dataclass, field
from typing import NamedTuple, Optional, Sequence
from urllib.parse import urlsplit

from aiohttp import web

from ..protocol.limits import shown

LOCAL_PAGES = ("http://localhost", "http://127.0.0.1", "http://[::1]")
"""Origins of the web pages of this machine, on any port."""


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
    origins: Sequence[str] = LOCAL_PAGES
    """Origins (`https://studio.example.org`) of web pages that may connect; without a port: any port; `*`: all."""
    token: str = field(default="", repr=False)
    """Token that clients must present: in the header `Authorization: Bearer TOKEN`, as `?token=` in the address, or
    as the secret of the operation `auth`. Empty: none."""

    def may_publish(self, topic: str) -> bool:
        """Returns whether clients may publish on a topic."""
        return _matches(topic, self.publish)

    def may_call(self, service: str) -> bool:
        """Returns whether clients may call a service."""
        return _matches(service, self.services)

    def may_offer(self, service: str) -> bool:
        """Returns whether clients may provide a service."""
        return _matches(service, self.offer)

    def origin_allowed(self, origin: str, host: str = "") -> bool:
        """Returns whether a web page of this `Origin` may send requests, also to its own `Host`.

        Clients other than browsers send no Origin and are allowed.
        """
        if not origin or "*" in self.origins or origin in self.origins:
            return True
        try:
            parts = urlsplit(origin)
            name = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname
        except ValueError:
            return False
        is_own = parts.scheme in ("http", "https") and parts.netloc == host != ""
        return is_own or f"{parts.scheme}://{name}" in self.origins


def monitor_access(
    alert_system: str,
    *,
    publish: Sequence[str] = (),
    services: Sequence[str] = (),
    offer: Sequence[str] = (),
    origins: Sequence[str] = (),
    token: str = "",
) -> Access:
    """Returns the access to a health monitor: reading, `reset` and `reload` of `alert_system`, and what is granted.

    `origins` may connect besides the pages of this machine; the other arguments are as in `Access`.
    """
    own_services = (f"{alert_system}/reset", f"{alert_system}/reload")
    return Access(publish, (*own_services, *services), offer, (*LOCAL_PAGES, *origins), token)


def is_loopback(host: str) -> bool:
    """Returns whether a host name or address, with or without a port, is that of the loopback interface."""
    name = host
    if host.startswith("["):
        name = host[1:].partition("]")[0]
    elif host.count(":") == 1:
        name = host.partition(":")[0]
    if name.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


class Refusal(NamedTuple):
    """The reason for which a request is refused."""

    text: str
    """The reason for the client."""
    log_text: str
    """One line for the log."""


def check_request(request: web.Request, access: Access, *, check_host: bool) -> Optional[Refusal]:
    """Checks the host and the origin of a request, whatever it asks for; returns None if it may be served.

    With `check_host`, `Host` must be a loopback name. Otherwise a web page could reach a server on loopback through a
    name that resolves to 127.0.0.1 (DNS rebinding).
    """
    host, origin = request.headers.get("Host", ""), request.headers.get("Origin", "")
    if check_host and not is_loopback(host):
        reason = "without a token, only loopback names are served"
        return Refusal(reason, f"refused a request for host {shown(host)}: {reason}")
    if not access.origin_allowed(origin, host):
        log_text = f"refused a web page of {shown(origin, 100)}: origin not allowed"
        return Refusal("pages of this origin may not connect", log_text)
    return None


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
