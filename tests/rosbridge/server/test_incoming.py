"""What the server reads from one client: messages, pings and floods."""

from __future__ import annotations

import asyncio
from typing import Any, List

import aiohttp
import pytest
from aiohttp import web_protocol
from harness.rosbridge_peer import Robot, with_robot

from robot_health_monitor.rosbridge.server.access import Access
from robot_health_monitor.rosbridge.turns import READ_BYTES

FRAMES = {"ping": b"\x89\x80", "pong": b"\x8a\x80", "text": b"\x81\x80", "binary": b"\x82\x80"}


def raw(frame: bytes) -> bytes:
    """A client's frame without content, masked with zeros."""
    return frame + bytes(4)


def write(peer: Any, data: bytes) -> None:
    """Sends bytes past the client's WebSocket."""
    transport = peer.socket._conn.transport
    assert isinstance(transport, asyncio.WriteTransport)
    transport.write(data)


@pytest.mark.parametrize("kind", FRAMES)
@pytest.mark.parametrize("token", ["", "s3cret"])
def test_a_client_that_floods_the_server_with_empty_frames_is_disconnected(kind: str, token: str) -> None:
    @with_robot(Access(token=token))
    async def scenario(robot: Robot) -> None:
        headers = {"Authorization": f"Bearer {token}"}
        async with robot.peer(headers=headers) as other, robot.peer() as peer:
            write(peer, 101 * raw(FRAMES[kind]))
            await peer.closed()
            await other.settle()
        assert robot.log == ["disconnected a client at 127.0.0.1: it floods the server with pings or empty messages"]

    scenario()


@with_robot(Access(token="s3cret"))
async def test_pings_are_answered_before_and_after_the_token(robot: Robot) -> None:
    async def ping(peer: Any) -> None:
        await peer.socket.ping(b"here?")
        message = await peer.socket.receive(timeout=20.0)
        assert (message.type, bytes(message.data)) == (aiohttp.WSMsgType.PONG, b"here?")

    async with robot.peer(autoping=False) as peer:
        await ping(peer)
    async with robot.peer(autoping=False, headers={"Authorization": "Bearer s3cret"}) as peer:
        await ping(peer)
        await peer.settle()
        await ping(peer)


@with_robot()
async def test_a_hundred_empty_frames_in_a_second_are_no_flood(robot: Robot) -> None:
    async with robot.peer() as peer:
        write(peer, 100 * raw(FRAMES["pong"]))
        await peer.settle()
    assert robot.log == []


@with_robot()
async def test_messages_that_already_wait_are_read_in_turns_with_other_tasks(robot: Robot) -> None:
    """65,000 messages of two bytes fit into aiohttp's buffer: they took four seconds without a pause."""
    turns: List[int] = []
    received = 0

    async def count_turns() -> None:
        while True:
            turns.append(received)
            await asyncio.sleep(0)

    async with robot.peer() as peer:
        counting = asyncio.ensure_future(count_turns())

        def count(self: Any, fields: Any, now_s: float) -> None:
            nonlocal received
            received += 1
            sum(range(10_000))  # work

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("robot_health_monitor.rosbridge.protocol.Connection.receive", count)
            write(peer, 5_000 * (b"\x81\x82" + bytes(4) + b"{}"))
            await robot.until(lambda: received == 5_000)
        counting.cancel()
        in_one_turn = max(later - earlier for earlier, later in zip(turns, turns[1:]))
        assert in_one_turn < 2_000


@with_robot()
async def test_a_client_is_read_in_pieces(robot: Robot) -> None:
    """256 kB at once, asyncio's default, are 40,000 empty frames."""
    sizes: List[int] = []
    receive = web_protocol.RequestHandler.data_received

    def measure(self: Any, data: bytes) -> None:
        sizes.append(len(data))
        receive(self, data)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(web_protocol.RequestHandler, "data_received", measure)
        async with robot.peer() as peer:
            await peer.socket.send_str(" " * 500_000)
            await peer.settle()
    assert sum(sizes) > 500_000
    assert max(sizes) <= READ_BYTES
