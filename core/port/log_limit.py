"""Limits how often log lines caused by a peer are written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Dict, Optional

from .middleware import Severity

_PERIOD_S = 60.0
_MOST_KINDS = 100


class LogLimit:
    """Lets a number of lines per kind and minute pass."""

    def __init__(self, most: int, clock: Callable[[], float]) -> None:
        """Starts with nothing written; `most` is the most lines of a kind in a minute, `clock` gives monotonic s."""
        self._most = most
        self._clock = clock
        self._minutes: Dict[str, _Minute] = {}

    def take(self, kind: str = "") -> Optional[int]:
        """Returns how many lines of a kind were left out in the minute before; None: this one is to be left out.

        Call before a line is written. After 100 kinds, further ones share their limit.
        """
        now_s = self._clock()
        if kind not in self._minutes and len(self._minutes) >= _MOST_KINDS:
            kind = ""
        minute = self._minutes.get(kind)
        if minute is None or now_s - minute.begin_s >= _PERIOD_S:
            self._minutes[kind] = _Minute(now_s)
            return 0 if minute is None else minute.left_out
        if minute.written < self._most:
            minute.written += 1
            return 0
        minute.left_out += 1
        return None


@dataclass
class _Minute:
    """The lines of one kind since the begin of a minute."""

    begin_s: float
    written: int = 1
    left_out: int = 0


class LimitedLog:
    """Writes some lines per kind and minute, with the number of lines that were left out since the last one."""

    def __init__(self, write: Callable[[Severity, str], None], clock: Callable[[], float], most: int = 1) -> None:
        """Starts with nothing written; `clock` gives monotonic seconds, `most` is the most lines per minute."""
        self._write = write
        self._limit = LogLimit(most, clock)

    def write(self, kind: str, severity: Severity, text: str) -> None:
        """Writes a line, unless it is one too many of its kind in a minute; see `LogLimit.take`."""
        left_out = self._limit.take(kind)
        if left_out is not None:
            self._write(severity, f"{text} ({left_out} similar lines left out)" if left_out else text)
