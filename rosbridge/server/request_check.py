"""Checks that every HTTP request to the server must pass, whatever it asks for."""

from __future__ import annotations

from typing import NamedTuple, Optional

from aiohttp import web

from ..protocol.errors import shown
from .access import Access, Credentials, is_loopback

__all__ = ["Refusal", "check_request"]


class Refusal(NamedTuple):
    """The reason for which a request is refused."""

    status: int
    """HTTP status."""
    text: str
    """The reason for the client."""
    log_text: str
    """One line for the log, without the token."""

    def response(self) -> web.Response:
        """Returns the HTTP response, in the form of docs/api.md."""
        headers = {"WWW-Authenticate": "Bearer"} if self.status == 401 else {}
        return web.json_response({"error": self.text}, status=self.status, headers=headers)


def check_request(request: web.Request, access: Access, *, check_host: bool) -> Optional[Refusal]:
    """Checks the host, the origin and the token of a request.

    A request without a token passes: the caller decides whether it needs one, with `Access.credentials`.

    Args:
        request: the request.
        access: who may connect.
        check_host: whether `Host` must be a loopback name. Otherwise a web page could reach a server on loopback
            through a name that resolves to 127.0.0.1 (DNS rebinding).

    Returns:
        The refusal; None if the request may be served.
    """
    host = request.headers.get("Host", "")
    if check_host and not is_loopback(host):
        log_text = f"refused a request for host {shown(host)}: without a token, only loopback names are served"
        return Refusal(403, "without a token, only loopback names are served", log_text)
    origin = request.headers.get("Origin", "")
    if not access.origin_allowed(origin, host):
        return Refusal(
            403,
            "pages of this origin may not connect",
            f"refused a web page of {shown(origin, 100)}: origin not allowed",
        )
    if access.credentials(request.headers, request.query) is Credentials.WRONG:
        return Refusal(401, "wrong token", f"refused a client at {request.remote}: wrong token")
    return None
