"""The robots of one process: each with its own connection, link, clock, messages and failures."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any, AsyncIterator

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")

from harness.rosbridge_client import ForeignServer, scenario, until
from harness.watched_fleet import watching

from robot_health_monitor.cli.fleet import Fleet
from robot_health_monitor.cli.fleet_configuration import Options, RobotSettings, read_robots
from robot_health_monitor.cli.monitor_process import reload_all
from robot_health_monitor.cli.operations import Operations
from robot_health_monitor.core.nodes.outlets import Event, Outlet
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.ops.configuration import OpsConfig
from robot_health_monitor.runtime.tokens import TokenFiles


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


FLEET_THRESHOLDS = "alert_system: {ros__parameters: {signals: {SIGNALS}}}\n"
BATTERY = "battery_level: {type: std_msgs/Float32, warn_below: 20.0, stale_after_s: 1000.0, startup_grace_s: 1000.0}"
TEMPERATURE = "temperature: {type: std_msgs/Float32, warn_above: 80.0, stale_after_s: 1000.0, startup_grace_s: 1000.0}"


class Reloadable:
    """A fleet from a fleet.yaml that can be written again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.log: list[LogLine] = []
        self.alerts: list[str] = []
        self.operations = Operations(OpsConfig())
        self.fleet: Any = None

    def write(self, robots: str, signals: str = BATTERY) -> None:
        (self.folder / "t.yaml").write_text(FLEET_THRESHOLDS.replace("SIGNALS", signals))
        (self.folder / "fleet.yaml").write_text(f"defaults: {{thresholds: t.yaml}}\nrobots:\n{robots}")

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        read = partial(read_robots, (), str(self.folder / "fleet.yaml"), Options(), TokenFiles(lambda text: None))
        self.fleet = Fleet(read, self.operations, clock=time.monotonic, on_log=self.log.append, outlet=self._outlet)
        running = asyncio.ensure_future(self.fleet.run())
        try:
            yield
        finally:
            running.cancel()
            await asyncio.wait({running})
            self.fleet.close()
            self.operations.close()

    async def reload(self) -> str:
        """Reloads; returns the line about it."""
        await reload_all([self.fleet.reload], self.fleet.node.log)
        return self._reloads()[-1].replace(str(self.folder), "")

    def _reloads(self) -> list[str]:
        return [f"{line.severity.name} {line.text}" for line in self.log if "reloaded" in line.text]

    def _outlet(self, robot: str) -> Outlet:
        def on_event(event: Event) -> None:
            if isinstance(event, Transition):
                self.alerts.append(f"{robot}: {event.text.partition(' (was')[0]}")

        return on_event


@pytest.mark.parametrize(
    ("count", "line"), [(1, "watching 1 robot, 1 signal"), (200, "watching 200 robots, 200 signals")]
)
def test_robots_have_one_line_together_at_the_start(tmp_path: Path, count: int, line: str) -> None:
    fleet = Reloadable(tmp_path)

    def write(count: int) -> list[RobotSettings]:
        fleet.write("".join(f"  r{number}: {{url: 'ws://127.0.0.1:1'}}\n" for number in range(count)))
        return read()

    def logged() -> list[str]:
        return [f"{line.node}: {line.text}" for line in fleet.log if "history is in memory" not in line.text]

    read = partial(read_robots, (), str(tmp_path / "fleet.yaml"), Options(), TokenFiles(lambda text: None))
    write(count)
    outlet: Any = lambda robot: lambda event: None  # noqa: E731
    watched = Fleet(read, fleet.operations, clock=time.monotonic, on_log=fleet.log.append, outlet=outlet)
    assert logged() == [f"/connect: {line}"]
    fleet.log.clear()
    watched.apply(write(count + 2))
    assert logged() == []  # the line about the reload says it
    watched.close()
    fleet.operations.close()


