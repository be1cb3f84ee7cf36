from __future__ import annotations

from typing import Dict, Optional

import pytest
from aiohttp.test_utils import make_mocked_request

from robot_health_monitor.rosbridge.server.access import Access
from robot_health_monitor.rosbridge.server.request_check import check_request


def check(headers: Dict[str, str], access: Access, method: str = "GET", path: str = "/") -> Optional[int]:
    refusal = check_request(make_mocked_request(method, path, headers), access, check_host=not access.token)
    if refusal is None:
        return None
    assert refusal.log_text.isprintable()
    return refusal.status


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
    ("headers", "path", "status"),
    [
        ({"Host": "robot:9090", "Authorization": "Bearer s3cret"}, "/", None),
        ({"Host": "robot:9090"}, "/?token=s3cret", None),
        ({"Host": "robot:9090"}, "/", None),  # the caller decides whether a token is needed
        ({"Host": "robot:9090", "Authorization": "Bearer wrong"}, "/", 401),
        ({"Host": "robot:9090"}, "/?token=wrong", 401),
        ({"Host": "robot:9090", "Origin": "http://robot:9090"}, "/", None),
        ({"Host": "robot:9090", "Origin": "https://evil.example"}, "/?token=s3cret", 403),
    ],
)
def test_with_a_token_origin_and_token_are_checked(headers: Dict[str, str], path: str, status: Optional[int]) -> None:
    assert check(headers, Access(token="s3cret"), path=path) == status


def test_neither_the_log_nor_the_client_sees_the_token() -> None:
    request = make_mocked_request("GET", "/?token=guessed", {"Host": "robot"})
    refusal = check_request(request, Access(token="s3cret"), check_host=False)
    assert refusal is not None
    assert not any(secret in " ".join(map(str, refusal)) for secret in ("guessed", "s3cret"))
    assert refusal.response().headers["WWW-Authenticate"] == "Bearer"
