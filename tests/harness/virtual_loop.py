"""An event loop whose time is virtual: a day passes as fast as it can be computed. Without sockets and threads."""

from __future__ import annotations

import asyncio
import random
import selectors
from typing import Any, Callable, Coroutine


class _Selector(selectors.SelectSelector):
    """Lets time pass instead of waiting."""

    def __init__(self, late_s: Callable[[], float]) -> None:
        super().__init__()
        self.now_s = 0.0
        self._late_s = late_s

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        assert timeout is not None, "nothing left to wait for"
        if timeout > 0.0:
            self.now_s += timeout + self._late_s()
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """Timers are up to 2 ms late, as in reality."""

    def __init__(self, seed: int = 1) -> None:
        jitter = random.Random(seed)
        self.selector = _Selector(lambda: jitter.uniform(0.0, 0.002))
        super().__init__(self.selector)

    def time(self) -> float:
        return self.selector.now_s


def run_in_virtual_time(work: Coroutine[Any, Any, None]) -> None:
    """Does what `asyncio.run` does."""
    loop = VirtualLoop()
    asyncio.set_event_loop(loop)
    try:
        loop.run_until_complete(work)
        for task in asyncio.all_tasks(loop):
            task.cancel()
        loop.run_until_complete(asyncio.sleep(0))
    finally:
        asyncio.set_event_loop(None)
        loop.close()
