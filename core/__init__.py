"""The monitor without a middleware: values, configuration and judging. `core.nodes` runs it on a middleware."""

from .config import MonitorConfig, SignalConfig, load_config
from .judge import Monitor
from .nodes.outlets import Event, Notice, Outlet, Outlets
from .values import (
    Changes,
    ConfigError,
    Level,
    LinkError,
    MessageError,
    Report,
    Sample,
    ServiceError,
    Status,
    Transition,
)

__all__ = [
    "Changes", "ConfigError", "Event", "Level", "LinkError", "MessageError", "Monitor", "MonitorConfig", "Notice",
    "Outlet", "Outlets", "Report", "Sample", "ServiceError", "SignalConfig", "Status", "Transition", "load_config",
]  # fmt: skip
