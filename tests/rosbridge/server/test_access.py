from __future__ import annotations

from typing import Dict, Optional

import pytest
from aiohttp.test_utils import make_mocked_request

from robot_health_monitor.rosbridge.server.access import Access, check_request, is_loopback, monitor_access


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


def check(headers: Dict[str, str], access: Access, method: str = "GET") -> Optional[int]:
    refusal = check_request(make_mocked_request(method, "/", headers), access, check_host=not access.token)
    if refusal is None:
        return None
    assert refusal.log_text.isprintable()
    return 403


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "localhost:9090"}, None),
        ({"Host": "127.0.0.1:9090", "Origin": "http://127.0.0.1:9090"}, None),
        ({"Host": "evil.example"}, 403),
        ({}, 403),
        ({"Host": "localhost:9090", "Origin": "https://evil.example"}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 403),
        ({"Host": "localhost", "Authorization": "Bearer anything"}, None),
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST", "DELETE"])
def test_without_a_token_host_and_origin_must_be_local(
    headers: Dict[str, str], status: Optional[int], method: str
) -> None:
    assert check(headers, Access(), method) == status


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "robot:9090"}, None),
        ({"Host": "robot:9090", "Origin": "http://robot:9090"}, None),
        ({"Host": "robot:9090", "Origin": "https://evil.example"}, 403),
    ],
)
def test_with_a_token_only_the_origin_is_checked(headers: Dict[str, str], status: Optional[int]) -> None:
    assert check(headers, Access(token="s3cret")) == status
