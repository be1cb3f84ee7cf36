"""A foxglove client under test with one node, and a server of the protocol that does what a test tells it."""

from __future__ import annotations

import asyncio
import json
import struct
from typing import Any, Awaitable, Callable, Sequence

import aiohttp
from aiohttp import web

from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.foxglove import FoxgloveClient
from robot_health_monitor.runtime.bridge.cause import Cause

FLOAT = {
    "id": 3,
    "topic": "/battery",
    "encoding": "cdr",
    "schemaName": "std_msgs/msg/Float32",
    "schemaEncoding": "ros2msg",
    "schema": "float32 data\n",
}


def message(subscription: int, payload: bytes, time_ns: int = 0, opcode: int = 1) -> bytes:
    """Returns a binary message of the server."""
    return struct.pack("<BIQ", opcode, subscription, time_ns) + payload


def cdr(value: float) -> bytes:
    """Returns a std_msgs/Float32 in little-endian CDR."""
    return b"\x00\x01\x00\x00" + struct.pack("<f", value)


class Watched:
    """A client with one node, and what it received."""

    def __init__(self, url: str, *, probation_s: float = 0.0, **options: Any) -> None:
        self.ups: list[bool] = []
        self.causes: list[str] = []
        self.log_lines: list[LogLine] = []
        shared = {"on_link": self._on_link, "on_log": self.log_lines.append, "probation_s": probation_s}
        self.client = FoxgloveClient(url, **shared, **options)
        self.node = self.client.node("watcher")
        self.heard: list[Any] = []
        self.task = asyncio.ensure_future(self.client.run())

    def _on_link(self, up: bool, cause: Cause) -> None:
        if self.ups[-1:] != [up]:
            self.ups.append(up)
        if not up:
            self.causes.append(cause.text)

    def hear(self, value: Any, now_s: float) -> None:
        self.heard.append(value)

    def problems(self) -> list[str]:
        return [line.text for line in self.log_lines if line.severity >= Severity.WARN]

    async def close(self) -> None:
        self.client.close()
        self.task.cancel()
        await asyncio.wait({self.task})


class Server:
    """A server that offers channels and sends what it is given."""

    def __init__(self, channels: Sequence[dict[str, Any]] = (FLOAT,), protocols: Sequence[str] = ()) -> None:
        self.channels = channels
        self.protocols = protocols or ("foxglove.sdk.v1",)
        self.received: list[dict[str, Any]] = []
        self.requests: list[web.Request] = []
        self.sockets: list[web.WebSocketResponse] = []
        self.answer: Callable[[dict[str, Any]], dict[str, Any] | None] | None = None
        """Returns the answer to a message, None if there is none."""
        self.on_connect: Callable[[web.WebSocketResponse], Awaitable[None]] | None = None

    async def start(self, port: int = 0, ssl_context: Any = None) -> str:
        application = web.Application()
        application.router.add_get("/", self._accept)
        self._runner = web.AppRunner(application, access_log=None)
        await self._runner.setup()
        await web.TCPSite(self._runner, "127.0.0.1", port, ssl_context=ssl_context).start()
        self.port = self._runner.addresses[0][1]
        if ssl_context is not None:
            return f"foxglove+tls://localhost:{self.port}"
        return f"foxglove://127.0.0.1:{self.port}"

    async def close(self) -> None:
        for socket in self.sockets:
            await socket.close()
        await self._runner.cleanup()

    async def send(self, data: Any) -> None:
        """Sends a text, bytes, or an object as JSON on the newest connection."""
        socket = self.sockets[-1]
        if isinstance(data, bytes):
            await socket.send_bytes(data)
        else:
            await socket.send_str(data if isinstance(data, str) else json.dumps(data))

    @property
    def subscribed(self) -> dict[int, int]:
        """Subscription by channel, of all that was received."""
        found = [one for each in self.received if each.get("op") == "subscribe" for one in each["subscriptions"]]
        return {one["channelId"]: one["id"] for one in found}

    async def _accept(self, request: web.Request) -> web.WebSocketResponse:
        self.requests.append(request)
        socket = web.WebSocketResponse(protocols=self.protocols)
        await socket.prepare(request)
        self.sockets.append(socket)
        if self.channels:
            await socket.send_json({"op": "serverInfo", "name": "test", "capabilities": []})
            await socket.send_json({"op": "advertise", "channels": list(self.channels)})
        if self.on_connect is not None:
            await self.on_connect(socket)
        async for item in socket:
            if item.type == aiohttp.WSMsgType.TEXT:
                fields = json.loads(item.data)
                self.received.append(fields)
                answer = self.answer(fields) if self.answer is not None else None
                if answer is not None:
                    await socket.send_json(answer)
        return socket
