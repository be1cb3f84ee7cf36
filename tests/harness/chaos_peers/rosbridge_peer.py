"""A robot that is a rosbridge client. Argument: the URL.

It has no heartbeat, so that one connection lasts as long as the server: what was sent over an earlier connection may be
processed after what came over a later one, and alerts that come between the two are lost.
"""

from __future__ import annotations

import asyncio
import json
import sys

import aiohttp
from battery import PERIOD_S, Battery, write_alert, write_period

battery = Battery()


async def publish(socket: aiohttp.ClientWebSocketResponse) -> None:
    await socket.send_json({"op": "advertise", "topic": "/battery_level", "type": "std_msgs/Float32"})
    while True:
        await socket.send_json({"op": "publish", "topic": "/battery_level", "msg": {"data": battery.level}})
        await socket.send_json({"op": "call_service", "service": "/rosapi/get_time", "args": {}})
        await asyncio.sleep(PERIOD_S)


async def talk(url: str) -> None:
    async with aiohttp.ClientSession() as session, session.ws_connect(url) as socket:
        await socket.send_json({"op": "subscribe", "topic": "/alerts", "type": "diagnostic_msgs/DiagnosticStatus"})
        publishing = asyncio.ensure_future(publish(socket))
        try:
            async for message in socket:
                fields = json.loads(message.data)
                if fields["op"] == "service_response":
                    write_period(True)
                elif fields["op"] == "publish":
                    write_alert(fields["msg"]["name"], fields["msg"]["level"])
        finally:
            publishing.cancel()


async def main(url: str) -> None:
    while True:
        try:
            await talk(url)
        except (aiohttp.ClientError, OSError):
            pass
        write_period(False)
        await asyncio.sleep(PERIOD_S)


asyncio.run(main(sys.argv[1]))
