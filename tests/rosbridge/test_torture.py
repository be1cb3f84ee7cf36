"""Clients that nobody wants: the server goes on, and a client that behaves loses nothing."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket as sockets
from typing import AsyncIterator, List

import aiohttp
import pytest
from harness.rosbridge_peer import Peer, Robot, with_robot

from robot_health_monitor.rosbridge.protocol.limits import Limits


@contextlib.asynccontextmanager
async def well_behaved(robot: Robot) -> AsyncIterator[List[float]]:
    """A client that reads all the while, beside whatever else happens; checks at the end that it lost nothing."""
    sent: List[float] = []
    received: List[float] = []

    async def read(peer: Peer) -> None:
        while True:
            received.append((await peer.receive())["msg"]["data"])

    async def publish() -> None:
        while True:
            sent.append(float(len(sent)))
            robot.publish(sent[-1])
            await asyncio.sleep(0.001)

    async with robot.peer() as peer:
        await peer.subscribe("/battery_level")
        tasks = [asyncio.ensure_future(read(peer)), asyncio.ensure_future(publish())]
        try:
            yield received
            await robot.until(lambda: len(received) > 200)
            tasks[1].cancel()
            await robot.until(lambda: len(received) >= len(sent))
        finally:
            for task in tasks:
                task.cancel()
        assert received == sent


def raw_socket(robot: Robot) -> sockets.socket:
    connection = sockets.create_connection(("127.0.0.1", robot.server.port), 10.0)
    connection.setsockopt(sockets.SOL_SOCKET, sockets.SO_RCVBUF, 4096)
    return connection


HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def text_frame(text: bytes) -> bytes:
    """A client's frame, masked with zeros."""
    assert len(text) < 126
    return bytes([0x81, 0x80 | len(text)]) + bytes(4) + text


SUBSCRIBE = text_frame(b'{"op":"subscribe","topic":"/big","type":"std_msgs/String"}')


async def stalled_client(robot: Robot) -> sockets.socket:
    """Subscribes to /big and never reads again."""
    loop = asyncio.get_event_loop()
    connection = await loop.run_in_executor(None, raw_socket, robot)
    connection.setblocking(False)
    await loop.sock_sendall(connection, HANDSHAKE)
    await robot.until(lambda: robot.server.clients >= 1)
    await loop.sock_sendall(connection, SUBSCRIBE)
    await robot.until(lambda: "/big" in robot.bus.graph().nodes["/rosbridge"].subscribes)
    return connection


@with_robot(limits=Limits(queue_bytes=100_000), slow_client_timeout_s=0.5, heartbeat_s=60.0)
async def test_a_stalled_client_loses_its_own_messages_and_is_then_cut_off(robot: Robot) -> None:
    robot.node.advertise("/big", "std_msgs/String")
    stalled = await stalled_client(robot)
    async with well_behaved(robot):
        sessions = {session for session in robot.server._sessions if session._subscriptions.get("/big")}
        (session,) = sessions
        while session in robot.server._sessions:
            robot.node.publish("/big", {"data": "x" * 100_000})
            waiting = session.queue.waiting_bytes + session._transport.get_write_buffer_size()
            assert waiting <= 100_000 + 2 * 65_536 + 101_000  # the bound, the transport's buffer, one message
            await asyncio.sleep(0.001)
        assert session.dropped > 5
        assert session.queue.waiting_bytes == 0
    assert [text for text in robot.log if "disconnected" in text] == [
        "rosbridge: disconnected a client: behind for more than 0.5 s"
    ]
    stalled.close()


@with_robot(limits=Limits(queue_bytes=50_000))
async def test_a_client_that_catches_up_is_told_what_it_lost_and_stays(robot: Robot) -> None:
    robot.node.advertise("/big", "std_msgs/String")
    async with robot.peer(max_msg_size=0) as peer:
        await peer.send("set_level", level="warning")
        await peer.subscribe("/big")
        # One call of the loop: nothing can be sent on between these.
        for number in range(1000):
            robot.node.publish("/big", {"data": f"{number:04d}" + "x" * 10_000})
        numbers = []
        while True:
            message = await peer.receive()
            if message["op"] == "status":
                break
            numbers.append(int(message["msg"]["data"][:4]))
        assert numbers == sorted(numbers) and numbers[0] == 0 and numbers[-1] == 999
        lost = 1000 - len(numbers)
        assert lost > 0
        assert message["msg"] == f"{lost} messages were dropped: this client reads too slowly"
        await peer.settle()


