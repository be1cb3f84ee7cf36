from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.rosbridge.protocol.limits import shown


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("short", "'short'"),
        ("x" * 1000, "'" + "x" * 36 + "..."),
        ("\x1b[2J\u202e\n", r"'\x1b[2J\u202e\n'"),
        ([1, 2], "a list"),
        ({}, "an object"),
        (10**400, "a very large number"),
        (1.5, "1.5"),
    ],
)
def test_a_shown_value_is_short_and_printable(value: Any, text: str) -> None:
    assert shown(value) == text
