"""The interface of every source of measurements."""

from __future__ import annotations

from typing import Protocol


class SensorError(Exception):
    """A sensor that cannot be read now. `str()` is one line: what, where, what would help."""


class NotYet(SensorError):
    """A value that is measured from one read to the next, at the first read."""


class Source(Protocol):
    """Where a value comes from."""

    def read(self, now_s: float) -> float:
        """Returns the value at `now_s`, seconds on the caller's clock, which may stand still or go back.

        Raises:
            SensorError: it cannot be read now; the next read may be luckier.
        """
