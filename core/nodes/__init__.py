"""The three nodes, written once against the port.

Each constructor reads the parameters and starts the node, or raises ConfigError before it subscribes to anything.
"""

from .aggregator import Aggregator
from .alert_system import AlertSystem
from .battery_sensor import BatterySensor

__all__ = ["Aggregator", "AlertSystem", "BatterySensor"]
