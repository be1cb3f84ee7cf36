"""The monitor without any middleware: values, configuration, judgement, and the nodes against a port."""

from .config import MonitorConfig, SignalConfig, load_config
from .errors import ConfigError
from .model import Changes, Level, Report, Sample, Status, Transition
from .monitor import Monitor

__all__ = [
    "Changes",
    "ConfigError",
    "Level",
    "Monitor",
    "MonitorConfig",
    "Report",
    "Sample",
    "SignalConfig",
    "Status",
    "Transition",
    "load_config",
]
