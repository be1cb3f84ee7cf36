"""The robots of one process: each with its own connection, clock and failures."""

from __future__ import annotations

import asyncio
import contextlib
import time
from pathlib import Path
from typing import Any, AsyncIterator, List, Optional

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")

from harness.rosbridge_client import ForeignServer, scenario, until

from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Transition
from robot_health_monitor.core.outlets import Event, Outlet
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.fleet import Fleet, read_addresses

THRESHOLDS = """
alert_system:
  ros__parameters:
    use_sim_time: {sim}
    signals:
      battery_level: {{type: std_msgs/Float32, field: data, warn_below: 20.0, stale_after_s: 5.0, startup_grace_s: 5.0}}
"""


class Watching:
    """A fleet that runs, and what it announced."""

    def __init__(self, urls: List[str], thresholds: Path, sim: bool) -> None:
        file = thresholds / "thresholds.yaml"
        file.write_text(THRESHOLDS.format(sim=str(sim).lower()))
        self.log: List[LogLine] = []
        self.alerts: List[str] = []
        self.fleet = Fleet(
            read_addresses(urls), read_yaml(file), clock=time.monotonic, on_log=self.log.append, outlet=self._outlet
        )

    def _outlet(self, robot: str) -> Outlet:
        def on_event(event: Event) -> None:
            if isinstance(event, Transition):
                self.alerts.append(f"{robot}: {event.text.partition(' (was')[0]}")

        return on_event

    def lines(self, least: Severity) -> List[str]:
        return [f"{line.node}: {line.text}" for line in self.log if line.severity >= least]


@contextlib.asynccontextmanager
async def watching(urls: List[str], thresholds: Path, *, sim: bool = False) -> AsyncIterator[Watching]:
    watched = Watching(urls, thresholds, sim)
    task = asyncio.ensure_future(watched.fleet.run())
    try:
        yield watched
    finally:
        watched.fleet.close()
        task.cancel()
        await asyncio.wait({task})


def test_a_robot_that_sends_nonsense_does_not_disturb_another_one(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        bad, good = ForeignServer(), ForeignServer()
        urls = [f"bad={await bad.start()}", f"good={await good.start()}"]
        async with watching(urls, tmp_path) as watched:
            await until(lambda: bool(bad.received) and bool(good.received))
            for text in (
                '{"op": "call_service", "service": "/x", "id": "\\ud800"}',
                '{"op": "publish", "topic": "/battery_level", "msg": {"data": 1' + "0" * 5_000 + "}}",
                '{"op": "publish", "topic": "/battery_level", "msg": {"data": "\\u001b[2J\\ud800"}}',
            ):
                await bad.sockets[0].send_str(text)
            await good.publish("/battery_level", {"data": 15.0})
            await until(lambda: "good: battery_level WARN: 15 is below 20" in watched.alerts)
            await until(lambda: any(alert.startswith("bad: battery_level ERROR: invalid") for alert in watched.alerts))
            assert len(bad.sockets) == len(good.sockets) == 1
        await bad.close()
        await good.close()

    run()


def test_a_robot_whose_connection_crashes_is_one_error_line_and_others_go_on(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        good = ForeignServer()
        urls = ["bad=ws://127.0.0.1:1", f"good={await good.start()}"]
        async with watching(urls, tmp_path) as watched:
            client: Any = watched.fleet.robots[0]._client

            async def crash() -> None:
                raise RuntimeError("bug \x1b[2J")

            client.run = crash
            await until(lambda: bool(good.received))
            await good.publish("/battery_level", {"data": 15.0})
            await until(lambda: "good: battery_level WARN: 15 is below 20" in watched.alerts)
            await until(lambda: bool(watched.lines(Severity.ERROR)))
            assert watched.lines(Severity.ERROR) == ["bad: internal error, reconnecting in 5 s: RuntimeError: bug ?[2J"]
            assert "bad: link ERROR: down: internal error: RuntimeError" in watched.alerts
        await good.close()

    run()


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
            (monitor,) = watched.fleet.monitors
            status = monitor.status("link", watched.fleet.now_s)
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
            assert watched.fleet.now_s == 1_263.0
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
            await until(lambda: robot.alert_system.self_report["dropped"]() == "1")
            await server.publish("/battery_level", {"data": 15.0})
            await until(lambda: watched.alerts == ["atlas: battery_level WARN: 15 is below 20"])
            assert len(server.sockets) == 1
        await server.close()

    run()
