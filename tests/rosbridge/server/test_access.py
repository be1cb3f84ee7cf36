from __future__ import annotations

import hashlib
from typing import Any

import pytest

from robot_health_monitor.rosbridge.protocol import Auth
from robot_health_monitor.rosbridge.server.access import Access, Credentials, is_loopback, monitor_access


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
    ("origin", "host", "may"),
    [
        ("http://robot:9090", "robot:9090", True),
        ("https://robot", "robot", True),
        ("http://robot:8080", "robot:9090", False),
        ("http://evil.example", "robot:9090", False),
        ("file://", "", False),
    ],
)
def test_the_servers_own_pages_may_connect(origin: str, host: str, may: bool) -> None:
    assert Access(token="s3cret").origin_allowed(origin, host) is may


@pytest.mark.parametrize(
    ("headers", "query", "credentials"),
    [
        ({"Authorization": "Bearer s3cret"}, {}, Credentials.VALID),
        ({"Authorization": "bearer s3cret"}, {}, Credentials.VALID),
        ({}, {"token": "s3cret"}, Credentials.VALID),
        ({}, {}, Credentials.MISSING),
        ({"Authorization": "Bearer wrong"}, {}, Credentials.WRONG),
        ({"Authorization": "Basic s3cret"}, {}, Credentials.WRONG),
        ({"Authorization": "Bearer"}, {}, Credentials.WRONG),
        ({"Authorization": "Bearer \udcff"}, {}, Credentials.WRONG),  # the byte 0xff, as aiohttp decodes it
        ({}, {"token": "\N{SNOWMAN}"}, Credentials.WRONG),
    ],
)
def test_the_token_is_presented_in_the_header_or_the_address(headers: Any, query: Any, credentials: Any) -> None:
    assert Access(token="s3cret").credentials(headers, query) is credentials
    assert Access().credentials(headers, query) is Credentials.VALID


def auth(**changes: Any) -> Auth:
    """A proof as in rosauth's documentation: sha512 of secret, client, dest, rand, t, level, end."""
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


def test_names_are_granted_by_patterns() -> None:
    access = Access(publish=("/robot1/*",), services=("/other", "/reset?"), offer=("/offered",))
    assert access.may_publish("/robot1/battery_level")
    assert not access.may_publish("/robot2/battery_level")
    assert access.may_call("/reset1") and access.may_call("/other")
    assert not access.may_call("/offered")
    assert access.may_offer("/offered") and not access.may_offer("/reset1")


def test_by_default_everything_except_reading_is_denied() -> None:
    access = Access()
    assert not any(may("/alert_system/reset") for may in (access.may_publish, access.may_call, access.may_offer))


def test_only_reset_and_reload_of_a_monitor_may_be_called() -> None:
    access = monitor_access("/robot1/alert_system", origins=["https://studio.example.org"])
    assert access.may_call("/robot1/alert_system/reset") and access.may_call("/robot1/alert_system/reload")
    assert not access.may_call("/robot1/alert_system/set_parameters")
    assert not access.may_publish("/robot1/battery_level")
    assert access.origin_allowed("http://localhost:3000") and access.origin_allowed("https://studio.example.org")
    granted = monitor_access("/alert_system", publish=["/cmd_vel"], services=["/dock"], offer=["/x"])
    assert granted.may_publish("/cmd_vel") and granted.may_call("/dock") and granted.may_offer("/x")


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("localhost", True),
        ("LOCALHOST:9090", True),
        ("127.0.0.1:9090", True),
        ("[::1]:9090", True),
        ("localhost.evil.example:9090", False),
        ("127.0.0.1.evil.example", False),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.5", False),
        ("robot1", False),
        ("", False),
    ],
)
def test_loopback_names_and_addresses(host: str, own: bool) -> None:
    assert is_loopback(host) is own
