"""Host names are looked up in threads that nothing waits for."""

from __future__ import annotations

import asyncio
import socket
import threading
from typing import Any, List

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")

from robot_health_monitor.rosbridge.client.host_lookup import HostLookup


def test_the_addresses_are_numeric() -> None:
    (found, *_) = asyncio.run(HostLookup().resolve("localhost", 9090, socket.AF_INET))
    assert (found["hostname"], found["host"], found["port"]) == ("localhost", "127.0.0.1", 9090)
    assert found["family"] == socket.AF_INET


def test_an_unknown_host_is_an_os_error() -> None:
    with pytest.raises(OSError):
        asyncio.run(HostLookup().resolve("no-such-robot.invalid", 9090))


def test_a_look_up_that_hangs_is_joined_and_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: List[Any] = []
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
