from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.rosbridge.protocol.errors import ProtocolError
from robot_health_monitor.rosbridge.protocol.fragments import Reassembly, split
from robot_health_monitor.rosbridge.protocol.limits import Limits


def fragment(data: str, num: Any, total: Any, id: Any = "a") -> Any:  # noqa: A002 - the protocol's word
    return {"op": "fragment", "id": id, "data": data, "num": num, "total": total}


def test_a_text_is_split_as_the_protocol_has_it() -> None:
    assert list(split("abcdefgh", 3, "x")) == [
        {"op": "fragment", "id": "x", "data": "abc", "num": 0, "total": 3},
        {"op": "fragment", "id": "x", "data": "def", "num": 1, "total": 3},
        {"op": "fragment", "id": "x", "data": "gh", "num": 2, "total": 3},
    ]


def test_fragments_may_come_in_any_order_and_twice() -> None:
    reassembly = Reassembly(Limits())
    assert reassembly.add(fragment("c", 2, 3), 0.0) is None
    assert reassembly.add(fragment("a", 0, 3), 0.0) is None
    assert reassembly.add(fragment("?", 0, 3), 0.0) is None
    assert reassembly.add(fragment("b", 1, 3), 0.0) == "abc"


def test_messages_may_be_mixed() -> None:
    reassembly = Reassembly(Limits())
    assert reassembly.add(fragment("a", 0, 2, "one"), 0.0) is None
    assert reassembly.add(fragment("x", 0, 2, 2), 0.0) is None
    assert reassembly.add(fragment("b", 1, 2, "one"), 0.0) == "ab"
    assert reassembly.add(fragment("y", 1, 2, 2), 0.0) == "xy"


def test_the_reference_servers_total_is_understood() -> None:
    """It divides without rounding: 90 characters in pieces of 30 have the total 3.966..."""
    reassembly = Reassembly(Limits())
    total = (90 - 1) / 30 + 1
    assert reassembly.add(fragment("a", 0, total), 0.0) is None
    assert reassembly.add(fragment("b", 1, total), 0.0) is None
    assert reassembly.add(fragment("c", 2, total), 0.0) == "abc"


@pytest.mark.parametrize(
    ("num", "total"),
    [(2, 2), (-1, 2), (0, 0), (0, -1), (0, 10_001), ("0", 2), (None, 2), (0, None), (True, 2), (0, 1e300), (0.0, "2")],
)
def test_a_number_beyond_its_total_is_refused(num: Any, total: Any) -> None:
    with pytest.raises(ProtocolError):
        Reassembly(Limits()).add(fragment("a", num, total), 0.0)


def test_a_total_that_changes_drops_the_message() -> None:
    reassembly = Reassembly(Limits())
    reassembly.add(fragment("a", 0, 2), 0.0)
    with pytest.raises(ProtocolError, match="total: expected 2 as before, got 3"):
        reassembly.add(fragment("b", 1, 3), 0.0)
    assert reassembly.add(fragment("b", 1, 2), 0.0) is None


def test_more_than_the_limit_is_refused_and_forgotten() -> None:
    reassembly = Reassembly(Limits(message_bytes=10))
    reassembly.add(fragment("12345678", 0, 2), 0.0)
    with pytest.raises(ProtocolError, match="more than 10 characters"):
        reassembly.add(fragment("901", 1, 2), 0.0)
    assert reassembly.add(fragment("1234567890", 0, 1, "b"), 0.0) == "1234567890"


def test_the_oldest_of_too_many_messages_is_dropped() -> None:
    reassembly = Reassembly(Limits(partial_messages=2))
    for name in "abc":
        reassembly.add(fragment("1", 0, 2, name), 0.0)
    assert reassembly.add(fragment("2", 1, 2, "b"), 0.0) == "12"
    assert reassembly.add(fragment("2", 1, 2, "a"), 0.0) is None


def test_a_message_that_does_not_go_on_is_dropped_after_the_timeout() -> None:
    reassembly = Reassembly(Limits(fragment_timeout_s=60.0))
    reassembly.add(fragment("a", 0, 2), 0.0)
    reassembly.add(fragment("x", 0, 2, "kept"), 1.0)
    assert reassembly.add(fragment("y", 1, 2, "kept"), 60.5) == "xy"
    assert reassembly.add(fragment("b", 1, 2), 60.5) is None
