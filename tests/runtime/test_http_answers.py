from __future__ import annotations

import json

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which answers requests, is not installed")

from robot_health_monitor.runtime.http_answers import json_bytes, json_error


def test_json_is_ascii_and_has_no_nan() -> None:
    assert json_bytes({"ü": "\ud800", "n": 1.5}) == b'{"\\u00fc":"\\ud800","n":1.5}'
    with pytest.raises(ValueError):
        json_bytes(float("nan"))


def test_an_error_is_one_key_and_is_never_cached() -> None:
    response = json_error(429, "wait", {"Retry-After": "3"})
    assert (response.status, json.loads(response.body)) == (429, {"error": "wait"})
    assert response.headers["Retry-After"] == "3"
    assert response.headers["Cache-Control"] == "no-store"
    assert response.headers["X-Content-Type-Options"] == "nosniff"
