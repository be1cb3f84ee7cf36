"""A client under test with one node, and a rosbridge server that is not this project's."""

from __future__ import annotations

import asyncio
import json
from typing import Any, Awaitable, Callable

import aiohttp
from aiohttp import web

from harness.reserved import free_port
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.rosbridge.client import Cause, RosbridgeClient

DEADLINE_S = 30.0


async def until(predicate: Callable[[], bool]) -> None:
    """Runs the loop until `predicate()` is true."""
    deadline_s = asyncio.get_event_loop().time() + DEADLINE_S
    while not predicate():
        assert asyncio.get_event_loop().time() < deadline_s, f"still not true after {DEADLINE_S:g} s"
        await asyncio.sleep(0.01)


def scenario(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Turns a coroutine function without arguments into a test."""

    def run() -> None:
        asyncio.run(asyncio.wait_for(test(), 120.0))

    run.__name__ = test.__name__
    run.__doc__ = test.__doc__
    return run


class Watched:
    """A client with one node, and what it received."""

    def __init__(self, url: str, *, use_sim_time: bool = False, probation_s: float = 0.0, **options: Any) -> None:
        self.ups: list[bool] = []
        self.causes: list[str] = []
        self.log_lines: list[LogLine] = []
        shared = {"on_link": self._on_link, "on_log": self.log_lines.append, "probation_s": probation_s}
        self.client = RosbridgeClient(url.replace("http", "ws", 1), **shared, **options)
        self.node = self.client.node("watcher", use_sim_time=use_sim_time)
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

    async def call(self, service: str) -> Any:
        return await self.client.connection.call(service, {}, 10.0)

    async def settle(self) -> None:
        """Returns when the server has processed what was sent, and the client what the server sent before that."""
        await self.call("/rosapi/get_time")

    async def close(self) -> None:
        self.client.close()
        self.task.cancel()
        await asyncio.wait({self.task})


class ForeignServer:
    """A rosbridge server that speaks JSON only and does not reply to what it does not like."""

    def __init__(self) -> None:
        self.received: list[dict[str, Any]] = []
        self.sockets: list[web.WebSocketResponse] = []
        self.requests: list[web.Request] = []
        self.types: dict[str, str] = {}
        self.rosapi = True
        self.answer: Callable[[str, Any], Any] | None = None
        """Answers a call by service and request: values, the text of a failure, or None: no response."""
        self.on_connect: Callable[[web.WebSocketResponse], Awaitable[None]] | None = None
        """What to do with a new connection before reading from it."""

    async def start(self, port: int = 0) -> str:
        application = web.Application()
        application.router.add_get("/", self._accept)
        self._runner = web.AppRunner(application, access_log=None)
        await self._runner.setup()
        await web.TCPSite(self._runner, "127.0.0.1", port or free_port()).start()
        self.port = self._runner.addresses[0][1]
        return f"ws://127.0.0.1:{self.port}"

    async def close(self) -> None:
        for socket in self.sockets:
            await socket.close()
        await self._runner.cleanup()

    async def publish(self, topic: str, message: Any) -> None:
        """Sends a message on the newest connection."""
        await self.sockets[-1].send_str(json.dumps({"op": "publish", "topic": topic, "msg": message}))

    async def _accept(self, request: web.Request) -> web.WebSocketResponse:
        self.requests.append(request)
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        self.sockets.append(socket)
        if self.on_connect is not None:
            await self.on_connect(socket)
        async for message in socket:
            if message.type == aiohttp.WSMsgType.TEXT:
                fields = json.loads(message.data)
                self.received.append(fields)
                if fields["op"] == "call_service" and self.answer is not None:
                    given = self.answer(fields["service"], fields["args"])
                    response = {"op": "service_response", "id": fields["id"], "service": fields["service"]}
                    if given is not None:
                        await socket.send_json({**response, "values": given, "result": not isinstance(given, str)})
                elif fields["op"] == "call_service" and not self.rosapi:
                    failure = {"op": "service_response", "id": fields["id"], "service": "s", "values": "not there"}
                    await socket.send_json({**failure, "result": False})
                elif fields["op"] == "call_service":
                    asked = fields["args"]
                    values = {"type": self.types.get(asked.get("topic", ""), "")}
                    await socket.send_json(
                        {"op": "service_response", "id": fields["id"], "service": "s", "values": values, "result": True}
                    )
        return socket
