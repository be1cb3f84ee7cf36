"""The order of messages within a file, and type names."""

from __future__ import annotations

from robot_health_monitor.recordings.recording import in_time_order


def entries(*times: int) -> list:  # type: ignore[type-arg]
    return [(time, 1, b"") for time in times]


def times(chunks: list) -> list:  # type: ignore[type-arg]
    return [time for time, _, _ in in_time_order(chunks)]


def test_messages_inside_a_chunk_are_sorted() -> None:
    assert times([entries(3, 1, 2), entries(4)]) == [1, 2, 3, 4]


def test_neighbouring_chunks_may_overlap() -> None:
    assert times([entries(1, 2, 5), entries(3, 4, 6), [], entries(7)]) == [1, 2, 3, 4, 5, 6, 7]


def test_messages_at_the_same_time_stay_in_their_order() -> None:
    chunks = [[(1, 1, b"a"), (1, 2, b"b")], [(1, 1, b"c"), (0, 1, b"z")]]
    assert [data for _, _, data in in_time_order(chunks)] == [b"z", b"a", b"b", b"c"]
