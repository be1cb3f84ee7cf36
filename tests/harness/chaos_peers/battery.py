"""A robot's battery: the latest number of stdin is its level, and what the robot notices goes to stdout.

A peer writes one line per period, `connected` or `waiting`, and `alert` with the level of each alert.
"""

from __future__ import annotations

import sys
import threading

LEVELS = ("OK", "WARN", "ERROR", "STALE")
PERIOD_S = 0.05


class Battery:
    """Its level, in %."""

    def __init__(self) -> None:
        """Reads stdin in a thread until it is closed."""
        self.level = 50.0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            self.level = float(line)


def write_period(is_connected: bool) -> None:
    """Writes that a period has passed, and whether the monitor is connected in both directions."""
    _write("connected" if is_connected else "waiting")


def write_alert(name: str, level: int) -> None:
    """Writes an alert of the battery; `name` is that of the DiagnosticStatus."""
    if name.endswith(": battery_level"):
        _write(f"alert {LEVELS[level]}")


def _write(line: str) -> None:
    """Writes a line at once: `print` writes its end apart, and two threads write here."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
