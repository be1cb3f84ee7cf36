"""A page's own origin, as in the headers of a request."""

from __future__ import annotations

import pytest

from robot_health_monitor.runtime.origins import is_own_origin


@pytest.mark.parametrize(
    ("origin", "host", "is_own"),
    [
        ("http://robot:9090", "robot:9090", True),
        ("https://Robot", "rOBOT", True),
        ("http://[::1]:9090", "[::1]:9090", True),
        ("http://robot:9090", "robot:9091", False),
        ("http://evil", "robot", False),
        ("null", "robot", False),
        ("null", "", False),
        ("file://robot", "robot", False),
        ("http://[", "[", False),
        ("", "", False),
    ],
)
def test_a_page_is_the_servers_own_if_its_origin_is_the_host(origin: str, host: str, is_own: bool) -> None:
    assert is_own_origin(origin, host) is is_own