def test_a_reload_adds_and_removes_robots_and_leaves_the_others_alone(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        stays, goes, comes = ForeignServer(), ForeignServer(), ForeignServer()
        urls = [await server.start() for server in (stays, goes, comes)]
        fleet = Reloadable(tmp_path)
        fleet.write(f"  stays: {{url: {urls[0]}}}\n  goes: {{url: {urls[1]}}}\n  gone: {{url: ws://127.0.0.1:1}}\n")
        async with fleet.running():
            await until(lambda: bool(stays.received) and bool(goes.received))
            await stays.publish("/battery_level", {"data": 15.0})
            await goes.publish("/battery_level", {"data": 15.0})
            await until(lambda: len(fleet.alerts) == 3)
            fleet.alerts.clear()
            fleet.write(f"  comes: {{url: {urls[2]}}}\n  stays: {{url: {urls[0]}}}\n")
            assert await fleet.reload() == "INFO reloaded: goes: removed, gone: removed, comes: added"
            assert fleet.alerts == [
                "goes: battery_level OK: no longer watched",
                "gone: link OK: no longer watched",
            ]
            assert [robot.name for robot in fleet.fleet.robots] == ["comes", "stays"]
            await until(lambda: bool(comes.received))
            await comes.publish("/battery_level", {"data": 15.0})
            await until(lambda: fleet.alerts[2:] == ["comes: battery_level WARN: 15 is below 20"])
            assert len(stays.requests) == 1
            assert await fleet.reload() == "INFO reloaded: nothing changed"
        for server in (stays, goes, comes):
            await server.close()

    run()


def test_changed_thresholds_are_applied_without_a_new_connection_or_a_second_alert(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        robots = f"  husky: {{url: {await server.start()}}}\n"
        fleet = Reloadable(tmp_path)
        fleet.write(robots, f"{BATTERY}, {TEMPERATURE}")
        async with fleet.running():
            await until(lambda: len(server.received) >= 2)
            await server.publish("/battery_level", {"data": 15.0})
            await server.publish("/temperature", {"data": 70.0})
            await until(lambda: fleet.alerts == ["husky: battery_level WARN: 15 is below 20"])
            status = fleet.fleet.robots[0].alert_system.monitor.status
            await until(lambda: status("temperature", 0.0).values["good_samples"] == "1")
            fleet.write(robots, f"{BATTERY}, {TEMPERATURE.replace('80.0', '60.0')}")
            assert await fleet.reload() == "INFO reloaded: husky: temperature.warn_above: 80 -> 60"
            assert fleet.alerts[1:] == ["husky: temperature WARN: 70 is above 60"]
            assert status("battery_level", 0.0).values["good_samples"] == "1"
            fleet.write(robots, BATTERY)
            assert await fleet.reload() == "INFO reloaded: husky: removed temperature"
            assert fleet.alerts[2:] == ["husky: temperature OK: no longer watched"]
            assert len(server.requests) == 1
        await server.close()

    run()


def test_a_new_address_is_connected_to_without_an_alert_of_the_link(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        old, new = ForeignServer(), ForeignServer()
        fleet = Reloadable(tmp_path)
        fleet.write(f"  husky: {{url: {await old.start()}}}\n")
        new_url = await new.start()
        async with fleet.running():
            await until(lambda: bool(old.received))
            await old.publish("/battery_level", {"data": 15.0})
            await until(lambda: len(fleet.alerts) == 1)
            fleet.write(f"  husky: {{url: {new_url}}}\n")
            assert await fleet.reload() == f"INFO reloaded: husky: connecting again, to {new_url}"
            await until(lambda: bool(new.received))
            await new.publish("/battery_level", {"data": 50.0})
            await until(lambda: fleet.alerts[1:] == ["husky: battery_level OK: 50 is no longer below 20"])
            await until(lambda: old.sockets[0].closed)
            (tmp_path / "token").write_text("s3cret")
            fleet.write(f"  husky: {{url: {new_url}, token_file: token}}\n")
            assert await fleet.reload() == f"INFO reloaded: husky: connecting again, to {new_url}"
            await until(lambda: len(new.requests) == 2)
            assert new.requests[1].headers["Authorization"] == "Bearer s3cret"
        await old.close()
        await new.close()

    run()


@pytest.mark.newest_python
def test_a_robot_that_waits_for_its_next_attempt_follows_a_new_address_at_once(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        url = await server.start()
        fleet = Reloadable(tmp_path)
        fleet.write("  husky: {url: ws://127.0.0.1:1}\n")
        async with fleet.running():
            await until(lambda: bool(fleet.alerts))
            fleet.write(f"  husky: {{url: {url}}}\n")
            await fleet.reload()
            await until(lambda: fleet.alerts[1:] == ["husky: link OK: up"])
        await server.close()

    run()


@pytest.mark.parametrize(
    ("robots", "signals", "problem"),
    [
        ("  husky: {url: http://x}\n", BATTERY, "/fleet.yaml:3: robots.husky.url: expected ws://host:port"),
        ("  husky: {url: URL}\n", "battery_level: {warn_belw: 1.0}", "/t.yaml:1: alert_system.ros__parameters."),
        ("  husky: {url: URL, token_file: none}\n", BATTERY, "/none: token cannot be read: No such file or directory"),
    ],
)
def test_an_invalid_file_is_one_error_line_and_changes_nothing(
    tmp_path: Path, robots: str, signals: str, problem: str
) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        url = await server.start()
        fleet = Reloadable(tmp_path)
        fleet.write(f"  husky: {{url: {url}}}\n")
        async with fleet.running():
            await until(lambda: bool(server.received))
            fleet.write(robots.replace("URL", url) + "  other: {url: ws://127.0.0.1:1}\n", signals)
            line = await fleet.reload()
            assert line.startswith(f"ERROR not reloaded, the old configuration stays in force: {problem}")
            assert [robot.name for robot in fleet.fleet.robots] == ["husky"]
            await server.publish("/battery_level", {"data": 15.0})
            await until(lambda: fleet.alerts == ["husky: battery_level WARN: 15 is below 20"])
        await server.close()

    run()


def test_a_new_namespace_starts_the_robot_anew(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        url = await server.start()
        fleet = Reloadable(tmp_path)
        fleet.write(f"  husky: {{url: {url}}}\n")
        async with fleet.running():
            await until(lambda: bool(server.received))
            await server.publish("/battery_level", {"data": 15.0})
            await until(lambda: len(fleet.alerts) == 1)
            fleet.write(f"  husky: {{url: {url}, namespace: carter}}\n")
            assert await fleet.reload() == "INFO reloaded: husky: started anew"
            assert fleet.alerts[1:] == ["husky: battery_level OK: no longer watched"]
            await until(lambda: len(server.requests) == 2)
            await until(lambda: any(fields.get("topic") == "/carter/battery_level" for fields in server.received))
            assert [node.name for node in fleet.fleet.bus.nodes] == ["/connect", "/husky/alert_system"]
        await server.close()

    run()


def test_what_the_robots_announce_is_on_the_bus_of_the_fleet(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        servers = [ForeignServer(), ForeignServer()]
        fleet = Reloadable(tmp_path)
        fleet.write(
            f"  husky-1: {{url: {await servers[0].start()}}}\n  husky.1: {{url: {await servers[1].start()}, "
            "namespace: carter}\n"
        )
        async with fleet.running():
            alerts: list[Any] = []
            statuses: list[Any] = []
            listener = fleet.fleet.bus.node("listener")
            listener.subscribe("/alerts", "", lambda message, now_s: alerts.append(message))
            listener.subscribe("/diagnostics", "", lambda message, now_s: statuses.extend(message["status"]))
            await until(lambda: all(server.received for server in servers))
            await servers[0].publish("/battery_level", {"data": 15.0})
            await servers[1].publish("/carter/battery_level", {"data": 15.0})
            await until(lambda: len(alerts) == 2)
            assert sorted((alert["hardware_id"], alert["name"], alert["level"]) for alert in alerts) == [
                ("husky-1", "alert_system: battery_level", 1),
                ("husky.1", "alert_system: battery_level", 1),
            ]
            await until(lambda: any(status["name"] == "connect: monitor" for status in statuses))
            for name in ("husky-1", "husky.1"):
                await until(
                    lambda name=name: any(
                        (status["name"], status["hardware_id"]) == ("alert_system: monitor", name)
                        for status in statuses
                    )
                )
            services = fleet.fleet.bus.graph().services
            assert sorted(services) == ["/husky_1/alert_system/reset", "/husky_1_/alert_system/reset"]
            assert fleet.fleet.bus.call_service("/husky_1_/alert_system/reset")["success"] is True
        for server in servers:
            await server.close()

    run()


def test_look_ups_that_hang_block_neither_other_robots_nor_the_end(tmp_path: Path) -> None:
    """As many as there are threads in the pool of an event loop, at least."""
    program = tmp_path / "watch.py"
    program.write_text(
        "import socket, sys, threading\n"
        "look_up = socket.getaddrinfo\n"
        "def hang(host, *arguments, **options):\n"
        "    if 'hangs' in str(host):\n"
        "        threading.Event().wait()\n"
        "    return look_up(host, *arguments, **options)\n"
        "socket.getaddrinfo = hang\n"
        "from robot_health_monitor.__main__ import main\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )

    @scenario
    async def run() -> None:
        server = ForeignServer()
        url = (await server.start()).replace("127.0.0.1", "localhost")
        robots = "".join(f"  r{number}: {{url: 'ws://hangs{number}:9090'}}\n" for number in range(40))
        (tmp_path / "fleet.yaml").write_text(f"robots:\n{robots}  good: {{url: '{url}'}}\n")
        root = str(Path(__file__).resolve().parents[2])
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            str(program),
            "connect",
            "--fleet",
            str(tmp_path / "fleet.yaml"),
            env={**os.environ, "PYTHONPATH": root},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        await until(lambda: bool(server.received))
        await server.publish("/battery_level", {"data": 15.0})
        assert process.stdout is not None
        lines = []
        while not lines or b"good: battery_level WARN" not in lines[-1]:
            lines.append(await process.stdout.readline())
            assert lines[-1]
        process.send_signal(signal.SIGTERM)
        output, _ = await asyncio.wait_for(process.communicate(), 30.0)
        assert process.returncode == 0, output
        await server.close()

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
            (robot,) = watched.fleet.robots
            status = robot.alert_system.monitor.status("link", watched.fleet.bus.now_s)
            assert status is not None and "not a rosbridge server (HTTP 404)" in status.message
            refusing.close()
            await refusing.wait_closed()

    run()


def test_a_server_that_accepts_and_closes_is_one_alert(tmp_path: Path) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()
        loop = asyncio.get_event_loop()
        ends_s: list[float] = []

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
        server: ForeignServer | None = ForeignServer()
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
            assert watched.fleet.robots[0].alert_system.read(lambda monitor, now_s: now_s) == 1_263.0
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
