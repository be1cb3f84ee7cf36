"""Why there is no connection to a server: one short line for the operator, free of credentials."""

from __future__ import annotations

import asyncio
import socket as sockets
import ssl
from typing import Mapping, NamedTuple

import aiohttp

from ...core.values import LinkError, printable
from .address import shown_address

_LONGEST_REASON = 100
_POLICY_VIOLATION = 1008
_TOO_LARGE = 1009
_NOT_READY = (500, 502, 503, 504)
"""What a server answers, or the proxy before it, that may work later. 501 comes from one that cannot do it."""
_SYSTEM_ERRORS: Mapping[type[BaseException], str] = {
    asyncio.TimeoutError: "no answer from the host",
    aiohttp.ServerDisconnectedError: "connection lost",
    aiohttp.WebSocketError: "connection closed: the server violated the WebSocket protocol",
    sockets.gaierror: "host name not found",
    ConnectionRefusedError: "connection refused: no server listens on this port",
    ConnectionResetError: "connection lost",
    BrokenPipeError: "connection lost",
}


class Cause(NamedTuple):
    """Why a connection is down."""

    text: str
    """For instance `connection refused`."""
    own_fault: bool = False
    """True if no attempt can succeed until the configuration on this side is corrected."""


UP = Cause("")
"""No cause: the connection is up."""


class RedirectError(LinkError, aiohttp.ClientError):
    """The server redirects to another address. It may be another robot's, and without TLS."""

    def __init__(self, status: int, location: str) -> None:
        """Takes the status of the answer, and the address that it names, which may be empty."""
        super().__init__(status, location)
        self.status = status
        self.location = location


def cause_of_error(error: BaseException, has_token: bool, server_kind: str) -> Cause:
    """Returns the cause behind an error of aiohttp that ended a connection or an attempt to connect.

    `server_kind` says what server was expected: `rosbridge server`.
    """
    if isinstance(error, aiohttp.WSServerHandshakeError):
        return _cause_of_status(error.status, has_token, server_kind)
    if isinstance(error, RedirectError):
        target = f" to {_limited(shown_address(error.location))}" if error.location else ""
        return Cause(f"the server redirects{target} (HTTP {error.status}); redirects are not followed")
    if isinstance(error, aiohttp.InvalidURL):
        return _own_fault("invalid address")
    if isinstance(error, aiohttp.WebSocketError) and error.code == _TOO_LARGE:
        return Cause("connection closed: a message is larger than this client accepts")
    if isinstance(error, aiohttp.ClientConnectorCertificateError):
        error = error.certificate_error
    elif isinstance(error, aiohttp.ClientConnectorError):
        error = error.os_error
    if isinstance(error, ssl.SSLError):
        return _cause_of_tls(error)
    for kind, text in _SYSTEM_ERRORS.items():  # aiohttp's own timeouts are subclasses of asyncio's
        if isinstance(error, kind):
            return Cause(text)
    # Never str(error): the errors of libraries may show the address with its credentials.
    text = getattr(error, "strerror", None) or type(error).__name__
    return Cause(f"no connection: {_limited(text)}")


def cause_of_close(code: int | None, reason: str, has_token: bool) -> Cause:
    """Returns the cause behind a WebSocket that ended with this code and text of the server.

    The code is None or 1006 if the server sent none.
    """
    if code in (None, 1006):
        return Cause("connection lost")
    if code == _POLICY_VIOLATION and "token" in reason.lower():
        return _token_refused(has_token)
    if code in (1000, 1001):
        return Cause("the server closed the connection")
    if reason:
        return Cause(f"the server closed the connection with code {code}: {_limited(reason)}")
    return Cause(f"the server closed the connection with code {code}")


def _cause_of_status(status: int, has_token: bool, server_kind: str) -> Cause:
    if status == 401:
        return _token_refused(has_token)
    if status == 403:
        return _own_fault("the server refuses this client (HTTP 403)")
    if status in _NOT_READY:
        return Cause(f"the server is not ready (HTTP {status})")
    return Cause(f"not a {server_kind} (HTTP {status})")


def _cause_of_tls(error: ssl.SSLError) -> Cause:
    if isinstance(error, ssl.SSLCertVerificationError):
        return _own_fault(f"the server's certificate is not trusted: {_limited(error.verify_message)}")
    reason = (error.reason or type(error).__name__).replace("_", " ").lower()
    if "certificate required" in reason:
        return _own_fault("the server requires a client certificate")
    return Cause(f"TLS failed: {_limited(reason)}")


def _token_refused(has_token: bool) -> Cause:
    return _own_fault("wrong token" if has_token else "no token")


def _own_fault(text: str) -> Cause:
    return Cause(f"check this computer's settings: {text}", True)


def _limited(text: str) -> str:
    return printable(text)[:_LONGEST_REASON]
