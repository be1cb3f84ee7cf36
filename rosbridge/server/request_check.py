"""Checks of host and origin that every HTTP request to the server must pass, whatever it asks for."""

from __future__ import annotations

from typing import NamedTuple, Optional

from aiohttp import web

from ..protocol.limits import shown
from .access import Access, is_loopback
from .http_connection import json_error


class Refusal(NamedTuple):
    """The reason for which a request is refused."""

    text: str
    """The reason for the client."""
    log_text: str
    """One line for the log."""

    def response(self) -> web.Response:
        """Returns the HTTP response, in the form of docs/reference/api.md."""
        return json_error(403, self.text)


def check_request(request: web.Request, access: Access, *, check_host: bool) -> Optional[Refusal]:
    """Checks the host and the origin of a request.

    Args:
        request: the request.
        access: which origins may connect.
        check_host: whether `Host` must be a loopback name. Otherwise a web page could reach a server on loopback
            through a name that resolves to 127.0.0.1 (DNS rebinding).

    Returns:
        The refusal; None if the request may be served.
    """
    host = request.headers.get("Host", "")
    if check_host and not is_loopback(host):
        log_text = f"refused a request for host {shown(host)}: without a token, only loopback names are served"
        return Refusal("without a token, only loopback names are served", log_text)
    origin = request.headers.get("Origin", "")
    if not access.origin_allowed(origin, host):
        return Refusal(
            "pages of this origin may not connect",
            f"refused a web page of {shown(origin, 100)}: origin not allowed",
        )
    return None
