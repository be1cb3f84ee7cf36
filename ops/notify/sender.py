"""What a target is sent about one alert, the interface of a target, and its address.

An address that contains a secret is in a file. Of any address only scheme and host are shown.
"""

from __future__ import annotations

import json
import math
import os
import stat
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Mapping, Sequence

from ...core.values import Clock, JsonObject, Level, ServiceError, count_text, with_hint
from ...runtime.times import utc_text
from ..configuration import TargetSettings, is_http, shown

_MOST_LINES = 5  # of a group
_LONGEST = 4096  # bytes of a file with an address


@dataclass(frozen=True)
class Notification:
    """One message to one target."""

    transition: JsonObject = field(hash=False)  # with the fields of `--json`
    is_resolved: bool  # the alert has ended, or is below the target's `min_level`
    at_s: float  # wall time of the transition, in s since 1970
    before: Notification | None = None
    """What the target was last sent about this alert; None if that was nothing, or its end."""
    is_test: bool = False  # sent by `robot-health notify`
    members: tuple[Notification, ...] = ()
    """Several notifications of one robot in one message, the worst first, ends last; the other fields are its."""

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return str(self.transition["robot"])

    @property
    def signal(self) -> str:
        """Name of the signal; of several the number of alerts."""
        return count_text(len(self.members), "alert") if self.members else str(self.transition["signal"])

    @property
    def level(self) -> Level:
        """The level after the transition."""
        return Level[self.transition["to_level"]]

    @property
    def text(self) -> str:
        """The alert line with its hint, after the name of the robot: many robots may share a channel.

        Of several, the number and the first lines.
        """
        if not self.members:
            return alert_line(self.transition)
        lines = [alert_line(each.transition)[len(each.robot) + 2 :] for each in self.members]
        more = [f"and {len(lines) - _MOST_LINES} more"] if len(lines) > _MOST_LINES else []
        return f"{self.robot}: {self.signal}: {'; '.join(lines[:_MOST_LINES] + more)}"

    @property
    def annotations(self) -> Mapping[str, str]:
        """What there is beside the line: the black box, what to do, and a link to the alert's page."""
        advice = str(self.transition.get("what_to_do", ""))
        parts = {
            "black_box": self.transition.get("black_box"),
            "runbook_url" if is_http(advice) else "what_to_do": advice,
            "link": self.transition.get("link"),
        }
        return {name: str(value) for name, value in parts.items() if value}

    def as_json(self) -> str:
        """Formats the transition as `--json` does, but for `text`, and with `notification`, `time` (UTC) and `test`.

        Of several: `robot`, `text`, `notification`, `time`, and as `alerts` what single messages would have been.
        """
        return json.dumps(self._fields())

    def _fields(self) -> JsonObject:
        fields = {"robot": self.robot, "alerts": [each._fields() for each in self.members]}
        return {
            **(fields if self.members else self.transition),
            "text": self.text,
            "notification": "resolved" if self.is_resolved else "firing",
            "time": utc_text(self.at_s),
            **({"test": True} if self.is_test else {}),
        }


def group_of(members: Sequence[Notification]) -> Notification:
    """Returns one message for several notifications of a robot; of one, itself."""
    if len(members) == 1:
        return members[0]
    ordered = sorted(members, key=lambda each: (each.is_resolved, -each.level.severity, each.at_s))
    first, at_s = ordered[0], max(each.at_s for each in members)
    return Notification(first.transition, first.is_resolved, at_s, members=tuple(ordered))


def alert_line(transition: JsonObject) -> str:
    """Returns the line of a transition, with its hint, after the name of its robot. Older files have no hint.

    >>> alert_line({"robot": "husky1", "text": "link ERROR: down: refused (was OK for 2 h)"})
    'husky1: link ERROR: down: refused (was OK for 2 h)'
    """
    return f"{transition['robot']}: {with_hint(str(transition['text']), str(transition.get('hint', '')))}"


class DeliveryError(ServiceError):
    """One attempt failed. `str()` is one line, without secrets: of an address only scheme and host."""

    def __init__(
        self,
        text: str,
        *,
        is_refused: bool = False,  # the target rejects this notification; another attempt will probably fail as well
        may_have_arrived: bool = True,  # False if the target certainly did not receive it
        retry_after_s: float = 0.0,  # the target requests this wait, in s
    ) -> None:
        """Stores what failed and why."""
        super().__init__(text)
        self.is_refused = is_refused
        self.may_have_arrived = may_have_arrived
        self.retry_after_s = retry_after_s


class Sender(ABC):
    """Delivers notifications to one target; used by one thread. A call may block until the target's timeout.

    A file with an address is read before each use, so that a secret can be replaced at any time.
    """

    repeat_every_s = math.inf
    """Period at which open alerts are repeated, in s; infinity if they are sent once."""

    def __init__(self, settings: TargetSettings, wall_time_s: Clock = time.time) -> None:
        """Connects to nothing, and reads nothing yet. `wall_time_s` returns seconds since 1970."""
        self._settings = settings
        self._wall_time_s = wall_time_s
        self.place = settings.url_file or "".join(settings.command[:1]) or shown(settings.url)
        """Where the target is, without secrets: scheme and host; before a file has been read, its name."""
        self.warning = ""
        """One line that is no failure, if other users may read the file; empty if they may not, as far as is known."""

    @abstractmethod
    def send(self, notification: Notification) -> str:
        """Delivers a notification and returns how the target responded; raises DeliveryError if that failed."""

    def repeat(self, alerts: Sequence[Notification]) -> None:  # noqa: B027 - optional
        """Repeats open alerts; called only with `repeat_every_s`. Raises DeliveryError."""

    def close(self) -> None:  # noqa: B027 - optional
        """Ends a call of `send` in another thread early, where that is possible."""

    def addresses(self) -> tuple[str, ...]:
        """Returns the lines of the file that are neither empty nor comments (`#`), or the given address.

        Raises DeliveryError if the file cannot be read or is empty.
        """
        file = self._settings.url_file
        if not file:
            return (self._settings.url,)
        try:
            mode = os.stat(file).st_mode
            if not stat.S_ISREG(mode):  # opening a named pipe would wait for a writer
                raise self._unusable("cannot be read: expected a file, got something else")
            with open(file, "rb") as stream:
                contents = stream.read(_LONGEST + 1)
        except (OSError, ValueError) as error:
            raise self._unusable(f"cannot be read: {getattr(error, 'strerror', error)}") from None
        advice = "every user of this machine can read this address; protect it with chmod 600"
        self.warning = f"{file}: {advice}" if mode & stat.S_IROTH else ""
        if len(contents) > _LONGEST:
            raise self._unusable(f"expected at most {_LONGEST} bytes, got more")
        lines = [line.strip() for line in contents.decode("utf-8", "replace").splitlines()]
        addresses = tuple(line for line in lines if line and not line.startswith("#"))
        if not addresses:
            raise self._unusable("expected an address, got an empty file")
        self.place = ", ".join(dict.fromkeys(shown(line) for line in addresses))
        return addresses

    def http_address(self) -> str:
        """Returns the address of HTTP; raises DeliveryError if the file cannot be read, or holds something else."""
        url, *others = self.addresses()
        if others or not is_http(url) or not all("!" <= letter <= "~" for letter in url):
            self.place = self._settings.url_file or self.place
            raise self._unusable("expected one address, http://... or https://..., without blanks")
        return url

    def _unusable(self, problem: str) -> DeliveryError:
        return DeliveryError(f"{self._settings.url_file or 'url'}: {problem}", may_have_arrived=False)
