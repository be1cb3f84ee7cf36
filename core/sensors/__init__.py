"""Sources of measurements: simulated or this machine."""

from .configuration import METRICS, read_sources
from .source import NoSuchSensor, NotMeasuredYet, SensorError, Source
from .sysfs import HOST_PATHS, HostPaths

__all__ = [
    "HOST_PATHS",
    "METRICS",
    "HostPaths",
    "NoSuchSensor",
    "NotMeasuredYet",
    "SensorError",
    "Source",
    "read_sources",
]
