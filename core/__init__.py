"""The monitor without a middleware: values, configuration and judging. `core.nodes` runs it on a middleware."""

from .config.monitor_config import MonitorConfig, load_config
from .config.signal_config import SignalConfig
from .judge.monitor import Monitor
from .nodes.outlets import Event, Notice, Outlet, Outlets
from .values.errors import ConfigError, LinkError, MessageError, ServiceError
from .values.model import Changes, Level, Report, Sample, Status, Transition

__all__ = [
    "Changes", "ConfigError", "Event", "Level", "LinkError", "MessageError", "Monitor", "MonitorConfig", "Notice",
    "Outlet", "Outlets", "Report", "Sample", "ServiceError", "SignalConfig", "Status", "Transition", "load_config",
]  # fmt: skip
