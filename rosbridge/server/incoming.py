"""What one client sends: its messages, in turns with other tasks of the loop. Its pings are answered here."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Optional

from aiohttp import WSMsgType, web

from robot_health_monitor.core.errors import MessageError

from ..flood_limit import FloodLimit
from ..protocol import Wire
from ..turns import Turns

_MESSAGES = (WSMsgType.TEXT, WSMsgType.BINARY)
_WITHOUT_CONTENT = (*_MESSAGES, WSMsgType.PING, WSMsgType.PONG)


class FloodError(MessageError):
    """The client floods the connection with pings or empty messages."""


class Incoming:
    """The incoming messages of one WebSocket."""

    def __init__(self, socket: web.WebSocketResponse) -> None:
        """Starts reading with the first `next`.

        Args:
            socket: without `autoping`, which would answer any number of pings without a pause.
        """
        self._socket = socket
        self._clock = asyncio.get_event_loop().time
        self._turns = Turns(self._clock())
        self._flood = FloodLimit()

    async def next(self, timeout_s: Optional[float] = None) -> Optional[Wire]:
        """Returns the next message; None once the connection has ended.

        Args:
            timeout_s: longest wait, in s. None: no limit.

        Raises:
            asyncio.TimeoutError: no message came in time.
            FloodError: the connection must be closed at once.
        """
        while True:
            if self._turns.is_over(self._clock()):
                await asyncio.sleep(0)
            message = await self._socket.receive(timeout=timeout_s)
            now_s = self._clock()
            self._turns.note_received(now_s)
            if message.type in _MESSAGES and message.data:
                data: Wire = message.data
                return data
            if message.type not in _WITHOUT_CONTENT:
                return None
            if self._flood.is_exceeded(now_s):
                raise FloodError
            if message.type is WSMsgType.PING:
                with contextlib.suppress(ConnectionError):  # `receive` reports the end
                    await self._socket.pong(message.data)
