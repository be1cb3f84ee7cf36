"""Whether a web page that sends a request was served under the name to which it sends it."""

from __future__ import annotations

from urllib.parse import urlsplit


def is_own_origin(origin: str, host: str) -> bool:
    """Returns whether a page of this `Origin` sends to its own `Host`, both as in the headers of a request.

    >>> is_own_origin("http://Robot:9090", "robot:9090")
    True
    """
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower() != ""
