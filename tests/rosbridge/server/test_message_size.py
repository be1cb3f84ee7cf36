from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.rosbridge.server.message_size import LARGE_BYTES, estimated_bytes


@pytest.mark.parametrize(
    "message",
    [
        {"data": "x" * 1_000_000},
        {"data": b"x" * 1_000_000},
        {"header": {"seq": 1}, "ranges": [0.5] * 10_000},
        {"status": [{"values": [{"key": "k" * 50, "value": "v" * 50}] * 20}] * 100},
        {"names": ["n" * 100] * 1_000},
    ],
)
def test_large_messages_are_recognised(message: Any) -> None:
    assert estimated_bytes(message) > LARGE_BYTES


@pytest.mark.parametrize("message", [{"data": 19.5}, {"data": "x" * 1_000}, {"ranges": [0.5] * 360}, {}, None, b""])
def test_small_messages_are_encoded_at_once(message: Any) -> None:
    assert estimated_bytes(message) < LARGE_BYTES


@pytest.mark.parametrize("size", [1_000, 1_000_000])
def test_the_estimate_follows_the_length_of_texts(size: int) -> None:
    assert size <= estimated_bytes({"data": "x" * size}) <= size + 1_000


def test_every_element_of_a_short_list_counts() -> None:
    assert estimated_bytes(["", "x" * 1_000_000, "", "", ""]) > 1_000_000
