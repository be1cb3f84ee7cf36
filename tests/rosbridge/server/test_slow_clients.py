from __future__ import annotations

import asyncio
from typing import Any, List

from harness.slow_transport import SlowTransport

from robot_health_monitor.rosbridge.server.send_queue import SendQueue
from robot_health_monitor.rosbridge.server.slow_clients import SlowClients


class Client:
    def __init__(self) -> None:
        self.transport = SlowTransport(1_000_000)
        self.queue = SendQueue(self.transport, 1_000_000)  # type: ignore[arg-type]
        self.events: List[str] = []

    def caught_up(self) -> None:
        self.events.append("caught up")

    def abort(self) -> None:
        self.events.append("aborted")


async def wait_for_event(client: Client) -> None:
    while not client.events:
        await asyncio.sleep(0.001)


def test_a_queue_is_emptied_as_soon_as_the_client_reads_again() -> None:
    async def scenario() -> None:
        lines: List[str] = []
        slow = SlowClients(asyncio.get_event_loop(), 60.0, lines.append)
        client: Any = Client()
        client.queue.put(b"frame")
        slow.add(client)
        client.transport.buffered = 0
        await asyncio.wait_for(wait_for_event(client), 20.0)
        assert (client.events, client.transport.written, lines) == (["caught up"], [b"frame"], [])
        assert client.queue.behind_since_s is None

    asyncio.run(scenario())


def test_a_client_that_stays_behind_is_disconnected() -> None:
    async def scenario() -> None:
        lines: List[str] = []
        slow = SlowClients(asyncio.get_event_loop(), 0.05, lines.append)
        stuck: Any = Client()
        left: Any = Client()
        for client in (stuck, left):
            client.queue.put(b"frame")
            slow.add(client)
        slow.discard(left)
        await asyncio.wait_for(wait_for_event(stuck), 20.0)
        assert (stuck.events, left.events) == (["aborted"], [])
        assert lines == ["disconnected a client: behind for more than 0.05 s"]

    asyncio.run(scenario())
