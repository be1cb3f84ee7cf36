"""Answers of the server's port, as docs/reference/api.md describes them."""

from __future__ import annotations

import json
from typing import Any, Mapping

from aiohttp import web

from ..core.values import MessageError

SECURITY_HEADERS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
API_HEADERS = {**SECURITY_HEADERS, "Cache-Control": "no-store"}


class ApiError(MessageError):
    """A request that is refused or failed. `str()` is one line for the client."""

    def __init__(self, status: int, text: str) -> None:
        """Takes the HTTP status and the line."""
        super().__init__(text)
        self.status = status


class FileAnswer(web.FileResponse):
    """A file. Unlike other answers of aiohttp, its own would be sent again when it is prepared again."""

    _is_sent = False

    async def prepare(self, request: web.BaseRequest) -> Any:
        """Sends the file."""
        if self._is_sent:
            return None
        self._is_sent = True
        return await super().prepare(request)


def json_bytes(value: object) -> bytes:
    """Returns JSON in ASCII; raises ValueError if a number is not finite."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode("ascii")


def json_response(value: object, status: int = 200, headers: Mapping[str, str] | None = None) -> web.Response:
    """Returns an answer with a JSON value, or with one that was encoded before, which must not be cached."""
    body = value if isinstance(value, bytes) else json_bytes(value)
    all_headers = {**API_HEADERS, **(headers or {})}
    return web.Response(status=status, body=body, content_type="application/json", headers=all_headers)


def json_error(status: int, text: str, headers: Mapping[str, str] | None = None) -> web.Response:
    """Returns a refusal: HTTP status, reason, further headers."""
    return json_response({"error": text}, status, headers)
