"""A queue that drops its oldest items rather than grow."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class BoundedQueue(Generic[Item]):
    """Items that wait, with their sizes. Needs a lock where several threads use it."""

    def __init__(self, bound: float) -> None:
        """Starts empty. At most `bound` of size waits; one larger item may wait alone."""
        self._bound = bound
        self._items: deque[tuple[Item, int]] = deque()
        self.size = 0
        """Of all items that wait."""
        self.dropped = 0
        """Items that were dropped."""

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: Item, size: int) -> int:
        """Adds an item, and drops the oldest ones if too much waits; returns how many."""
        self._items.append((item, size))
        self.size += size
        dropped = 0
        while self.size > self._bound and len(self._items) > 1:
            self.pop()
            dropped += 1
        self.dropped += dropped
        return dropped

    def pop(self) -> Item:
        """Removes and returns the oldest item; raises IndexError if there is none."""
        item, size = self._items.popleft()
        self.size -= size
        return item

    def clear(self) -> None:
        """Removes all items, which do not count as dropped."""
        self._items.clear()
        self.size = 0
