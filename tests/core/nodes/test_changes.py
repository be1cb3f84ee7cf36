"""What a change of configuration changed, as one line."""

from __future__ import annotations

import pytest

from robot_health_monitor.core.nodes.changes import Sections, describe_changes


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ({}, {}, "nothing changed"),
        ({"": {"rate": 1.0}}, {"": {"rate": 1.0}}, "nothing changed"),
        ({"": {"rate": 1.0}}, {"": {"rate": 2.5}}, "rate: 1 -> 2.5"),
        ({"wheel": {"warn_above": None}}, {"wheel": {"warn_above": 3.0}}, "wheel.warn_above: none -> 3"),
        ({"wheel": {"latch": False}}, {"wheel": {"latch": True}}, "wheel.latch: false -> true"),
        ({"wheel": {"unit": ""}}, {"wheel": {"unit": "m/s"}}, 'wheel.unit: "" -> m/s'),
        ({"wheel": {"placeholders": ()}}, {"wheel": {"placeholders": (0.0,)}}, "wheel.placeholders: [] -> [0]"),
        ({"wheel": {"rate": 1}}, {"wheel": {}}, "wheel.rate: 1 -> none"),
        ({"imu": {}}, {"wheel": {}}, "added wheel; removed imu"),
    ],
)
def test_a_change_is_described_by_its_old_and_new_value(old: Sections, new: Sections, text: str) -> None:
    assert describe_changes(old, new) == text
