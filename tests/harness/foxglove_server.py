"""A server of `foxglove.websocket.v1` for tests, over a local bus: what foxglove_bridge is over ROS 2.

Independent of the code under test: messages are serialized by rosbags, and the protocol is written here again.
"""

from __future__ import annotations

import asyncio
import base64
import json
import struct
from typing import Any, Mapping

import aiohttp
import numpy as np
from aiohttp import web
from rosbags.typesys import Stores, get_typestore

from robot_health_monitor.core.port.local import LocalBus

STORE = get_typestore(Stores.ROS2_HUMBLE)
FIELDS = getattr(STORE, "fielddefs", None) or STORE.FIELDDEFS  # as rosbags 0.9 calls them
MARKER = "/harness_marker"
_BASE, _NAME, _ARRAY = 1, 2, 3
"""rosbags' kinds of fields; 4 is a sequence."""
_SPELLINGS = {"sec": "secs", "nanosec": "nsecs"}
_CAMERA = {"d": "D", "k": "K", "r": "R", "p": "P"}


def long_name(type_name: str) -> str:
    """Returns `pkg/msg/Type`."""
    parts = type_name.split("/")
    return "/".join((parts[0], "msg", parts[-1]))


def native(type_name: str, fields: Mapping[str, Any]) -> Any:
    """Returns a message of rosbags with the fields of a mapping in rosbridge's form; others have their defaults."""
    values = {}
    for name, (kind, described) in FIELDS[type_name][1]:
        found = fields.get(name, fields.get(_SPELLINGS.get(name, ""), fields.get(_CAMERA.get(name, ""))))
        values[name] = _value(kind, described, found)
    return STORE.types[type_name](**values)


def _value(kind: int, described: Any, found: Any) -> Any:
    if kind == _BASE:
        if described[0] == "string":
            return found or ""
        if described[0] == "bool":
            return bool(found)
        return (float if described[0].startswith("float") else int)(0 if found is None else found)
    if kind == _NAME:
        return native(described, found or {})
    (inner_kind, inner), count = described
    if isinstance(found, str):
        found = list(base64.b64decode(found))
    items = list(found or [])
    if kind == _ARRAY:
        items += [0] * (count - len(items)) if inner_kind == _BASE else []
    if inner_kind == _BASE and inner[0] != "string":
        return np.array(items, dtype={"byte": "uint8", "char": "uint8", "octet": "uint8"}.get(inner[0], inner[0]))
    return [_value(inner_kind, inner, item) for item in items]


