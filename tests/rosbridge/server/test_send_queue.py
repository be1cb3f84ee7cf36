from __future__ import annotations

import asyncio
from typing import Any, List

from harness.slow_transport import SlowTransport

from robot_health_monitor.rosbridge.server.send_queue import SendQueue, SlowClients


def send_queue(bound: int, high_water: int = 10) -> Any:
    transport = SlowTransport()
    return transport, SendQueue(transport, bound, lambda: None, high_water)  # type: ignore[arg-type]


def test_frames_go_straight_through_while_the_transport_takes_them() -> None:
    transport, queue = send_queue(100)
    assert queue.put(b"one") is False
    assert queue.put(b"two") is False
    assert transport.written == [b"one", b"two"]
    assert not queue.behind


def test_frames_wait_in_order_when_the_transport_is_full() -> None:
    transport, queue = send_queue(100)
    transport.buffered = 11
    assert queue.put(b"a") is True
    transport.buffered = 0
    assert queue.put(b"b") is True  # never before one that waits
    queue.flush()
    assert b"".join(transport.written) == b"ab"
    assert not queue.behind and queue.dropped == 0


def test_beyond_the_bound_the_oldest_are_dropped_and_counted() -> None:
    transport, queue = send_queue(6)
    transport.buffered = 11
    for frame in (b"aa", b"bb", b"cc", b"dd", b"ee"):
        queue.put(frame)
    assert queue.dropped == 2
    transport.buffered = 0
    queue.flush()
    assert b"".join(transport.written) == b"ccddee"


def test_a_frame_larger_than_the_bound_waits_alone_and_is_written_in_pieces() -> None:
    transport, queue = send_queue(6)
    transport.buffered = 11
    queue.put(b"first")
    queue.put(b"y" * 25)
    assert queue.dropped == 1
    for _ in range(4):
        transport.buffered = 0
        queue.flush()
    assert transport.written == [b"y" * 10, b"y" * 10, b"y" * 5]
    assert not queue.behind


def test_a_frame_that_was_sent_in_part_is_completed() -> None:
    transport, queue = send_queue(12)
    queue.put(b"a" * 11 + b"b" * 11)  # larger than a piece
    queue.put(b"12345")
    queue.put(b"67890")
    queue.put(b"last")
    while queue._bytes:
        transport.buffered = 0
        queue.flush()
    assert b"".join(transport.written) == b"a" * 11 + b"b" * 11 + b"67890last"
    assert queue.dropped == 1


def test_the_bytes_that_wait_are_bounded_whatever_is_put() -> None:
    transport, queue = send_queue(1000, 100)
    for number in range(500):
        queue.put(b"x" * (7 * number % 450))
        assert queue._bytes <= 1000 + 450 and transport.buffered <= 200
        transport.buffered //= 2
        queue.flush()


def test_a_cleared_queue_holds_nothing() -> None:
    transport, queue = send_queue(100)
    transport.buffered = 11
    queue.put(b"abc")
    queue.clear()
    transport.buffered = 0
    queue.flush()
    assert transport.written == []
    assert queue._bytes == 0 and not queue.behind


def test_flushing_stops_where_the_transport_is_full_again() -> None:
    transport, queue = send_queue(1000)
    transport.buffered = 11
    for _ in range(10):
        queue.put(b"12345")
    transport.buffered = 0
    queue.flush()
    assert queue.behind
    assert transport.written == [b"12345" * 2] * 2


def test_nothing_more_is_written_once_the_connection_has_broken() -> None:
    transport, queue = send_queue(1000)
    transport.buffered = 11
    for _ in range(10):
        queue.put(b"123456789")
    transport.buffered, transport.breaks = 0, True
    queue.flush()
    assert transport.written == [b"123456789"]


class Client:
    def __init__(self) -> None:
        self.events: List[str] = []
        self.transport: Any = SlowTransport(1_000_000)
        self.transport.abort = lambda: self.events.append("aborted")
        self.queue = SendQueue(self.transport, 1_000_000, lambda: self.events.append("caught up"))


async def wait_for_event(client: Client) -> None:
    while not client.events:
        await asyncio.sleep(0.001)


def test_a_queue_is_emptied_as_soon_as_the_client_reads_again() -> None:
    async def scenario() -> None:
        lines: List[str] = []
        slow = SlowClients(60.0, lines.append)
        client: Any = Client()
        client.queue.put(b"frame")
        slow.add(client.queue)
        client.transport.buffered = 0
        await asyncio.wait_for(wait_for_event(client), 20.0)
        assert (client.events, client.transport.written, lines) == (["caught up"], [b"frame"], [])
        assert client.queue.behind_since_s is None

    asyncio.run(scenario())


def test_a_client_that_stays_behind_is_disconnected() -> None:
    async def scenario() -> None:
        lines: List[str] = []
        slow = SlowClients(0.05, lines.append)
        stuck: Any = Client()
        left: Any = Client()
        for client in (stuck, left):
            client.queue.put(b"frame")
            slow.add(client.queue)
        slow.discard(left.queue)
        await asyncio.wait_for(wait_for_event(stuck), 20.0)
        assert (stuck.events, left.events) == (["aborted"], [])
        assert lines == ["disconnected a client: behind for more than 0.05 s"]

    asyncio.run(scenario())
