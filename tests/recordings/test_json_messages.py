"""Messages that are recorded as JSON."""

from __future__ import annotations

import math
from typing import Any

import pytest

pytest.importorskip("mcap")

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.recordings.json_messages import json_getter
from robot_health_monitor.recordings.recording import Channel


def read(data: bytes, field: str, type_name: str = "std_msgs/Float32") -> Any:
    return json_getter(Channel("/a", type_name, "json", "{}", "jsonschema"), field)(data)


def test_fields_are_read() -> None:
    assert read(b'{"data": 1.5}', "data") == 1.5
    assert read(b'{"data": "low"}', "data", "std_msgs/String") == "low"
    assert read(b'{"data": {"x": [1, 2]}}', "data.x[1]", "own_msgs/Thing") == 2
    assert read(b'{"data": 1.5}', "") == {"data": 1.5}
    assert math.isnan(read(b'{"data": null}', "data"))


@pytest.mark.parametrize("data", [b"", b"1", b"[]", b"\xff", b"{", b"{}", b"[" * 100_000, b'{"data": {' * 50_000])
def test_bytes_that_are_no_such_message_raise_value_error(data: bytes) -> None:
    with pytest.raises(ValueError):
        read(data, "data")


def test_a_field_that_the_type_does_not_have_is_refused() -> None:
    with pytest.raises(ConfigError, match="has no field"):
        read(b"{}", "date")
