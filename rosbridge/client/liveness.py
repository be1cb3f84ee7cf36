"""Whether a server still answers.

In place of aiohttp's heartbeat, which costs a fifth of the CPU time of a small message.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket as sockets
import struct
from typing import Callable

import aiohttp

from ..sockets import within

_ALLOWED_PERIODS = 0.5
"""How long a server may take to answer, in periods of the pings."""
_KERNEL_CLOCK_S = 0.02
"""By how much the times of the kernel may be wrong, which counts in its own ticks, in s."""
_TCP_INFO_BYTES = 104
_LAST_DATA_RECEIVED = 52
"""Offset of `tcpi_last_data_recv`, in ms, in Linux' `struct tcp_info` (linux/tcp.h)."""


async def wait_until_unanswered(
    socket: aiohttp.ClientWebSocketResponse, period_s: float, received_s: Callable[[], float]
) -> None:
    """Returns when nothing was received since the server was asked, for half a period.

    The server is asked, by a ping, when nothing was received for a period: one that stops answering is noticed after
    at most one and a half. Silence alone says nothing: a server without traffic is silent until it is asked.

    Args:
        socket: the connection.
        period_s: of the pings, in s.
        received_s: returns when this process received something last, in s of the event loop's time.
    """
    clock = asyncio.get_event_loop().time

    def heard_s() -> float:
        return max(received_s(), clock() - _kernel_silence_s(socket) + _KERNEL_CLOCK_S)

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


def _kernel_silence_s(socket: aiohttp.ClientWebSocketResponse) -> float:
    """Returns how long ago the kernel received data of a connection, in s; infinite if it does not say.

    What the kernel has received, this process may not have read yet: a large message that arrives slowly, or an answer
    that came while this process was busy, does not count as silence.
    """
    raw = socket.get_extra_info("socket")
    try:
        info = raw.getsockopt(sockets.IPPROTO_TCP, sockets.TCP_INFO, _TCP_INFO_BYTES)
        return float(struct.unpack_from("=I", info, _LAST_DATA_RECEIVED)[0]) / 1000.0
    except (AttributeError, OSError, struct.error):
        return math.inf
