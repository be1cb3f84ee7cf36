"""Texts of wall times, in seconds since 1970. A time from a file may be one that no calendar has."""

from __future__ import annotations

from datetime import datetime, timezone, tzinfo

DATE_TIME = "%Y-%m-%d %H:%M:%S"
_LATEST_S = 253_402_300_799.0
"""The end of the year 9999."""


def iso_time(wall_s: float) -> str | None:
    """Returns a time as ISO 8601 in UTC, with milliseconds; None where there is no such date."""
    try:
        return datetime.fromtimestamp(wall_s, timezone.utc).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    except (ValueError, OverflowError, OSError):
        return None


def utc_text(wall_s: float) -> str:
    """Returns a time as `iso_time`, rounded to milliseconds; the nearest one from 1970 to 9999, as RFC 3339 requires.

    >>> utc_text(1700000000.5)
    '2023-11-14T22:13:20.500Z'
    """
    return iso_time(round(min(max(wall_s, 0.0), _LATEST_S), 3)) or ""


def local_time(wall_s: float, form: str = DATE_TIME, zone: tzinfo | None = None) -> str:
    """Formats a time as `strftime` does, in a time zone or the local one; in seconds if no calendar has that date."""
    try:
        return datetime.fromtimestamp(wall_s, timezone.utc).astimezone(zone).strftime(form)
    except (ValueError, OverflowError, OSError):
        return f"{wall_s:.0f} s"
