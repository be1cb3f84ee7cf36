"""Limits how many log lines clients can cause."""

from __future__ import annotations

import logging
import time
from typing import Callable

from aiohttp.http import HttpProcessingError

from robot_health_monitor.core.formatting import printable

__all__ = ["LogLimit"]

_PERIOD_S = 60.0
_LONGEST_TEXT = 500


class LogLimit:
    """Writes at most a number of lines per minute, in total: clients choose the texts. Used in the event loop only."""

    def __init__(
        self, write: Callable[[str], None], lines_per_minute: int = 10, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Starts with nothing written.

        Args:
            write: writes one line.
            lines_per_minute: most lines in a minute.
            clock: monotonic seconds.
        """
        self._write = write
        self._most = lines_per_minute
        self._clock = clock
        self._begin_s = float("-inf")
        self._written = 0
        self._suppressed = 0

    def write(self, text: str) -> None:
        """Writes a line, unless too many were written in the current minute."""
        now_s = self._clock()
        if now_s - self._begin_s >= _PERIOD_S:
            if self._suppressed:
                self._write(f"{self._suppressed} more lines about clients were suppressed")
            self._begin_s, self._written, self._suppressed = now_s, 0, 0
        if self._written < self._most:
            self._written += 1
            self._write(printable(" ".join(text[:_LONGEST_TEXT].split())))
        else:
            self._suppressed += 1

    def logger(self) -> logging.Logger:
        """Returns a logger for a library: each record of level WARN or worse is one line, without traceback."""
        logger = logging.Logger("rosbridge", logging.WARNING)
        logger.addHandler(_OneLine(self))
        return logger


class _OneLine(logging.Handler):
    def __init__(self, limit: LogLimit) -> None:
        super().__init__()
        self._limit = limit

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, ConnectionError):
            return  # the client has gone
        if isinstance(error, HttpProcessingError):
            self._limit.write(f"refused a malformed HTTP request ({type(error).__name__})")
            return
        text = next(iter(record.getMessage().splitlines()), "")[:200]
        self._limit.write(f"{text}: {type(error).__name__}" if error else text)
