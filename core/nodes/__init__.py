"""The three nodes, written once against the port.

Each reads its parameters and starts in its constructor, or raises ConfigError before it has subscribed to anything.
"""

from .aggregator import Aggregator
from .alert_system import AlertSystem
from .battery_sensor import BatterySensor

__all__ = ["Aggregator", "AlertSystem", "BatterySensor"]
