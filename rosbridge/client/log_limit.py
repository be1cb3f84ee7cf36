"""Limits how often a log line caused by a peer is written."""

from __future__ import annotations

from typing import Callable, Dict, List

from robot_health_monitor.core.middleware import Severity

__all__ = ["LogLimit"]

_PERIOD_S = 60.0
_MOST_KINDS = 100


class LogLimit:
    """Writes one line per kind and minute, with the number of lines that were left out since the last one."""

    def __init__(self, write: Callable[[Severity, str], None], clock: Callable[[], float]) -> None:
        """Starts with nothing written.

        Args:
            write: writes a line.
            clock: monotonic seconds.
        """
        self._write = write
        self._clock = clock
        self._written: Dict[str, List[float]] = {}

    def write(self, kind: str, severity: Severity, text: str) -> None:
        """Writes a line, unless one of the same kind was written less than a minute ago.

        Args:
            kind: lines of one kind share the limit; after 100 kinds, further ones share one.
            severity: of the line.
            text: the line.
        """
        now_s = self._clock()
        if kind not in self._written and len(self._written) >= _MOST_KINDS:
            kind = ""
        written = self._written.setdefault(kind, [now_s - _PERIOD_S, 0.0])
        if now_s - written[0] < _PERIOD_S:
            written[1] += 1.0
            return
        left_out = f" ({written[1]:g} similar lines left out)" if written[1] else ""
        self._written[kind] = [now_s, 0.0]
        self._write(severity, text + left_out)
