"""The WebSocket to a server: looking up the host, sending, and whether the server still answers."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import socket as sockets
import struct
from typing import Any, Mapping, Sequence, Union

import aiohttp
from aiohttp.abc import AbstractResolver

from ..event_loops import run_in_daemon_thread
from ..sockets import ignore_result, limit_reads, within
from .cause import RedirectError

_ALLOWED_PERIODS = 0.5
"""How long a server may take to answer, in periods of the pings."""
_KERNEL_CLOCK_S = 0.02
"""By how much the times of the kernel may be wrong, which counts in its own ticks, in s."""
_TCP_INFO_BYTES = 104
_LAST_DATA_RECEIVED = 52
"""Offset of `tcpi_last_data_recv`, in ms, in Linux' `struct tcp_info` (linux/tcp.h)."""

Wire = Union[str, bytes]
"""A WebSocket message: text, or binary."""

Socket = aiohttp.ClientWebSocketResponse


def create_session(lookup: HostLookup, headers: Mapping[str, str]) -> aiohttp.ClientSession:
    """Returns a session whose connections are read in small pieces, and which follows no redirects."""

    async def refuse(session: Any, context: Any, redirect: aiohttp.TraceRequestRedirectParams) -> None:
        raise RedirectError(redirect.response.status, redirect.response.headers.get("Location", ""))

    trace = aiohttp.TraceConfig()  # `ws_connect` has no option for redirects
    trace.on_request_redirect.append(refuse)
    connector = _Connector(resolver=lookup, use_dns_cache=False)
    return aiohttp.ClientSession(headers=headers, connector=connector, trace_configs=[trace])


class _Connector(aiohttp.TCPConnector):
    async def connect(self, *arguments: Any, **options: Any) -> aiohttp.connector.Connection:
        connection = await super().connect(*arguments, **options)
        limit_reads(connection.transport)
        return connection


class HostLookup(AbstractResolver):
    """The look-ups of one connection: one at a time, each in a separate thread.

    aiohttp uses the loop's thread pool: a few look-ups that hang would block all others, and the process would wait for
    them at its end.
    """

    def __init__(self) -> None:
        """Starts without a look-up."""
        self._host = ""
        self._pending: asyncio.Future[Any] | None = None

    async def resolve(self, host: str, port: int = 0, family: int = sockets.AF_INET) -> list[Any]:
        """Returns the addresses of a host; raises OSError if it is not known.

        A look-up that is still under way is waited for, not started again: one that hangs keeps a single thread.
        """
        if self._pending is None or self._pending.done() or self._host != host:
            look_up = functools.partial(_look_up, host, port, family)
            self._host = host
            self._pending = asyncio.ensure_future(run_in_daemon_thread(look_up))
            self._pending.add_done_callback(ignore_result)
        return list(await asyncio.shield(self._pending))

    async def close(self) -> None:
        """Does nothing: the next connection continues a look-up that is under way."""


def _look_up(host: str, port: int, family: int) -> Sequence[dict[str, Any]]:
    answers = sockets.getaddrinfo(host, port, type=sockets.SOCK_STREAM, family=family, flags=sockets.AI_ADDRCONFIG)
    addresses = []
    for address_family, _, protocol, _, address in answers:
        numeric, service = sockets.getnameinfo(address, sockets.NI_NUMERICHOST | sockets.NI_NUMERICSERV)
        # `numeric` has the scope of a link-local IPv6 address.
        target = {"hostname": host, "host": numeric, "port": int(service)}
        flags = sockets.AI_NUMERICHOST | sockets.AI_NUMERICSERV
        addresses.append({**target, "family": address_family, "proto": protocol, "flags": flags})
    return addresses


async def write(wires: asyncio.Queue[Wire], socket: Socket) -> None:
    """Sends what is put, until it is cancelled: when the connection ends, its reader finds out why."""
    while True:
        wire = await wires.get()
        try:
            if isinstance(wire, bytes):
                await socket.send_bytes(wire)
            else:
                await socket.send_str(wire)
        except UnicodeEncodeError:
            continue  # a lone surrogate in a text: this one operation cannot be sent
        except (ConnectionError, RuntimeError, aiohttp.ClientError):
            await asyncio.Event().wait()


async def wait_until_unanswered(socket: Socket, period_s: float) -> None:
    """Returns when nothing was received since the server was asked, for half a period.

    In place of aiohttp's heartbeat, which costs a fifth of the CPU time of a small message. The server is asked, by a
    ping, when nothing was received for a period: one that stops answering is noticed after at most one and a half.
    Silence alone says nothing: a server without traffic is silent until it is asked.
    """
    clock = asyncio.get_event_loop().time

    def heard_s() -> float:
        return clock() - _kernel_silence_s(socket) + _KERNEL_CLOCK_S

    while True:
        wait_s = heard_s() + period_s - clock()
        if wait_s > 0.0:
            await asyncio.sleep(wait_s)
            continue
        asked_s = clock()
        answered_s = asked_s + _ALLOWED_PERIODS * period_s
        with contextlib.suppress(asyncio.TimeoutError, ConnectionError, RuntimeError, aiohttp.ClientError):
            await within(answered_s - asked_s, socket.ping())
        await asyncio.sleep(max(0.0, answered_s - clock()))
        if heard_s() < asked_s:
            return


def _kernel_silence_s(socket: Socket) -> float:
    """Returns how long ago the kernel received data of a connection, in s; infinite if the connection has ended.

    What the kernel has received, this process may not have read yet: a large message that arrives slowly, or an answer
    that came while this process was busy, does not count as silence.
    """
    raw = socket.get_extra_info("socket")
    try:
        info = raw.getsockopt(sockets.IPPROTO_TCP, sockets.TCP_INFO, _TCP_INFO_BYTES)
        return float(struct.unpack_from("=I", info, _LAST_DATA_RECEIVED)[0]) / 1000.0
    except (AttributeError, OSError):
        return math.inf
