"""Checks and reads requests, and writes answers, as docs/reference/api.md describes them."""

from __future__ import annotations

import asyncio
import json
from typing import Any, Dict, Mapping, NamedTuple, Optional, Protocol
from urllib.parse import urlsplit

from aiohttp import web

from robot_health_monitor.core.errors import MessageError

__all__ = ["API_HEADERS", "ApiError", "check_same_origin", "json_bytes", "json_response", "read_object", "read_text"]


_MOST_TEXT = 200


class BodyLimit(NamedTuple):
    """What the body of a request may be."""

    most_bytes: int
    timeout_s: float


WITH_TOKEN = BodyLimit(16_384, 10.0)
WITHOUT_TOKEN = BodyLimit(4096, 5.0)
"""Of a client that has not presented the token yet."""

SECURITY_HEADERS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
API_HEADERS = {**SECURITY_HEADERS, "Cache-Control": "no-store"}


class Client(Protocol):
    """Who sends a request, as the server has judged it."""

    @property
    def admitted(self) -> bool:
        """Whether it has presented the token, or none is required."""

    def refusal(self) -> web.Response:
        """Returns the answer for a client that is not admitted."""

    def login(self, presented: object) -> web.Response:
        """Returns the answer to a login with a token."""

    def logout(self) -> web.Response:
        """Returns the answer that ends a login."""


class ApiError(MessageError):
    """A request that is refused or failed."""

    def __init__(self, status: int, text: str, headers: Optional[Mapping[str, str]] = None) -> None:
        """Creates the error.

        Args:
            status: HTTP status.
            text: one line for the client.
            headers: further headers of the answer.
        """
        super().__init__(text)
        self.status = status
        self.headers = headers or {}

    def response(self) -> web.Response:
        """Returns the answer."""
        return json_response({"error": str(self)}, status=self.status, headers=self.headers)


def json_bytes(value: object) -> bytes:
    """Returns JSON in ASCII.

    Raises:
        ValueError: a number is not finite.
    """
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode("ascii")


def json_response(value: object, *, status: int = 200, headers: Optional[Mapping[str, str]] = None) -> web.Response:
    """Returns an answer with JSON, which must not be cached."""
    return web.Response(
        status=status,
        body=json_bytes(value),
        content_type="application/json",
        headers={**API_HEADERS, **(headers or {})},
    )


def check_same_origin(request: web.Request) -> None:
    """Checks that a browser sends a request only for the server's own page. Other clients send neither header.

    Raises:
        ApiError: it comes from another page.
    """
    origin = request.headers.get("Origin")
    site = request.headers.get("Sec-Fetch-Site")
    try:
        is_own = origin is None or urlsplit(origin).netloc.lower() == request.headers.get("Host", "").lower() != ""
    except ValueError:
        is_own = False
    if not is_own or site not in (None, "same-origin", "none"):
        raise ApiError(403, "requests that change something must come from the server's own page")


async def read_object(request: web.Request, limit: BodyLimit = WITH_TOKEN) -> Dict[str, Any]:
    """Returns the JSON object in a request's body.

    Raises:
        ApiError: it is too large, does not come in time, or is no JSON object.
    """
    if request.content_type != "application/json":
        raise ApiError(415, "expected Content-Type: application/json")
    if (request.content_length or 0) > limit.most_bytes:
        raise _too_large(limit)
    try:
        body = await asyncio.wait_for(_read(request, limit), limit.timeout_s)
    except asyncio.TimeoutError:
        raise ApiError(400, "the body did not come in time") from None
    try:
        value = json.loads(body.decode("utf-8"), parse_constant=_refuse)
    except (ValueError, RecursionError):
        raise ApiError(400, "expected a JSON object, got something else") from None
    if not isinstance(value, dict):
        raise ApiError(400, "expected a JSON object, got something else")
    return value


def read_text(body: Mapping[str, Any], name: str) -> str:
    """Returns a text of a request's body; empty if it is left out.

    Raises:
        ApiError: it is no text, or too long.
    """
    value = body.get(name)
    if value is None:
        return ""
    if not isinstance(value, str) or len(value) > _MOST_TEXT:
        raise ApiError(400, f"{name}: expected a text of at most {_MOST_TEXT} characters")
    return value


async def _read(request: web.Request, limit: BodyLimit) -> bytes:
    body = bytearray()
    async for chunk in request.content.iter_chunked(4096):
        body += chunk
        if len(body) > limit.most_bytes:
            raise _too_large(limit)
    return bytes(body)


def _too_large(limit: BodyLimit) -> ApiError:
    return ApiError(413, f"expected a body of at most {limit.most_bytes} bytes")


def _refuse(constant: str) -> None:
    raise ValueError(constant)
