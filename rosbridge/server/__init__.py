"""The rosbridge server: serves any implementation of the port to rosbridge clients."""

from ...runtime.access import Access
from .server import Server, ServerThread

__all__ = ["Access", "Server", "ServerThread"]
