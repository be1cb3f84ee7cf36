"""Reading in turns and in pieces, floods, and cancellations that must not be lost."""

from __future__ import annotations

import asyncio
from typing import Any

import aiohttp
import pytest
from aiohttp import web_protocol
from harness.rosbridge_client import scenario
from harness.rosbridge_peer import Robot, with_robot

from robot_health_monitor.runtime.sockets import MOST_EMPTY_PER_SECOND, READ_BYTES, Incoming, limit_reads, within


def incoming() -> Incoming:
    """Not connected, for one that is given the times."""
    one = Incoming(None)  # type: ignore[arg-type]
    one._turn_s = one._done_s = 0.0
    return one


class Arrivals:
    """A WebSocket whose messages arrive `waited_s` after they are asked for, and take 1/1024 s of work each."""

    def __init__(self, waited_s: float) -> None:
        self.now_s = 0.0
        self._waited_s = waited_s

    async def receive(self, timeout: float | None) -> aiohttp.WSMessage:
        self.now_s += self._waited_s
        return aiohttp.WSMessage(aiohttp.WSMsgType.TEXT, "{}", None)

    async def turns(self, messages: int) -> list[int]:
        """Reads so many messages; returns the numbers of those before which other tasks could run."""
        one = Incoming(self)  # type: ignore[arg-type]
        one._clock = lambda: self.now_s
        one._turn_s = one._done_s = 0.0
        numbers: list[int] = []
        number = 0

        async def note() -> None:
            while True:
                if numbers[-1:] != [number]:
                    numbers.append(number)
                await asyncio.sleep(0)

        noting = asyncio.ensure_future(note())
        for number in range(1, messages + 1):  # noqa: B007 - `note` reads it
            await one.next()
            self.now_s += 1 / 1024
        noting.cancel()
        return numbers


@scenario
async def test_a_turn_is_over_after_ten_milliseconds_of_messages_that_already_waited() -> None:
    assert await Arrivals(waited_s=0.0).turns(messages=24) == [12, 23]


@scenario
async def test_a_message_that_was_waited_for_begins_a_turn() -> None:
    """Other tasks ran meanwhile: a slow stream is not interrupted in addition."""
    assert await Arrivals(waited_s=0.001).turns(messages=100) == []


def test_a_transport_without_a_size_of_reads_is_left_as_it_is() -> None:
    transport = asyncio.Transport()
    limit_reads(transport)
    assert not hasattr(transport, "max_size")


def test_asyncio_still_has_the_setting() -> None:
    class Transport(asyncio.selector_events._SelectorTransport):  # type: ignore[name-defined,misc]  # not in the stubs
        def __init__(self) -> None:
            """Without a socket."""

        def __del__(self) -> None:
            """There is nothing to close."""

    transport = Transport()
    assert transport.max_size > READ_BYTES
    limit_reads(transport)
    assert transport.max_size == READ_BYTES


@scenario
async def test_the_limit_is_a_hundred_frames_in_a_second() -> None:
    limit = incoming()
    assert MOST_EMPTY_PER_SECOND == 100
    assert [limit._is_flood(50.0 + 0.009 * frame) for frame in range(101)] == [False] * 100 + [True]


@scenario
async def test_a_new_second_counts_anew() -> None:
    limit = incoming()
    assert not any(limit._is_flood(50.0) for _ in range(100))
    assert limit._is_flood(50.999)
    assert not any(limit._is_flood(51.0) for _ in range(100))
    assert limit._is_flood(51.5)


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
def test_a_client_that_floods_the_server_with_empty_frames_is_disconnected(kind: str) -> None:
    @with_robot()
    async def scenario(robot: Robot) -> None:
        async with robot.peer() as other, robot.peer() as peer:
            write(peer, 101 * raw(FRAMES[kind]))
            await peer.closed()
            await other.settle()
        assert robot.log == ["disconnected a client at 127.0.0.1: it floods the server with pings or empty messages"]

    scenario()


@with_robot()
async def test_pings_are_answered(robot: Robot) -> None:
    async def ping(peer: Any) -> None:
        await peer.socket.ping(b"here?")
        message = await peer.socket.receive(timeout=20.0)
        assert (message.type, bytes(message.data)) == (aiohttp.WSMsgType.PONG, b"here?")

    async with robot.peer(autoping=False) as peer:
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
    turns: list[int] = []
    received = 0

    async def count_turns() -> None:
        while True:
            turns.append(received)
            await asyncio.sleep(0)

    async with robot.peer() as peer:
        counting = asyncio.ensure_future(count_turns())

        def count(fields: Any, limits: Any) -> Any:
            nonlocal received
            received += 1
            sum(range(10_000))  # work
            return {"op": "status"}

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("robot_health_monitor.rosbridge.server.session.decode", count)
            write(peer, 5_000 * (b"\x81\x82" + bytes(4) + b"{}"))
            await robot.until(lambda: received == 5_000)
        counting.cancel()
        in_one_turn = max(later - earlier for earlier, later in zip(turns, turns[1:]))
        assert in_one_turn < 2_000


@with_robot()
async def test_a_client_is_read_in_pieces(robot: Robot) -> None:
    """256 kB at once, asyncio's default, are 40,000 empty frames."""
    sizes: list[int] = []
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


@pytest.mark.parametrize("error", [None, ConnectionRefusedError()])
def test_a_cancellation_is_not_lost_when_the_attempt_ends_at_the_same_moment(error: Any) -> None:
    @scenario
    async def run() -> None:
        attempt = asyncio.get_event_loop().create_future()
        waiting: list[bool] = []

        async def work() -> None:
            waiting.append(True)
            await attempt

        task = asyncio.ensure_future(within(10.0, work()))
        while not waiting:
            await asyncio.sleep(0)
        if error is None:
            attempt.set_result(None)
        else:
            attempt.set_exception(error)
        task.cancel()
        await asyncio.wait({task})
        assert task.cancelled()

    run()


@scenario
async def test_an_attempt_that_takes_too_long_is_given_up() -> None:
    work = asyncio.ensure_future(asyncio.sleep(60.0))

    async def wait_for_work() -> None:
        await work

    with pytest.raises(asyncio.TimeoutError):
        await within(0.01, wait_for_work())
    await asyncio.wait({work})
    assert work.cancelled()