class FoxgloveServer:
    """Serves what is published on a bus. `start`, `close` and what the bus calls run in one loop."""

    subprotocol = "foxglove.websocket.v1"

    def __init__(self, bus: LocalBus, encoding: str = "cdr") -> None:
        self.bus = bus
        self.encoding = encoding
        self.received: list[dict[str, Any]] = []
        self.requests: list[web.Request] = []
        self._outside = bus.node("foxglove_bridge")
        self._channels: dict[str, dict[str, Any]] = {}
        self._followed: dict[str, Any] = {}
        self._clients: dict[web.WebSocketResponse, _Client] = {}

    async def start(self, port: int = 0) -> None:
        application = web.Application()
        application.router.add_get("/", self._accept)
        self._runner = web.AppRunner(application, access_log=None)
        await self._runner.setup()
        await web.TCPSite(self._runner, "127.0.0.1", port).start()
        self.port = self._runner.addresses[0][1]
        self.loop = asyncio.get_event_loop()

    async def close(self) -> None:
        for socket in tuple(self._clients):
            await socket.close()
        await self._runner.cleanup()

    def advertise_all(self) -> None:
        """Offers what is advertised on the bus, and forwards it from now on."""
        for topic, type_name in self.bus.graph().topics.items():
            if topic not in self._channels and type_name:
                self._offer(topic, type_name)

    def withdraw(self, topic: str) -> None:
        """No longer offers a topic."""
        channel = self._channels.pop(topic)
        self._send({"op": "unadvertise", "channelIds": [channel["id"]]})

    def _offer(self, topic: str, type_name: str) -> None:
        channel = self._channels[topic] = {**self._channel(topic, type_name), "type": type_name}
        self._send({"op": "advertise", "channels": [channel]})

    def follow(self) -> None:
        """Subscribes on the bus to what clients have subscribed to, and to nothing else, as foxglove_bridge does."""
        wanted = {channel for client in self._clients.values() for channel in client.subscriptions.values()}
        for topic, channel in self._channels.items():
            if channel["id"] in wanted and topic not in self._followed:

                def forward(message: Mapping[str, Any], now_s: float, topic: str = topic) -> None:
                    self.loop.call_soon_threadsafe(self.publish, topic, message)

                self._followed[topic] = self._outside.subscribe(topic, channel["type"], forward)
            elif channel["id"] not in wanted and topic in self._followed:
                self._outside.unsubscribe(self._followed.pop(topic))

    def _channel(self, topic: str, type_name: str) -> dict[str, Any]:
        name = long_name(type_name)
        channel = {"id": len(self._channels) + 7, "topic": topic, "schemaName": name}
        if self.encoding == "json" or name not in STORE.types:
            return {**channel, "encoding": "json", "schemaEncoding": "jsonschema", "schema": '{"type": "object"}'}
        text, _ = STORE.generate_msgdef(name, ros_version=2)
        return {**channel, "encoding": "cdr", "schemaEncoding": "ros2msg", "schema": text}

    def publish(self, topic: str, message: Mapping[str, Any]) -> None:
        """Sends a message to those who have subscribed to its channel."""
        channel = self._channels.get(topic)
        if channel is None:
            return
        if channel["encoding"] == "json":
            data = json.dumps(_null(message)).encode()
        else:
            data = bytes(STORE.serialize_cdr(native(channel["schemaName"], message), channel["schemaName"]))
        for client in self._clients.values():
            client.forward(channel["id"], data)

    def _send(self, message: Mapping[str, Any]) -> None:
        for client in self._clients.values():
            client.queue.put_nowait(json.dumps(message))

    async def _accept(self, request: web.Request) -> web.WebSocketResponse:
        self.requests.append(request)
        socket = web.WebSocketResponse(protocols=[self.subprotocol])
        await socket.prepare(request)
        client = self._clients[socket] = _Client(socket)
        writer = asyncio.ensure_future(client.write())
        client.queue.put_nowait(json.dumps({"op": "serverInfo", "name": "tests", "capabilities": []}))
        channels = [*self._channels.values(), {**MARKER_CHANNEL}]
        client.queue.put_nowait(json.dumps({"op": "advertise", "channels": channels}))
        try:
            async for message in socket:
                if message.type == aiohttp.WSMsgType.TEXT:
                    fields = json.loads(message.data)
                    self.received.append(fields)
                    client.take(fields)
                    self.follow()
        finally:
            del self._clients[socket]
            self.follow()
            writer.cancel()
        return socket


MARKER_CHANNEL = {"id": 1, "topic": MARKER, "encoding": "json", "schemaName": "std_msgs/Float64", "schema": "{}"}


class _Client:
    def __init__(self, socket: web.WebSocketResponse) -> None:
        self.socket = socket
        self.queue: asyncio.Queue[Any] = asyncio.Queue()
        self.subscriptions: dict[int, int] = {}

    def take(self, fields: Mapping[str, Any]) -> None:
        if fields["op"] == "subscribe":
            for each in fields["subscriptions"]:
                self.subscriptions[each["id"]] = each["channelId"]
        elif fields["op"] == "unsubscribe":
            for subscription in fields["subscriptionIds"]:
                self.subscriptions.pop(subscription, None)
        elif fields["op"] == "harness_marker":
            self.forward(1, json.dumps({"data": fields["number"]}).encode())

    def forward(self, channel_id: int, data: bytes) -> None:
        for subscription, subscribed in self.subscriptions.items():
            if subscribed == channel_id:
                self.queue.put_nowait(struct.pack("<BIQ", 1, subscription, 12345) + data)

    async def write(self) -> None:
        while True:
            item = await self.queue.get()
            try:
                await (self.socket.send_bytes(item) if isinstance(item, bytes) else self.socket.send_str(item))
            except (ConnectionError, RuntimeError):
                return


def _null(value: Any) -> Any:
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, Mapping):
        return {name: _null(each) for name, each in value.items()}
    return [_null(each) for each in value] if isinstance(value, (list, tuple)) else value
