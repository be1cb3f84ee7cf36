"""What the client's and the server's WebSockets have in common: fair reading, floods, and waits that end.

Receiving a message that already waits does not yield to other tasks, and asyncio reads up to 256 kB at once, which very
small frames turn into most of a second of work: a connection is read in pieces and in turns, so that no peer keeps the
event loop from the others. aiohttp stops reading from a connection while the messages that wait exceed a size, but
pings, pongs and empty messages have none: any number of them may wait, and each costs time.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any, Coroutine, TypeVar

from aiohttp import ClientWebSocketResponse, WSMessage, WSMsgType, web

from ..core.values import MessageError

READ_BYTES = 16_384
"""Most bytes that are read at once.

Also makes each message cheaper: for the 256 kB of asyncio, glibc maps memory at every read and unmaps it again.
"""
TURN_S = 0.01
"""Longest time for which one connection is read while others wait, in s."""
MOST_EMPTY_PER_SECOND = 100
"""Most frames without content in one second. Healthy peers send one every few seconds."""

_WAITED_S = 0.0005
"""A call of `receive` that took longer has waited for a message, and other tasks have run meanwhile."""
_TEXT, _BINARY = WSMsgType.TEXT, WSMsgType.BINARY
_WITHOUT_CONTENT = (_TEXT, _BINARY, WSMsgType.PING, WSMsgType.PONG)
_Result = TypeVar("_Result")


class FloodError(MessageError):
    """The peer floods the connection with pings or empty messages."""


class Incoming:
    """The incoming messages of one WebSocket, in turns with other tasks of the loop. Pings are answered here."""

    def __init__(self, socket: web.WebSocketResponse | ClientWebSocketResponse) -> None:
        """Starts reading with the first `next`; `socket` without `autoping`, which answers pings without a pause."""
        self._socket = socket
        self._clock = asyncio.get_event_loop().time
        self._turn_s = self._done_s = self._clock()
        self._second_s = float("-inf")
        self._empty = 0

    async def next(self, timeout_s: float | None = None) -> WSMessage:
        """Returns the next message with content, or the one that ends the connection.

        Raises:
            asyncio.TimeoutError: none came within `timeout_s`; there is no limit if it is None.
            FloodError: the connection must be closed at once.
        """
        while True:
            if self._is_turn_over(self._clock()):
                await asyncio.sleep(0)
            message = await self._socket.receive(timeout=timeout_s)
            now_s = self._clock()
            if now_s - self._done_s > _WAITED_S:
                self._turn_s = now_s
            kind = message.type
            if ((kind is _TEXT or kind is _BINARY) and message.data) or kind not in _WITHOUT_CONTENT:
                return message
            if self._is_flood(now_s):
                raise FloodError
            if kind is WSMsgType.PING:
                with contextlib.suppress(ConnectionError):  # `receive` reports the end
                    await self._socket.pong(message.data)

    def _is_turn_over(self, now_s: float) -> bool:
        """Call when a message was processed; True if other tasks must run now, and a new turn begins."""
        self._done_s = now_s
        if now_s - self._turn_s <= TURN_S:
            return False
        self._turn_s = now_s
        return True

    def _is_flood(self, now_s: float) -> bool:
        """Counts a frame without content; returns whether there have been too many within a second."""
        if now_s - self._second_s >= 1.0:
            self._second_s, self._empty = now_s, 0
        self._empty += 1
        return self._empty > MOST_EMPTY_PER_SECOND


def limit_reads(transport: object) -> None:
    """Makes a transport of asyncio read at most `READ_BYTES` at once. Those for TLS lack this setting."""
    if hasattr(transport, "max_size"):
        transport.max_size = READ_BYTES


async def within(timeout_s: float, work: Coroutine[Any, Any, _Result]) -> _Result:
    """`asyncio.wait_for`, which before Python 3.12 may lose a cancellation, so that its caller never ends."""
    task = asyncio.ensure_future(work)
    try:
        await asyncio.wait({task}, timeout=timeout_s)
        if not task.done():
            raise asyncio.TimeoutError
        return task.result()
    finally:
        task.cancel()
        task.add_done_callback(ignore_result)


def ignore_result(task: asyncio.Future[Any]) -> None:
    """Reads the result of a task, so that asyncio does not complain about an unread exception."""
    if not task.cancelled():
        task.exception()
