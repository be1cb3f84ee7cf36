"""Times that come again every week, such as `mon-fri 22:00-06:00`: data that knows whether it contains a moment."""

from __future__ import annotations

import importlib
import os
import re
from dataclasses import dataclass
from datetime import datetime, time, timezone, tzinfo
from functools import lru_cache

from ...core.values import ConfigError

DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")

_RULE = re.compile(r"(?:([a-z,-]+) )?(\d\d:\d\d)-(\d\d:\d\d)\Z", re.ASCII)
_ZONES = "/zoneinfo/"


@dataclass(frozen=True)
class Recurrence:
    """A time of the day on some days of the week, in a time zone."""

    text: str
    """As it was given."""
    zone: str
    """Name of the time zone, such as `Europe/Berlin`."""
    days: frozenset[int]
    """The days on which it begins; 0 is Monday."""
    begin: time
    end: time
    """On the next day if it is not after `begin`."""

    def __str__(self) -> str:
        return f"every {self.text} ({self.zone})"

    def contains(self, wall_s: float) -> bool:
        """Returns whether it contains a time in s since 1970."""
        now = datetime.fromtimestamp(wall_s, zone_of(self.zone))
        # An ambiguous time is the first one: when the clock shows it again, the whole hour has passed.
        at = now.time().replace(minute=59) if now.fold else now.time()
        today, yesterday = now.weekday() in self.days, (now.weekday() - 1) % 7 in self.days
        if self.begin < self.end:
            return today and self.begin <= at < self.end
        return (today and at >= self.begin) or (yesterday and at < self.end)


@lru_cache(maxsize=2000)
def parse_recurrence(text: str, zone: str = "") -> Recurrence:
    """Reads a rule: days from `mon` to `sun`, as lists and ranges, which may wrap, and times; no days are all days.

    `zone` is the name of a time zone, that of this machine if it is empty.

    Raises:
        ConfigError: it is not of this form, a day, a time or the zone does not exist, or the zone cannot be read.
    """
    match = _RULE.match(" ".join(text.lower().split()))
    try:
        if match is None:
            raise ValueError
        days, begin, end = match.groups("mon-sun")
        rule = _days(days), time.fromisoformat(begin), time.fromisoformat(end)
    except ValueError:
        raise ConfigError(f'expected days and times such as "mon-fri 22:00-06:00", got {text[:60]!r}') from None
    zone = zone or machine_zone()
    zone_of(zone)
    return Recurrence(match[0], zone, *rule)


def machine_zone() -> str:
    """Returns the name of this machine's time zone; raises ConfigError if it is unknown."""
    given = os.environ.get("TZ", "").lstrip(":")
    path = given or os.path.realpath("/etc/localtime")
    if _ZONES in path:
        return path.partition(_ZONES)[2]
    if given:
        return given
    if not os.path.exists("/etc/localtime"):
        return "UTC"
    raise ConfigError("the time zone of this machine has no name; expected --timezone, such as Europe/Berlin")


@lru_cache(maxsize=100)
def zone_of(name: str) -> tzinfo:
    """Returns a time zone by its name; raises ConfigError if there is none, or its data cannot be read."""
    if name == "UTC":
        return timezone.utc
    try:
        zone: tzinfo | None = importlib.import_module("zoneinfo").ZoneInfo(name)
    except ImportError:  # Python 3.8
        try:
            zone = importlib.import_module("dateutil.tz").gettz(name)
        except ImportError:
            raise ConfigError("time zones need Python 3.9, or the package python3-dateutil (pip: dateutil)") from None
    except (KeyError, ValueError, OSError):
        zone = None
    if zone is None:
        raise ConfigError(f"there is no time zone {name[:60]!r}")
    return zone


def _days(text: str) -> frozenset[int]:
    """Returns the days of lists and ranges; raises ValueError if one does not exist."""
    days = set()
    for part in text.split(","):
        first, is_range, last = part.partition("-")
        begin, end = DAYS.index(first), DAYS.index(last if is_range else first)
        days |= {day % 7 for day in range(begin, end + 1 if end >= begin else end + 8)}
    return frozenset(days)
