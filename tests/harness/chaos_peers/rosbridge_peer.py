"""A robot that is a rosbridge client: publishes the latest number of its stdin, and prints alerts.

Argument: the URL.
"""

from __future__ import annotations

import asyncio
import json
import sys
import threading

import aiohttp

LEVELS = ("OK", "WARN", "ERROR", "STALE")
PERIOD_S = 0.05
value = 50.0


def read_stdin() -> None:
    global value
    for line in sys.stdin:
        value = float(line)


async def publish(socket: aiohttp.ClientWebSocketResponse) -> None:
    await socket.send_json({"op": "advertise", "topic": "/battery_level", "type": "std_msgs/Float32"})
    while True:
        await socket.send_json({"op": "publish", "topic": "/battery_level", "msg": {"data": value}})
        await socket.send_json({"op": "call_service", "service": "/rosapi/get_time", "args": {}})
        await asyncio.sleep(PERIOD_S)


async def talk(url: str) -> None:
    async with aiohttp.ClientSession() as session, session.ws_connect(url, heartbeat=1.0) as socket:
        await socket.send_json({"op": "subscribe", "topic": "/alerts", "type": "diagnostic_msgs/DiagnosticStatus"})
        publishing = asyncio.ensure_future(publish(socket))
        try:
            async for message in socket:
                if message.type is not aiohttp.WSMsgType.TEXT:
                    break  # the heartbeat was not answered
                fields = json.loads(message.data)
                if fields["op"] == "service_response":
                    print("connected", flush=True)
                elif fields["op"] == "publish" and fields["msg"]["name"].endswith(": battery_level"):
                    print(f"alert {LEVELS[fields['msg']['level']]}", flush=True)
        finally:
            publishing.cancel()


async def main(url: str) -> None:
    while True:
        try:
            await talk(url)
        except (aiohttp.ClientError, OSError):
            pass
        await asyncio.sleep(PERIOD_S)


threading.Thread(target=read_stdin, daemon=True).start()
asyncio.run(main(sys.argv[1]))
