"""Addresses of the servers of bridges: checked before use, and shown without credentials."""

from __future__ import annotations

import re
from urllib.parse import urlsplit

from ...core.values import ConfigError

_SHOWN_CHARS = 100
_HTTP_SCHEMES = {"ws": "http", "wss": "https", "foxglove": "http", "foxglove+tls": "https"}
"""Scheme of the HTTP request that opens the WebSocket, by scheme of the address."""
EXPECTED = "expected ws://host:port, wss://host:port, foxglove://host:port or foxglove+tls://host:port"


def host_and_port(url: str) -> tuple[str, int | None]:
    """Returns the host of an address, and its port if given.

    Raises ConfigError if it is not the address of a WebSocket server.
    """
    try:
        parts = urlsplit(url)
        is_text = url.isprintable() and " " not in url
        if parts.scheme in _HTTP_SCHEMES and parts.hostname and parts.port != 0 and is_text:
            return parts.hostname, parts.port
    except ValueError:
        pass  # brackets that do not match, or a port that is not one
    raise ConfigError(f"{EXPECTED}, got {shown_address(url)[:_SHOWN_CHARS]!r}")


def full_address(text: str) -> str:
    """Returns an address with its scheme: `robot:9090` means `ws://robot:9090`. Anything else stays as it is.

    >>> full_address("robot:9090")
    'ws://robot:9090'
    """
    if "://" not in text:
        try:
            _, port = host_and_port(f"ws://{text}")
        except ConfigError:
            port = None
        if port is not None:
            return f"ws://{text}"
    return text


def http_address(url: str) -> str:
    """Returns the address of the HTTP request that opens the WebSocket; not every aiohttp accepts `ws:`."""
    scheme, _, rest = url.partition("://")
    return f"{_HTTP_SCHEMES[scheme.lower()]}://{rest}"


def shown_address(url: str) -> str:
    """Returns an address without user, password and query, any of which may hold a secret. Accepts any text.

    >>> shown_address("ws://user:secret@robot:9090/path?token=secret")
    'ws://robot:9090/path'
    """
    return re.sub(r"^([^/?#]*//)?[^/?#]*@", r"\1", re.split(r"[?#]", url, maxsplit=1)[0])


def is_foxglove(url: str) -> bool:
    """Returns whether the server at an address speaks Foxglove's protocol, not rosbridge."""
    return url.lower().startswith("foxglove")
