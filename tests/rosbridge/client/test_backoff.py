"""The delays between attempts to connect."""

from __future__ import annotations

from typing import List, Optional

import pytest

from robot_health_monitor.rosbridge.client.backoff import ConnectBackoff


def delays(held: List[Optional[float]]) -> List[float]:
    backoff = ConnectBackoff(chance=lambda: 1.0)
    return [backoff.next_s(held_s) for held_s in held]


def test_delays_grow_while_a_server_cannot_be_reached_but_stay_short() -> None:
    assert delays([None] * 7) == [0.2, 0.4, 0.8, 1.2, 1.2, 1.2, 1.2]


def test_delays_grow_to_half_a_minute_while_a_server_accepts_and_closes() -> None:
    assert delays([0.01] * 10) == pytest.approx([0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6, 30.0, 30.0])


def test_delays_grow_while_connections_break_within_ten_seconds() -> None:
    assert delays([9.9] * 6) == [0.2, 0.4, 0.8, 1.2, 1.2, 1.2]


def test_a_connection_that_held_for_ten_seconds_starts_the_delays_again() -> None:
    assert delays([None, None, None, 10.0, None]) == [0.2, 0.4, 0.8, 0.2, 0.4]


def test_a_server_that_becomes_unreachable_after_many_short_connections_is_tried_often_again() -> None:
    assert delays([0.01] * 9 + [None])[-2:] == [30.0, 1.2]


def test_delays_are_spread_between_half_and_all_of_their_length() -> None:
    firsts = [ConnectBackoff().next_s(None) for _ in range(200)]
    assert all(0.1 <= first <= 0.2 for first in firsts)
    assert len(set(firsts)) > 100
