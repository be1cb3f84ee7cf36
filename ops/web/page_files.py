"""The files of the web page, from memory."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Dict, Mapping, NamedTuple, Optional

from aiohttp import web

from ..plot import plot_script, plot_style
from .requests import SECURITY_HEADERS, ApiError

__all__ = ["PageFiles"]

_FOLDER = Path(__file__).parent / "page"
_INDEX = "index.html"
_TYPES = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".webmanifest": "application/manifest+json",
}
_POLICY = "; ".join(
    [
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "connect-src 'self'",
        "img-src 'self' data:",
        "manifest-src 'self'",
        "frame-ancestors 'none'",
        "base-uri 'none'",
        "form-action 'self'",
    ]
)
_HEADERS = {
    **SECURITY_HEADERS,
    "Content-Security-Policy": _POLICY,
    "Cache-Control": "no-cache",  # may be stored, but asks each time whether it has changed
    "X-Frame-Options": "DENY",
}


class _File(NamedTuple):
    content: bytes
    content_type: str
    etag: str


class PageFiles:
    """The files in `page/`, and the plot. They are read at the first request."""

    def __init__(self) -> None:
        """Reads nothing yet."""
        self._files: Optional[Mapping[str, _File]] = None

    async def serve(self, request: web.Request) -> web.Response:
        """Answers a request for `/` or `/NAME`."""
        if self._files is None:
            self._files = _read_files()
        file = self._files.get(request.match_info.get("name", _INDEX))
        if file is None:
            return ApiError(404, f"there is no path {request.path}").response()
        headers = {**_HEADERS, "ETag": file.etag}
        if file.etag in request.headers.get("If-None-Match", ""):
            return web.Response(status=304, headers=headers)
        is_text = file.content_type.startswith("text/")
        charset = "utf-8" if is_text else None
        return web.Response(body=file.content, content_type=file.content_type, charset=charset, headers=headers)


def _read_files() -> Mapping[str, _File]:
    contents: Dict[str, bytes] = {
        file.name: file.read_bytes() for file in sorted(_FOLDER.iterdir()) if file.suffix in _TYPES
    }
    contents.update({"plot.js": plot_script().encode("utf-8"), "plot.css": plot_style().encode("utf-8")})
    return {
        name: _File(content, _TYPES[Path(name).suffix], f'"{hashlib.sha256(content).hexdigest()[:32]}"')
        for name, content in contents.items()
    }
