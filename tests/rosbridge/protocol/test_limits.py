from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core.values.errors import MessageError
from robot_health_monitor.rosbridge.protocol.limits import DEFAULT_LIMITS, ProtocolError, shown
from robot_health_monitor.rosbridge.protocol.operations import MOST_FRAGMENTS, SMALLEST_FRAGMENT


def test_a_message_in_the_smallest_fragments_is_within_the_limits_of_a_receiver() -> None:
    assert DEFAULT_LIMITS.message_bytes <= MOST_FRAGMENTS * SMALLEST_FRAGMENT


def test_the_text_names_operation_and_problem() -> None:
    error = ProtocolError("field topic is missing", "publish", "p1")
    assert isinstance(error, MessageError)
    assert (str(error), error.id) == ("publish: field topic is missing", "p1")


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
