from __future__ import annotations

from typing import Dict, Optional

import pytest
from aiohttp.test_utils import make_mocked_request

from robot_health_monitor.rosbridge.server.access import Access
from robot_health_monitor.rosbridge.server.request_check import check_request


def check(headers: Dict[str, str], access: Access, method: str = "GET") -> Optional[int]:
    refusal = check_request(make_mocked_request(method, "/", headers), access, check_host=not access.token)
    if refusal is None:
        return None
    assert refusal.log_text.isprintable()
    return refusal.response().status


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
