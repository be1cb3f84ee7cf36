"""A robot on a local bus, this project's server in front of it, and plain WebSocket clients, all in one event loop."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any, AsyncIterator, Awaitable, Callable

import aiohttp
import cbor2

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.rosbridge.protocol import DEFAULT_LIMITS, Limits
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.runtime.access import Access

DEADLINE_S = 30.0
FLOAT32 = "std_msgs/Float32"


class Peer:
    """A client that speaks JSON over a WebSocket, and nothing that is not rosbridge."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket

    async def send(self, op: str, **fields: Any) -> None:
        await self.socket.send_str(json.dumps({"op": op, **fields}))

    async def receive(self) -> dict[str, Any]:
        """Returns the next message, from JSON or CBOR."""
        message = await asyncio.wait_for(self.socket.receive(), DEADLINE_S)
        assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
        decoded = json.loads(message.data) if isinstance(message.data, str) else cbor2.loads(message.data)
        assert isinstance(decoded, dict)
        return decoded

    async def receive_many(self, count: int) -> list[Any]:
        """Returns the `data` of the next messages."""
        return [(await self.receive())["msg"]["data"] for _ in range(count)]

    async def call(self, service: str, args: object = None, **options: Any) -> dict[str, Any]:
        """Calls a service and returns its response; other messages that come first are left out."""
        await self.send("call_service", service=service, args={} if args is None else args, id="call", **options)
        while True:
            message = await self.receive()
            if message["op"] == "service_response":
                return message

    async def subscribe(self, topic: str, **options: Any) -> None:
        """Subscribes, and returns when the server has done so."""
        await self.send("subscribe", topic=topic, **options)
        await self.settle()

    async def settle(self) -> None:
        """Returns when the server has taken everything that was sent until now."""
        assert (await self.call("/rosapi/get_time"))["result"] is True

    async def closed(self) -> int | None:
        """Waits until the connection has ended; returns the code."""
        while not self.socket.closed:
            await asyncio.wait_for(self.socket.receive(), DEADLINE_S)
        return self.socket.close_code


class Robot:
    """A bus with one node on it, and the server in front."""

    def __init__(self, access: Access | None, options: dict[str, Any]) -> None:
        """`options` are those of `Server`, or fields of `Limits`."""
        limited = {name: options[name] for name in Limits._fields if name in options}
        given = {name: value for name, value in options.items() if name not in limited}
        self.log: list[str] = []
        self.bus = LocalBus(on_log=self._on_log)
        self.node = self.bus.node("robot")
        self.node.advertise("/battery_level", FLOAT32)
        node = self.bus.node("rosbridge", parameters={"rate": 2.5})
        limits = given.pop("limits", DEFAULT_LIMITS)._replace(**limited)
        self.server = Server(node, port=0, threads=False, access=access, limits=limits, **given)

    def _on_log(self, line: Any) -> None:
        self.log.append(line.text)
        self.server.publish_log(line)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.port}/"

    def publish(self, *numbers: float) -> None:
        for number in numbers:
            self.node.publish("/battery_level", {"data": number})

    @contextlib.asynccontextmanager
    async def peer(self, *, query: str = "", **options: Any) -> AsyncIterator[Peer]:
        async with aiohttp.ClientSession() as session, session.ws_connect(self.url + query, **options) as socket:
            yield Peer(socket)

    async def until(self, predicate: Callable[[], bool]) -> None:
        """Runs the loop until `predicate()` is true."""
        deadline_s = asyncio.get_event_loop().time() + DEADLINE_S
        while not predicate():
            assert asyncio.get_event_loop().time() < deadline_s, f"still not true after {DEADLINE_S:g} s"
            await asyncio.sleep(0.01)


def with_robot(access: Access | None = None, **options: Any) -> Callable[[Any], Callable[[Any], None]]:
    """Turns `async def test(self_or_nothing, robot)` into a test; the robot is started before and closed after it."""

    def decorate(scenario: Callable[[Robot], Awaitable[None]]) -> Callable[[], None]:
        async def run(arguments: dict[str, Any]) -> None:
            robot = Robot(access, options)
            await robot.server.start()
            try:
                await asyncio.wait_for(scenario(robot, **arguments), 120.0)
            finally:
                await robot.server.close()

        def test(**arguments: Any) -> None:
            asyncio.run(run(arguments))

        test.__name__ = scenario.__name__
        test.__doc__ = scenario.__doc__
        return test

    return decorate
