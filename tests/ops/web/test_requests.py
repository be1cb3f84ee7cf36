"""JSON and errors; test_interface.py sends real requests."""

from __future__ import annotations

import json
from typing import Mapping

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from aiohttp.test_utils import make_mocked_request

from robot_health_monitor.ops.web.requests import ApiError, check_same_origin, json_bytes


def test_json_is_ascii_and_has_no_nan() -> None:
    assert json_bytes({"ü": "\ud800", "n": 1.5}) == b'{"\\u00fc":"\\ud800","n":1.5}'
    with pytest.raises(ValueError):
        json_bytes(float("nan"))


def test_an_error_is_one_key_and_is_never_cached() -> None:
    response = ApiError(429, "wait", {"Retry-After": "3"}).response()
    assert (response.status, json.loads(response.body)) == (429, {"error": "wait"})
    assert response.headers["Retry-After"] == "3"
    assert response.headers["Cache-Control"] == "no-store"
    assert response.headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    ("headers", "allowed"),
    [
        ({}, True),
        ({"Origin": "http://robot:9090"}, True),
        ({"Origin": "http://ROBOT:9090", "Sec-Fetch-Site": "same-origin"}, True),
        ({"Origin": "http://robot"}, False),
        ({"Origin": "http://robot:9091"}, False),
        ({"Origin": "http://robot:9090.evil.org"}, False),
        ({"Origin": "http://[robot:9090"}, False),
        ({"Origin": "null"}, False),
        ({"Origin": "http://robot:9090", "Sec-Fetch-Site": "cross-site"}, False),
    ],
)
def test_only_the_servers_own_page_may_change_something(headers: Mapping[str, str], allowed: bool) -> None:
    request = make_mocked_request("POST", "/api/reset", headers={"Host": "robot:9090", **headers})
    if allowed:
        check_same_origin(request)
    else:
        with pytest.raises(ApiError) as caught:
            check_same_origin(request)
        assert caught.value.status == 403
