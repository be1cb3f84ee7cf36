from __future__ import annotations

import hashlib
from typing import Any

import pytest

from robot_health_monitor.rosbridge.protocol import Auth
from robot_health_monitor.rosbridge.server.access import Access, allowed, is_loopback


@pytest.mark.parametrize(
    ("origin", "may"),
    [
        ("", True),
        ("http://localhost:8080", True),
        ("http://127.0.0.1", True),
        ("http://[::1]:3000", True),
        ("https://studio.example.org", True),
        ("https://studio.example.org:444", True),
        ("http://studio.example.org", False),
        ("https://studio.example.org.evil.example", False),
        ("http://localhost.evil.example", False),
        ("http://evil.example", False),
        ("null", False),
        ("file://", False),
        ("http://[", False),
    ],
)
def test_pages_of_allowed_origins_may_connect(origin: str, may: bool) -> None:
    access = Access(origins=("http://localhost", "http://127.0.0.1", "http://[::1]", "https://studio.example.org"))
    assert access.origin_allowed(origin) is may


def test_a_star_allows_every_origin() -> None:
    assert Access(origins=("*",)).origin_allowed("http://evil.example")


@pytest.mark.parametrize(
    ("headers", "query", "may"),
    [
        ({"Authorization": "Bearer s3cret"}, {}, True),
        ({"Authorization": "bearer s3cret"}, {}, True),
        ({}, {"token": "s3cret"}, True),
        ({}, {}, False),
        ({"Authorization": "Bearer wrong"}, {}, False),
        ({"Authorization": "Basic s3cret"}, {}, False),
        ({"Authorization": "Bearer"}, {}, False),
        ({}, {"token": "\N{SNOWMAN}"}, False),
    ],
)
def test_the_token_is_shown_in_the_header_or_the_address(headers: Any, query: Any, may: bool) -> None:
    assert Access(token="s3cret").token_allowed(headers, query) is may
    assert Access().token_allowed(headers, query) is True


def auth(**changes: Any) -> Auth:
    """What rosauth's documentation has a client send: sha512 of secret, client, dest, rand, t, level, end."""
    mac = hashlib.sha512(b"s3cret" + b"laptop" + b"robot" + b"xyz" + b"1000" + b"admin" + b"2000").hexdigest()
    return Auth(mac, "laptop", "robot", "xyz", 1000.0, "admin", 2000.0)._replace(**changes)


@pytest.mark.parametrize(
    ("changes", "time_s", "may"),
    [
        ({}, 1002.0, True),
        ({}, 998.0, True),
        ({}, 1010.0, False),  # too old
        ({"end": 999.0}, 1001.0, False),
        ({"level": "root"}, 1002.0, False),
        ({"mac": ""}, 1002.0, False),
        ({"mac": "\N{SNOWMAN}"}, 1002.0, False),
    ],
)
def test_the_operation_auth_proves_the_token(changes: Any, time_s: float, may: bool) -> None:
    assert Access(token="s3cret").auth_allowed(auth(**changes), time_s) is may
    assert Access(token="other").auth_allowed(auth(**changes), time_s) is False


def test_names_are_allowed_by_pattern() -> None:
    assert allowed("/robot1/battery_level", ["/robot1/*"])
    assert allowed("/reset", ["/other", "/reset"])
    assert not allowed("/robot2/battery_level", ["/robot1/*"])
    assert not allowed("/reset", [])


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.5", False),
        ("robot1", False),
        ("", False),
    ],
)
def test_loopback_is_told_from_what_others_can_reach(host: str, own: bool) -> None:
    assert is_loopback(host) is own
