"""Limits how often log lines caused by a peer are written."""

from __future__ import annotations

from typing import Callable

from ..values import Clock
from .middleware import Severity

_PERIOD_S = 60.0
_MOST_KINDS = 100


class LimitedLog:
    """Writes some lines per kind and minute, with the number of lines that were left out in the minute before."""

    def __init__(self, write: Callable[[Severity, str], None], clock: Clock, most: int = 1) -> None:
        """Starts with nothing written; `clock` gives monotonic seconds, `most` is the most lines per minute."""
        self._write = write
        self._clock = clock
        self._most = most
        self._minutes: dict[str, tuple[float, int]] = {}
        """Of each kind, the begin of the minute in s, and the lines in it."""

    def write(self, kind: str, severity: Severity, text: str) -> None:
        """Writes a line, unless it is one too many of its kind in a minute; after 100 kinds, others are one kind."""
        now_s = self._clock()
        if kind not in self._minutes and len(self._minutes) >= _MOST_KINDS:
            kind = ""
        begin_s, count = self._minutes.get(kind, (now_s, 0))
        left_out = 0
        if now_s - begin_s >= _PERIOD_S:
            left_out = max(0, count - self._most)
            begin_s, count = now_s, 0
        self._minutes[kind] = begin_s, count + 1
        if count < self._most:
            self._write(severity, f"{text} ({left_out} similar lines left out)" if left_out else text)