@with_robot(max_clients=450)
async def test_a_thousand_connections_are_opened_and_dropped(robot: Robot) -> None:
    async with well_behaved(robot):
        loop = asyncio.get_event_loop()
        for batch in range(20):
            connections = []
            for index in range(50):
                connection = await loop.run_in_executor(None, raw_socket, robot)
                if batch % 2:
                    connection.sendall(HANDSHAKE + (SUBSCRIBE if index % 2 else b""))
                connections.append(connection)
            for connection in connections:
                if batch % 4 == 3:  # a reset instead of a goodbye
                    connection.setsockopt(sockets.SOL_SOCKET, sockets.SO_LINGER, b"\1\0\0\0\0\0\0\0")
                connection.close()
        await robot.until(lambda: robot.server.clients == 1)
    await robot.until(lambda: robot.bus.graph().nodes["/rosbridge"].subscribes == ())


@with_robot(heartbeat_s=0.4, auth_timeout_s=0.4)
async def test_half_open_sockets_are_closed(robot: Robot) -> None:
    """One never says a word, one stops in the middle of its request, one does not answer pings any more."""
    loop = asyncio.get_event_loop()
    silent, half, dead = [await loop.run_in_executor(None, raw_socket, robot) for _ in range(3)]
    half.sendall(HANDSHAKE[:40])
    dead.sendall(HANDSHAKE)
    async with well_behaved(robot):
        for connection in (silent, half, dead):
            connection.settimeout(20.0)

            def until_closed(closing: sockets.socket = connection) -> None:
                with contextlib.suppress(ConnectionError):
                    while closing.recv(4096):
                        pass

            await loop.run_in_executor(None, until_closed)
            connection.close()
        await robot.until(lambda: robot.server.clients == 1)


@pytest.mark.parametrize(
    "garbage",
    [
        b"\x81\x85\0\0\0\0hello",
        b"\x82\x83\0\0\0\0\xff\xff\xff",
        b"\x81\x83\0\0\0\0\xff\xff\xff",  # text that is no UTF-8
        b"\xff\xff\xff\xff\xff\xff\xff\xff",  # no frame at all
        b"\x81\xff\x7f\xff\xff\xff\xff\xff\xff\xff\0\0\0\0",  # a frame of 2**63 - 1 bytes
        b"\x81\x05hello",  # not masked
        b"\x80\x80\0\0\0\0",  # the rest of nothing
        b"\x88\x81\0\0\0\0x",  # a goodbye that is cut
        os.urandom(4096),
    ],
)
def test_garbage_frames_hurt_nobody_else(garbage: bytes) -> None:
    @with_robot()
    async def scenario(robot: Robot) -> None:
        async with well_behaved(robot):
            loop = asyncio.get_event_loop()
            for opening in (b"", HANDSHAKE):
                connection = await loop.run_in_executor(None, raw_socket, robot)
                connection.sendall(opening + garbage)
                connection.shutdown(sockets.SHUT_WR)
                connection.settimeout(20.0)

                def drain(closing: sockets.socket = connection) -> None:
                    with contextlib.suppress(ConnectionError):
                        while closing.recv(4096):
                            pass

                await loop.run_in_executor(None, drain)
                connection.close()
            await robot.until(lambda: robot.server.clients == 1)

    scenario()


@with_robot(limits=Limits(message_bytes=1000))
async def test_a_frame_above_the_limit_ends_its_own_connection_only(robot: Robot) -> None:
    async with well_behaved(robot), robot.peer() as peer:
        await peer.send("publish", topic="/in", msg={"data": "x" * 2000})
        assert await peer.closed() == aiohttp.WSCloseCode.MESSAGE_TOO_BIG


@with_robot(limits=Limits(subscriptions=3, calls=2, advertisements=2))
async def test_what_one_client_may_ask_for_is_bounded(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        for number in range(4):
            await peer.send("subscribe", topic="/battery_level", id=number)
        assert (await peer.receive())["msg"] == "subscribe: more than 3 subscriptions"
        await peer.settle()
