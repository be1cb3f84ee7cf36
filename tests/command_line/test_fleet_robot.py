"""One robot of a fleet: its link, its clock and its messages."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, List, Optional

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")

from harness.rosbridge_client import ForeignServer, scenario, until
from harness.watched_fleet import watching

from robot_health_monitor.core.middleware import Severity


def test_a_new_cause_of_a_link_that_is_down_is_one_line(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        url = await server.start()
        await server.close()
        async with watching([f"atlas={url}"], tmp_path) as watched:
            await until(lambda: bool(watched.alerts))
            assert watched.alerts == ["atlas: link ERROR: down: connection refused: no server listens on this port"]
            refusing = await asyncio.start_server(
                lambda reader, writer: writer.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"),
                "127.0.0.1",
                server.port,
            )
            await until(lambda: bool(watched.lines(Severity.WARN)))
            assert watched.lines(Severity.WARN) == ["atlas: still not connected: not a rosbridge server (HTTP 404)"]
            assert len(watched.alerts) == 1
            (robot,) = watched.fleet.robots
            status = robot.monitor.status("link", robot.now_s)
            assert status is not None and "not a rosbridge server (HTTP 404)" in status.message
            refusing.close()
            await refusing.wait_closed()

    run()


def test_a_server_that_accepts_and_closes_is_one_alert(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        loop = asyncio.get_event_loop()
        ends_s: List[float] = []

        async def hold_for_a_moment(socket: Any) -> None:
            """The first connections hold, and then shorter and shorter."""
            await asyncio.sleep(0.8 if len(ends_s) < 2 else 0.0)
            ends_s.append(loop.time())
            await socket.close()

        server.on_connect = hold_for_a_moment
        async with watching([f"atlas={await server.start()}"], tmp_path) as watched:
            await until(lambda: len(ends_s) >= 5)
            assert watched.alerts[0] == "atlas: link ERROR: down: the server closed the connection"
            assert len(watched.lines(Severity.INFO)) - len(watched.lines(Severity.WARN)) <= 3  # watching, connected
        await server.close()

    run()


@pytest.mark.parametrize("late", [False, True])
def test_under_simulated_time_no_signal_looks_stale_when_the_clock_starts(tmp_path: Path, late: bool) -> None:
    """Whether the robot is there from the start or comes later."""

    @scenario
    async def run() -> None:
        server: Optional[ForeignServer] = ForeignServer()
        assert server is not None
        url = await server.start()
        if late:
            await server.close()
        async with watching([f"atlas={url}"], tmp_path, sim=True) as watched:
            if late:
                await until(lambda: watched.alerts[:1] != [])
                again = ForeignServer()
                await again.start(server.port)
                server = again
            await until(lambda: any("connected to" in line for line in watched.lines(Severity.INFO)))
            await until(lambda: any(fields["op"] == "subscribe" for fields in server.received))
            for number in range(30):
                await server.publish("/battery_level", {"data": 50.0})
                await server.publish("/clock", {"clock": {"secs": 1_234 + number, "nsecs": 0}})
            await server.publish("/battery_level", {"data": 15.0})
            await until(lambda: "atlas: battery_level WARN: 15 is below 20" in watched.alerts)
            links = [alert for alert in watched.alerts if "link" in alert]
            assert watched.alerts[:-1] == links
            assert links[1:] == (["atlas: link OK: up"] if late else [])
            assert watched.fleet.robots[0].now_s == 1_263.0
        await server.close()

    run()


def test_the_nodes_own_status_counts_messages_that_were_too_large(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        async with watching([f"atlas={await server.start()}"], tmp_path) as watched:
            await until(lambda: bool(server.received))
            await server.publish("/battery_level", {"data": 50.0, "padding": "A" * 1_200_000})
            (robot,) = watched.fleet.robots
            await until(lambda: robot.alert_system.self_monitor.status().values["dropped"] == "1")
            await server.publish("/battery_level", {"data": 15.0})
            await until(lambda: watched.alerts == ["atlas: battery_level WARN: 15 is below 20"])
            assert len(server.sockets) == 1
        await server.close()

    run()
