"""The interface of every source of measurements."""

from __future__ import annotations

from typing import Protocol

from ..values import ServiceError


class SensorError(ServiceError):
    """A value that cannot be read now. `str()` is one line: the cause and, where there is one, the remedy."""


class NotMeasuredYet(SensorError):
    """No value yet: it is measured between two reads."""


class NoSuchSensor(SensorError):
    """This machine does not have the sensor at all: a desktop without a battery, a container without sensors."""


class Source(Protocol):
    """One source of one value."""

    def read(self, now_s: float) -> float:
        """Returns the current value, in the unit of its metric, or raises SensorError; `now_s` is the node's time."""
