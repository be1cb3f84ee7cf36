"""Bounds the work of a block: calls of functions, and memory.

Time is only the last resort, because it depends on the machine.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import tracemalloc
from types import FrameType
from typing import Any, Iterator, NamedTuple

_LONGEST_S = 20


class Work(NamedTuple):
    """An amount of work."""

    calls: int
    """Calls of functions of Python and of C."""
    bytes: int
    """Memory at the peak."""


class TooMuchWork(BaseException):
    """Not an Exception, so that no handler of the code under test stops it."""


class _Measured:
    """What the latest block took."""

    share = 0.0
    """Of the allowed work: 1.0 is the bound."""


measured = _Measured()


@contextlib.contextmanager
def limited_time() -> Iterator[None]:
    """Stops a block that takes too long.

    Raises:
        TooMuchWork: it did.
    """
    previous = signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(_LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


@contextlib.contextmanager
def bounded(allowed: Work) -> Iterator[None]:
    """Stops the block when it makes too many calls; afterwards checks the memory that it took.

    The block takes about twenty times as long.

    Raises:
        TooMuchWork: a bound is exceeded.
    """
    left = allowed.calls

    def on_call(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal left
        if event in ("call", "c_call"):
            left -= 1
            if left < 0:
                raise TooMuchWork(f"more than {allowed.calls} calls")

    tracemalloc.start()
    sys.setprofile(on_call)
    try:
        yield
    finally:
        sys.setprofile(None)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        measured.share = max(peak / allowed.bytes, 1.0 - left / allowed.calls)
    if peak > allowed.bytes:
        raise TooMuchWork(f"{peak} bytes of memory, allowed {allowed.bytes}")


def _too_long(number: int, frame: FrameType | None) -> None:
    raise TooMuchWork(f"more than {_LONGEST_S} s")
