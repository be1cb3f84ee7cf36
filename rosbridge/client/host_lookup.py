"""Looks up host names. A look-up that hangs delays neither other connections nor the end of the process.

aiohttp uses the loop's thread pool: a few look-ups that hang would block all others, and the process would wait for
them at its end.
"""

from __future__ import annotations

import asyncio
import functools
import socket
from typing import Any, Dict, List, Optional, Sequence

from aiohttp.abc import AbstractResolver

from robot_health_monitor.runtime.threads import run_in_daemon_thread

from ..sockets import ignore_result


class HostLookup(AbstractResolver):
    """The look-ups of one connection: one at a time, each in a separate thread."""

    def __init__(self) -> None:
        """Starts without a look-up."""
        self._host = ""
        self._pending: Optional[asyncio.Future[Any]] = None

    async def resolve(self, host: str, port: int = 0, family: int = socket.AF_INET) -> List[Any]:
        """Returns the addresses of a host.

        A look-up that is still under way is waited for, not started again: one that hangs keeps a single thread.

        Raises:
            OSError: the host is not known.
        """
        if self._pending is None or self._pending.done() or self._host != host:
            look_up = functools.partial(_look_up, host, port, family)
            self._host = host
            self._pending = asyncio.ensure_future(run_in_daemon_thread(look_up))
            self._pending.add_done_callback(ignore_result)
        return list(await asyncio.shield(self._pending))

    async def close(self) -> None:
        """Does nothing: the next connection continues a look-up that is under way."""


def _look_up(host: str, port: int, family: int) -> Sequence[Dict[str, Any]]:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, family=family, flags=socket.AI_ADDRCONFIG)
    addresses = []
    for family_found, _, protocol, _, address in found:
        numeric, service = socket.getnameinfo(address, socket.NI_NUMERICHOST | socket.NI_NUMERICSERV)
        addresses.append(
            {
                "hostname": host,
                "host": numeric,  # with the scope of a link-local IPv6 address
                "port": int(service),
                "family": family_found,
                "proto": protocol,
                "flags": socket.AI_NUMERICHOST | socket.AI_NUMERICSERV,
            }
        )
    return addresses
