"""Sources of measurements: simulated or this machine."""

from .configuration import METRICS, read_sources
from .host import HOST_PATHS, HostPaths
from .source import NoSuchSensor, NotMeasuredYet, SensorError, Source

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
