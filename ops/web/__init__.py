"""The web page, the HTTP API behind it (docs/reference/api.md), metrics and health check.

Only `aiohttp` routes: the caller serves them.
"""

from .interface import WebInterface

__all__ = ["WebInterface"]
