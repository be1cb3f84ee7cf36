"""Checks and reads requests, as docs/reference/api.md describes them; serves the page's files."""

from __future__ import annotations

import asyncio
import functools
from pathlib import Path
from typing import Any, Mapping, Tuple

from aiohttp import web

from ...core.values import read_json
from ...runtime.access import is_own_origin
from ...runtime.http_answers import SECURITY_HEADERS, ApiError
from ..plot import plot_script, plot_style

BodyLimit = Tuple[int, float]
"""Most bytes of the body of a request, and most seconds until it has come."""
WITH_TOKEN: BodyLimit = (16_384, 10.0)
WITHOUT_TOKEN: BodyLimit = (4096, 5.0)
"""Of a client that has not presented the token yet."""

_PAGE_HEADERS = {
    **SECURITY_HEADERS,
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; manifest-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'",
    "Cache-Control": "no-cache",  # a page is never older than its monitor
    "Vary": "Accept-Encoding",
    "X-Frame-Options": "DENY",
}
_PAGE = Path(__file__).parent / "page"
_TYPES = {".css": "text/css", ".html": "text/html", ".js": "text/javascript"}


def check_same_origin(request: web.Request) -> None:
    """Raises ApiError if a browser sends a request for another page than the server's own.

    Other clients send neither header.
    """
    origin = request.headers.get("Origin")
    site = request.headers.get("Sec-Fetch-Site")
    is_own = origin is None or is_own_origin(origin, request.headers.get("Host", ""))
    if not is_own or site not in (None, "same-origin", "none"):
        raise ApiError(403, "requests that change something must come from the server's own page")


async def read_object(request: web.Request, limit: BodyLimit = WITH_TOKEN) -> dict[str, Any]:
    """Returns the JSON object in a body; raises ApiError if it is none, too large, or does not come in time."""
    if request.content_type != "application/json":
        raise ApiError(415, "expected Content-Type: application/json")
    most_bytes, timeout_s = limit
    try:
        await asyncio.wait_for(request.content.readexactly(most_bytes + 1), timeout_s)
        raise ApiError(413, f"expected a body of at most {most_bytes} bytes")
    except asyncio.TimeoutError:
        raise ApiError(400, "the body did not come in time") from None
    except asyncio.IncompleteReadError as end:
        body = end.partial
    try:
        value = read_json(body)
    except ValueError:
        value = None
    if not isinstance(value, dict):
        raise ApiError(400, "expected a JSON object, got something else")
    return value


async def serve_page_file(request: web.Request) -> web.Response:
    """Answers a request for `/` or `/NAME`: a file of the page, from memory."""
    name = request.match_info.get("name", "index.html")
    content = _page_files().get(name)
    if content is None:
        raise web.HTTPNotFound
    kind = _TYPES[Path(name).suffix]
    response = web.Response(body=content, content_type=kind, charset="utf-8", headers=_PAGE_HEADERS)
    if "gzip" in request.headers.get("Accept-Encoding", ""):
        response.enable_compression(web.ContentCoding.gzip)
    return response


@functools.lru_cache(maxsize=None)
def _page_files() -> Mapping[str, bytes]:
    """Reads the files in `page/`, and the plot, by their names."""
    plot = {"plot.js": plot_script().encode("utf-8"), "plot.css": plot_style().encode("utf-8")}
    return {**{file.name: file.read_bytes() for file in _PAGE.iterdir() if file.suffix in _TYPES}, **plot}
