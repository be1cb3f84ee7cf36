"""Foxglove's WebSocket protocol as pure code, and a client that implements the port."""

from .middleware import FoxgloveClient, FoxgloveMiddleware

__all__ = ["FoxgloveClient", "FoxgloveMiddleware"]
