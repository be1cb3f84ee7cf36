"""A stream whose reader does not read."""

from __future__ import annotations

import os


def fill(file: int) -> None:
    """Fills a pipe or a terminal, so that the next write to this file descriptor blocks."""
    os.set_blocking(file, False)
    try:
        while True:
            os.write(file, b"x" * 4096)
    except BlockingIOError:
        os.set_blocking(file, True)
