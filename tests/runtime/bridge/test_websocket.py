"""Looking up hosts in threads that nothing waits for, whether a server answers, and the send queue."""

from __future__ import annotations

import asyncio
import socket
import struct
import threading
from typing import Any, Awaitable, Callable

import pytest
from harness.virtual_loop import run_in_virtual_time

pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")

from robot_health_monitor.runtime.bridge.websocket import HostLookup, wait_until_unanswered, write


def test_the_addresses_are_numeric() -> None:
    (found, *_) = asyncio.run(HostLookup().resolve("localhost", 9090, socket.AF_INET))
    assert (found["hostname"], found["host"], found["port"]) == ("localhost", "127.0.0.1", 9090)
    assert found["family"] == socket.AF_INET


def test_an_unknown_host_is_an_os_error() -> None:
    with pytest.raises(OSError):
        asyncio.run(HostLookup().resolve("no-such-robot.invalid", 9090))


def test_a_look_up_that_hangs_is_joined_and_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    release = threading.Event()
    real = socket.getaddrinfo

    def hang(host: str, *arguments: Any, **options: Any) -> Any:
        asked.append(host)
        release.wait()
        return real("127.0.0.1", *arguments, **options)

    async def run() -> None:
        lookup = HostLookup()
        for _ in range(3):
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(lookup.resolve("robot", 9090), 0.01)
        assert asked == ["robot"]
        release.set()
        assert (await lookup.resolve("robot", 9090))[0]["host"] == "127.0.0.1"

    monkeypatch.setattr(socket, "getaddrinfo", hang)
    asyncio.run(run())


PERIOD_S = 5.0
DAY_S = 86_400.0


class Server:
    """The end of a connection that this process sees: it answers pings after some time, or not at all."""

    def __init__(self, answers_after_s: Callable[[], float | None]) -> None:
        self._answers_after_s = answers_after_s
        self.loop = asyncio.get_event_loop()
        self.received_s = self.loop.time()
        self.pings: list[float] = []
        self.sends: Callable[[], Awaitable[None]] = lambda: asyncio.sleep(0)

    async def ping(self) -> None:
        self.pings.append(self.loop.time())
        await self.sends()
        delay_s = self._answers_after_s()
        if delay_s is not None:
            self.loop.call_later(delay_s, self.receive)

    def receive(self) -> None:
        self.received_s = self.loop.time()

    def get_extra_info(self, name: str) -> Server:
        """Returns the socket in the kernel."""
        assert name == "socket"
        return self

    def getsockopt(self, level: int, option: int, length: int) -> bytes:
        """Returns Linux' `struct tcp_info`: the milliseconds since data came are its 12th number of 32 bits."""
        assert (level, option) == (socket.IPPROTO_TCP, socket.TCP_INFO)
        silent_ms = round(1000.0 * (self.loop.time() - self.received_s))
        return struct.pack("=8B24I", *[0] * 8, *[0] * 11, silent_ms, *[0] * 12)[:length]

    async def wait_until_unanswered(self) -> float:
        """Returns when it is down."""
        end: Any = self
        await wait_until_unanswered(end, PERIOD_S)
        return self.loop.time()


@pytest.mark.newest_python
@pytest.mark.parametrize("answers_after_s", [0.0, 0.001, 1.0, 2.4])
def test_a_day_without_traffic_is_no_silence_of_a_server_that_answers(answers_after_s: float) -> None:
    async def run() -> None:
        server = Server(lambda: answers_after_s)
        waiting = asyncio.ensure_future(server.wait_until_unanswered())
        await asyncio.wait({waiting}, timeout=DAY_S)
        assert not waiting.done()
        assert len(server.pings) >= 10_000  # it was asked all day long
        waiting.cancel()

    run_in_virtual_time(run())


@pytest.mark.parametrize("stops_s", [0.0, 5.1, 101.7, 104.9])
def test_a_server_that_stops_answering_is_down_after_at_most_eight_seconds(stops_s: float) -> None:
    async def run() -> None:
        server = Server(lambda: None if server.loop.time() >= stops_s else 0.001)
        assert stops_s <= await server.wait_until_unanswered() <= stops_s + 8.0

    run_in_virtual_time(run())


def test_a_server_that_sends_is_never_asked() -> None:
    async def run() -> None:
        server = Server(lambda: None)
        waiting = asyncio.ensure_future(server.wait_until_unanswered())
        for _ in range(1000):
            await asyncio.sleep(1.0)
            server.receive()
        assert not waiting.done()
        assert server.pings == []
        waiting.cancel()

    run_in_virtual_time(run())


def test_a_server_that_sends_but_answers_no_ping_is_up() -> None:
    async def run() -> None:
        server = Server(lambda: None)
        waiting = asyncio.ensure_future(server.wait_until_unanswered())
        for _ in range(1000):
            await asyncio.sleep(7.0)
            server.receive()
        assert not waiting.done()
        waiting.cancel()

    run_in_virtual_time(run())


def test_a_ping_that_cannot_be_sent_delays_nothing() -> None:
    async def run() -> None:
        server = Server(lambda: None)
        server.sends = lambda: asyncio.sleep(1000.0)
        assert await server.wait_until_unanswered() <= 8.0

    run_in_virtual_time(run())


def test_a_connection_that_has_ended_cannot_be_asked() -> None:
    async def run() -> None:
        async def fail() -> None:
            raise ConnectionResetError

        server = Server(lambda: None)
        server.sends = fail
        assert await server.wait_until_unanswered() <= 8.0

    run_in_virtual_time(run())


class Writer:
    """The end of a connection to which messages are written."""

    def __init__(self) -> None:
        self.sent: list[str | bytes] = []

    async def send_str(self, text: str) -> None:
        text.encode()
        self.sent.append(text)

    async def send_bytes(self, data: bytes) -> None:
        self.sent.append(data)


def test_messages_are_written_in_their_order_but_for_one_that_is_no_text() -> None:
    async def scenario() -> None:
        wires: asyncio.Queue[str | bytes] = asyncio.Queue()
        writer: Any = Writer()
        writing = asyncio.ensure_future(write(wires, writer))
        for wire in ("one", b"two", "\ud800", "three"):
            wires.put_nowait(wire)
        await asyncio.sleep(0)
        while len(writer.sent) < 3:
            await asyncio.sleep(0)
        assert writer.sent == ["one", b"two", "three"]
        writing.cancel()

    asyncio.run(scenario())
