"""The monitor without a middleware: values, configuration and judging. `core.nodes` runs it on a middleware."""

from .config import MonitorConfig, load_config
from .errors import ConfigError, LinkError, MessageError, ServiceError
from .model import Changes, Level, Report, Sample, Status, Transition
from .monitor import Monitor
from .outlets import Event, Notice, Outlet, Outlets
from .signal_config import SignalConfig

__all__ = [
    "Changes", "ConfigError", "Event", "Level", "LinkError", "MessageError", "Monitor", "MonitorConfig", "Notice",
    "Outlet", "Outlets", "Report", "Sample", "ServiceError", "SignalConfig", "Status", "Transition", "load_config",
]  # fmt: skip
