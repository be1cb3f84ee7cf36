"""The log lines that clients cause; limited in number and length."""

from __future__ import annotations

import logging
import time
from typing import Callable

from aiohttp.http import HttpProcessingError

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.runtime.log_limit import LogLimit

_LONGEST_TEXT = 500


class ClientLog:
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
        self._limit = LogLimit(lines_per_minute, clock)

    def write(self, text: str) -> None:
        """Writes a line, unless too many were written in the current minute."""
        left_out = self._limit.take()
        if left_out:
            self._write(f"{left_out} more lines about clients were suppressed")
        if left_out is not None:
            self._write(printable(" ".join(text[:_LONGEST_TEXT].split())))

    def logger(self) -> logging.Logger:
        """Returns a logger for a library: each record of level WARN or worse is one line, without traceback."""
        logger = logging.Logger("rosbridge", logging.WARNING)
        logger.addHandler(_OneLine(self))
        return logger


class _OneLine(logging.Handler):
    def __init__(self, log: ClientLog) -> None:
        super().__init__()
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, ConnectionError):
            return  # the client has gone
        if isinstance(error, HttpProcessingError):
            self._log.write(f"refused a malformed HTTP request ({type(error).__name__})")
            return
        text = next(iter(record.getMessage().splitlines()), "")[:200]
        self._log.write(f"{text}: {type(error).__name__}" if error else text)
