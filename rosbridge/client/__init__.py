"""The port over a WebSocket: nodes for a robot that is reached through its rosbridge server."""

from __future__ import annotations

from ...runtime.bridge.cause import Cause
from .middleware import RosbridgeClient, RosbridgeMiddleware

__all__ = ["Cause", "RosbridgeClient", "RosbridgeMiddleware"]
