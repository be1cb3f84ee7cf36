"""One connection to a foxglove_bridge, or to another server of Foxglove's protocol, re-established whenever it ends.

runtime/bridge/connection.py connects, reads and waits; channels.py has what the server offers and who reads it.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
from typing import Any, Awaitable

from ..core.port import Severity
from ..core.values import printable
from ..runtime.bridge.cause import Cause
from ..runtime.bridge.connection import LONGEST_TEXT, BridgeConnection
from ..runtime.bridge.websocket import Wire
from ..runtime.event_loops import run_in_daemon_thread
from ..runtime.sockets import within
from .channels import Channels
from .protocol import SUBPROTOCOLS, ServerMessage, read_message, read_text

_LARGE_TEXT = 200_000
"""Characters of a text above which it is parsed in a thread."""
_STATUS_ERROR = 2
_ANSWER_S = 2.0
"""How long a server may take to prove that it is a rosbridge server, in s."""


class FoxgloveConnection(BridgeConnection):
    """A connection to one server, kept up."""

    subprotocols = SUBPROTOCOLS
    server_kind = "foxglove server"

    def __init__(self, url: str, **options: Any) -> None:
        """Creates a connection that is down, with the `options` of `BridgeConnection`; `run` connects.

        `url` is `foxglove://host:port`, or `foxglove+tls://host:port` for TLS.
        """
        super().__init__(url, **options)
        self.receivers = self.channels = Channels(
            self.send_wire, functools.partial(self._log.write, "channels", Severity.WARN)
        )
        self._answered: asyncio.Event | None = None
        """What an answer of a rosbridge server sets; None unless the server has chosen no subprotocol."""

    def _begin(self, subprotocol: str | None) -> bool:
        self._answered = asyncio.Event() if subprotocol is None else None
        if self._answered is not None:
            self.send_wire(json.dumps({"op": "call_service", "id": "a", "service": "/rosapi/get_time", "args": {}}))
        return self._answered is None

    def _went_down(self) -> None:
        self.channels.end()

    async def _refusal(self) -> Cause:
        """A server that speaks the protocol chooses a subprotocol; a rosbridge server answers a call."""
        if self._answered is None:
            return await super()._refusal()
        with contextlib.suppress(asyncio.TimeoutError):
            await within(_ANSWER_S, self._answered.wait())
        if self._answered.is_set():
            return Cause(f"this is a rosbridge server: ws{self.address[self.address.index(':') :]}")
        return Cause("not a foxglove server: it does not speak Foxglove's protocol")

    def _receive(self, data: Wire) -> Awaitable[None] | None:
        if isinstance(data, bytes):
            publication = read_message(data)
            if publication is not None:
                self.channels.deliver(*publication)
            return None
        if self._answered is not None:
            if '"service_response"' in data[:_LARGE_TEXT]:
                self._answered.set()
        elif len(data) > _LARGE_TEXT:
            return self._receive_large(data)
        else:
            self._process(read_text(data))
        return None

    async def _receive_large(self, text: str) -> None:
        """Parses in a thread: a list of many channels takes as long as a second."""
        self._process(await run_in_daemon_thread(functools.partial(read_text, text)))

    def _process(self, message: ServerMessage) -> None:
        self.channels.unadvertise(message.channel_ids)
        self.channels.advertise(message.channels)
        if message.level >= _STATUS_ERROR:
            text = printable(message.message)[:LONGEST_TEXT]
            self._log.write("status", Severity.WARN, f"{self.address} reports: {text}")
