"""The rosbridge server: serves any implementation of the port to rosbridge clients."""

from .access import LOCAL_PAGES, Access, monitor_access
from .server import Server, ServerThread

__all__ = ["LOCAL_PAGES", "Access", "Server", "ServerThread", "monitor_access"]
