"""A bounded queue: the newest win, one large item may wait alone."""

from __future__ import annotations

import pytest

from robot_health_monitor.runtime.bounded_queue import BoundedQueue


def drained(queue: BoundedQueue[str]) -> list[str]:
    return [queue.pop() for _ in range(len(queue))]


def test_items_leave_in_their_order() -> None:
    queue: BoundedQueue[str] = BoundedQueue(10)
    queue.put("a", 4)
    queue.put("b", 6)
    assert (queue.size, queue.dropped) == (10, 0)
    assert drained(queue) == ["a", "b"]
    assert queue.size == 0
    with pytest.raises(IndexError):
        queue.pop()


def test_the_oldest_are_dropped_and_counted() -> None:
    queue: BoundedQueue[str] = BoundedQueue(10)
    for name in "abcd":
        queue.put(name, 4)
    assert (drained(queue), queue.dropped) == (["c", "d"], 2)


def test_an_item_above_the_bound_waits_alone() -> None:
    queue: BoundedQueue[str] = BoundedQueue(10)
    queue.put("a", 1)
    queue.put("large", 25)
    assert (len(queue), queue.size, queue.dropped) == (1, 25, 1)
    queue.put("b", 1)
    assert (drained(queue), queue.dropped) == (["b"], 2)


def test_what_is_cleared_does_not_count_as_dropped() -> None:
    queue: BoundedQueue[str] = BoundedQueue(10)
    queue.put("a", 4)
    queue.clear()
    assert (len(queue), queue.size, queue.dropped) == (0, 0, 0)
