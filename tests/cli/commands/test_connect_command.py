"""`robot-health connect` watches real `robot-health run` processes over real sockets."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import subprocess
from functools import partial
from pathlib import Path
from typing import Any, Callable, Sequence
from urllib.request import urlopen

import psutil
import pytest
from harness.line_process import LineProcess
from harness.waiting import wait_for, wait_for_ticks

pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.ops.store import queries
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.runtime.event_loops import LoopThread

Start = Callable[..., LineProcess]

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery_level: {unit: "%", warn_below: 20.0, stale_after_s: 1.0}
      temperature: {unit: degC, stale_after_s: 1.0}
"""


def start_robot(robot_health: Start, calm: Path, port: int = 0, *arguments: str) -> LineProcess:
    return robot_health("run", "--thresholds", calm, "--port", port, *arguments)


def port_of(robot: LineProcess) -> int:
    return port_in(robot.wait_for_text("serving on"))


def port_in(text: str) -> int:
    match = re.search(r"serving on ws://127\.0\.0\.1:(\d+)", text)
    assert match is not None
    return int(match[1])


@pytest.fixture
def thresholds(tmp_path: Path) -> Path:
    file = tmp_path / "watch.yaml"
    file.write_text(THRESHOLDS)
    return file


def is_connected(robot: LineProcess) -> bool:
    """Returns whether a robot holds a connection of a client."""
    return any(each.status == psutil.CONN_ESTABLISHED for each in psutil.Process(robot.pid).net_connections("tcp"))


def alerts(process: LineProcess) -> list[str]:
    """Returns the transitions among the lines until now, without their times."""
    lines = [
        line.text[20:] for line in process.lines if line.stream == "out" and not re.search(r"\[[A-Z]+\]", line.text)
    ]
    return [re.sub(r" \(was .*", "", line) for line in lines]


def test_a_robot_that_is_killed_and_comes_back_is_one_alert_and_its_end(
    robot_health: Start, calm: Path, thresholds: Path
) -> None:
    robot = start_robot(robot_health, calm)
    port = port_of(robot)
    watcher = robot_health("connect", f"atlas=ws://127.0.0.1:{port}", "--thresholds", thresholds)
    watcher.wait_for_text("atlas: connected to")
    os.kill(robot.pid, signal.SIGKILL)
    watcher.wait_for_text("link ERROR")
    again = start_robot(robot_health, calm, port)
    again.wait_for_text("serving on")
    watcher.wait_for_text("link OK")
    watcher.signal()
    assert watcher.wait() == 0
    assert not watcher.errors
    assert alerts(watcher)[0].startswith("link ERROR: down: ") and alerts(watcher)[1:] == ["link OK: up"]


@pytest.mark.newest_python
def test_a_pause_of_this_process_is_one_warning_and_no_alert(robot_health: Start, calm: Path, tmp_path: Path) -> None:
    """Long enough for the servers to close its connections: stale_after_s is less than a third of it."""
    watch = tmp_path / "watch.yaml"
    watch.write_text(THRESHOLDS.replace("stale_after_s: 1.0", "stale_after_s: 5.0"))
    robots = [start_robot(robot_health, calm) for _ in range(2)]
    addresses = [f"{name}=ws://127.0.0.1:{port_of(robot)}" for name, robot in zip(("atlas", "husky"), robots)]
    watcher = robot_health("connect", *addresses, "--thresholds", watch, "--port", 0)
    watcher.wait_for_texts("serving on", "atlas: connected to", "husky: connected to")
    port = port_in(watcher.text)
    wait_for_ticks(port, 1.0)
    assert all(map(is_connected, robots))
    watcher.signal(signal.SIGSTOP)
    wait_for(lambda: not any(map(is_connected, robots)), 60.0)
    watcher.signal(signal.SIGCONT)
    watcher.wait_for_text("[WARN] connect: the monitor was stopped for ")
    wait_for_ticks(port, 5.0)
    watcher.signal()
    assert watcher.wait() == 0
    assert alerts(watcher) == []
    assert watcher.text.count("the monitor was stopped") == 1


@pytest.mark.newest_python
def test_an_idle_robot_is_up_all_the_time(robot_health: Start, tmp_path: Path) -> None:
    """Long enough for several pings."""
    robot = robot_health("run", "--source", "none", "--port", 0)
    patient = tmp_path / "patient.yaml"
    patient.write_text("alert_system: {ros__parameters: {signals: {battery_level: {startup_grace_s: 1000.0}}}}\n")
    watcher = robot_health("connect", f"127.0.0.1:{port_of(robot)}", "--thresholds", patient, "--duration", 25)
    assert watcher.wait(60.0) == 0
    assert alerts(watcher) == []


def test_a_robot_whose_server_is_stopped_is_down_and_up_again_after_it(
    robot_health: Start, calm: Path, thresholds: Path
) -> None:
    robot = start_robot(robot_health, calm)
    watcher = robot_health("connect", f"atlas=ws://127.0.0.1:{port_of(robot)}", "--thresholds", thresholds)
    watcher.wait_for_text("atlas: connected to")
    robot.signal(signal.SIGSTOP)
    try:
        watcher.wait_for_text("link ERROR: down: no answer from the host")
    finally:
        robot.signal(signal.SIGCONT)
    watcher.wait_for_text("link OK: up")
    watcher.signal()
    assert watcher.wait() == 0
    assert len([alert for alert in alerts(watcher) if alert.startswith("link")]) == 2


@pytest.mark.newest_python
def test_faults_of_the_process_are_shown_everywhere(robot_health: Start, thresholds: Path, tmp_path: Path) -> None:
    ops = tmp_path / "ops.yaml"
    ops.write_text(
        "history: {file: /proc/nowhere/history.db}\nnotify: {pager: {type: webhook, url: 'http://127.0.0.1:1'}}\n"
    )
    robots = [f"{name}=ws://127.0.0.1:1" for name in ("husky", "carter")]
    watcher = robot_health("connect", *robots, "--thresholds", thresholds, "--ops", ops, "--port", 0)
    port = port_of(watcher)
    watcher.wait_for_texts("connect: history: /proc/nowhere", "connect: notify pager: ")

    def get(path: str) -> str:
        with urlopen(f"http://127.0.0.1:{port}/{path}", timeout=30.0) as response:
            assert response.status == 200
            return str(response.read().decode())

    state = json.loads(get("api/state?window=0"))
    assert [fault["part"] for fault in state["monitor"]["faults"]] == ["history", "notify pager"]
    history = state["monitor"]["message"]
    assert history.startswith("history: /proc/nowhere")
    assert [robot["monitor"] for robot in state["robots"].values()] == [{"level": "ERROR", "message": history}] * 2
    health = json.loads(get("healthz"))
    assert health["ok"] is True and health["faults"][0] == history and len(health["faults"]) == 2
    assert "\nrobot_health_faults 2.0\n" in get("metrics")


@pytest.mark.newest_python
def test_each_of_several_robots_has_its_own_link_and_name(robot_health: Start, calm: Path, thresholds: Path) -> None:
    robots = [start_robot(robot_health, calm) for _ in range(2)]
    ports = [port_of(robot) for robot in robots]
    urls = [f"{name}=ws://127.0.0.1:{port}" for name, port in zip(("husky", "carter"), ports)]
    watcher = robot_health("connect", *urls, "--thresholds", thresholds, "--json")
    watcher.wait_for_texts("husky: connected to", "carter: connected to")
    robots[1].signal()
    first = json.loads(watcher.wait_for_line(lambda line: line.startswith("{")))
    assert (first["robot"], first["signal"], first["to_level"]) == ("carter", "link", "ERROR")
    robots[0].signal()
    second = json.loads(watcher.wait_for_line(lambda line: line.startswith("{")))
    assert (second["robot"], second["signal"], second["to_level"]) == ("husky", "link", "ERROR")
    assert first["fingerprint"] != second["fingerprint"]


@pytest.mark.newest_python
def test_alerts_of_the_robots_signals_are_judged_here(robot_health: Start, restless: Path, tmp_path: Path) -> None:
    port = port_of(robot_health("run", "--thresholds", restless, "--port", 0))
    mine = tmp_path / "mine.yaml"
    mine.write_text(
        "alert_system:\n  ros__parameters:\n    signals:\n      battery_level: {unit: '%', error_below: 50.0}\n"
    )
    watcher = robot_health("connect", f"atlas=ws://127.0.0.1:{port}", "--thresholds", mine)
    assert "is below 50 %" in watcher.wait_for_text("battery_level ERROR: ")
    watcher.wait_for_text("battery_level OK: ")


@pytest.mark.newest_python
def test_a_robot_that_is_not_there_is_one_alert_with_its_cause(robot_health: Start, thresholds: Path) -> None:
    watcher = robot_health("connect", "atlas=ws://127.0.0.1:1", "--thresholds", thresholds, "--duration", 3)
    assert watcher.wait() == 1
    assert alerts(watcher) == ["link ERROR: down: connection refused: no server listens on this port"]
    assert "no server listens on this port (was never up)" in watcher.text
    assert not watcher.errors
    assert not [line.text for line in watcher.lines if "[WARN]" in line.text or "[ERROR]" in line.text]


@pytest.mark.parametrize(("token", "cause"), [("guessed", "wrong token"), ("", "no token")])
def test_a_wrong_or_missing_token_is_reported_at_once_as_a_mistake_on_this_side(
    robot_health: Start, calm: Path, thresholds: Path, token: str, cause: str
) -> None:
    robot = robot_health("run", "--thresholds", calm, "--port", 0, ROBOT_HEALTH_TOKEN="s3cret")
    address = f"atlas=ws://127.0.0.1:{port_of(robot)}"
    watcher = robot_health("connect", address, "--thresholds", thresholds, "--duration", 2, ROBOT_HEALTH_TOKEN=token)
    assert watcher.wait() == 2
    assert alerts(watcher) == [f"link ERROR: down: check this computer's settings: {cause}"]
    assert watcher.errors == [f"robot-health connect: atlas: check this computer's settings: {cause}"]


@pytest.mark.newest_python
def test_the_right_token_from_a_file_connects_and_is_never_shown(
    robot_health: Start, calm: Path, thresholds: Path, tmp_path: Path
) -> None:
    file = tmp_path / "token"
    file.write_text("s3cret\n")
    file.chmod(0o600)
    robot = robot_health("run", "--thresholds", calm, "--port", 0, "--token-file", file)
    address = f"atlas=ws://127.0.0.1:{port_of(robot)}/?token=s3cret"
    watcher = robot_health("connect", address, "--thresholds", thresholds, "--duration", 3, "--robot-token-file", file)
    assert watcher.wait() == 0
    assert alerts(watcher) == []
    assert "atlas: connected to ws://127.0.0.1:" in watcher.text
    for process in (robot, watcher):
        assert not [line.text for line in process.lines if "s3cret" in line.text]
        assert not [text for text in process.errors if "s3cret" in text]


@pytest.mark.parametrize(
    ("urls", "problem"),
    [
        (
            ["robot"],
            "expected host:port, ws://host:port, wss://host:port, foxglove://host:port or NAME=ADDRESS, got 'robot'",
        ),
        (
            ["http://robot:9090"],
            "expected host:port, ws://host:port, wss://host:port, foxglove://host:port or NAME=ADDRESS, got 'http://robot:9090'",
        ),
        (
            ["ws://"],
            "expected host:port, ws://host:port, wss://host:port, foxglove://host:port or NAME=ADDRESS, got 'ws://'",
        ),
        (
            ["ws://u:p@robot:99999"],
            "expected host:port, ws://host:port, wss://host:port, foxglove://host:port or NAME=ADDRESS, got 'ws://robot:99999'",
        ),
        (
            ["a=ws://one:9090", "a=ws://two:9090"],
            "two robots are named a; give them names: one=host:port two=host:port",
        ),
    ],
)
def test_a_wrong_address_is_one_line_and_code_2(robot_health_here: Start, urls: list[str], problem: str) -> None:
    process = robot_health_here("connect", *urls)
    assert process.wait() == 2
    assert len(process.errors) == 1 and process.errors[0] == f"robot-health connect: {problem}"


def test_a_wrong_configuration_is_named_with_file_and_line(robot_health_here: Start, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text(THRESHOLDS.replace("warn_below", "warn_belw"))
    process = robot_health_here("connect", "ws://127.0.0.1:1", "--thresholds", file)
    assert process.wait() == 2
    assert process.errors[0].startswith(f"{file}:5: ") and "warn_belw" in process.errors[0]


@pytest.mark.newest_python
def test_a_port_that_was_asked_for_and_is_taken_ends_the_run(robot_health: Start, calm: Path) -> None:
    port = port_of(start_robot(robot_health, calm))
    second = start_robot(robot_health, calm, port)
    assert second.wait() == 2
    assert f"port {port} of 127.0.0.1 cannot be opened" in second.errors[0]


@pytest.mark.newest_python
def test_an_address_that_others_can_reach_needs_a_token(robot_health: Start, calm: Path) -> None:
    process = robot_health("run", "--thresholds", calm, "--port", 0, "--host", "0.0.0.0")
    assert process.wait() == 2
    assert "expected a token" in process.errors[0]
    served = robot_health("run", "--thresholds", calm, "--port", 0, "--host", "0.0.0.0", ROBOT_HEALTH_TOKEN="s3cret")
    served.wait_for_text("serving on ws://0.0.0.0:")


def test_a_fleet_file_is_read_again_on_sighup(robot_health: Start, calm: Path, tmp_path: Path) -> None:
    port = port_of(start_robot(robot_health, calm))
    (tmp_path / "t.yaml").write_text(THRESHOLDS)
    file = tmp_path / "fleet.yaml"
    text = f"defaults: {{thresholds: t.yaml}}\nrobots:\n  atlas: {{url: 'ws://127.0.0.1:{port}'}}\n"
    file.write_text(text + "  gone: {url: 'ws://127.0.0.1:1'}\n")
    watcher = robot_health("connect", "--fleet", file)
    watcher.wait_for_texts("atlas: connected to", "gone: link ERROR: down: connection refused")
    file.write_text(text)
    os.kill(watcher.pid, signal.SIGHUP)
    watcher.wait_for_text("gone: link OK: no longer watched")
    watcher.wait_for_text("[INFO] connect: reloaded: gone: removed")
    file.write_text("robots: {}\n")
    os.kill(watcher.pid, signal.SIGHUP)
    watcher.wait_for_text(f"[ERROR] connect: not reloaded, the old configuration stays in force: {file}:1: robots: ")
    watcher.signal()
    assert watcher.wait() == 0
    assert watcher.text.count("connected to") == 1


def test_neither_a_url_nor_a_fleet_is_wrong_usage(robot_health_here: Start) -> None:
    process = robot_health_here("connect")
    assert process.wait() == 2
    assert process.errors == [
        "robot-health connect: expected the URL of a robot, or --fleet FILE; see robot-health connect --help"
    ]


def test_a_mistake_in_a_fleet_file_is_one_line_and_code_2(robot_health_here: Start, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text("robots:\n  a b: {url: 'ws://x'}\n")
    process = robot_health_here("connect", "--fleet", file)
    assert process.wait() == 2
    assert process.errors[0].startswith(f"{file}:2: robots.a b: expected a name")


@pytest.mark.newest_python
def test_a_port_of_the_fleet_that_is_taken_is_wrong_usage(robot_health: Start, calm: Path) -> None:
    port = port_of(start_robot(robot_health, calm))
    watcher = robot_health("connect", "ws://127.0.0.1:1", "--port", port)
    assert watcher.wait() == 2
    assert f"port {port} of 127.0.0.1 cannot be opened" in watcher.errors[0]


def test_the_statuses_of_all_robots_are_served_on_one_port(robot_health: Start, tmp_path: Path) -> None:
    from harness.rosbridge_client import Watched, scenario, until

    thresholds = tmp_path / "low.yaml"
    thresholds.write_text(THRESHOLDS.replace("warn_below: 20.0", "warn_below: 99.9"))
    source = tmp_path / "robot.yaml"
    source.write_text("alert_system: {ros__parameters: {signals: {unused: {stale_after_s: 0.0}}}}\n")
    ports = [port_of(robot_health("run", "--thresholds", source, "--port", 0)) for _ in range(2)]
    urls = [f"{name}=ws://127.0.0.1:{port}" for name, port in zip(("husky-1", "carter"), ports)]
    watcher = robot_health("connect", *urls, "--thresholds", thresholds, "--port", 0)
    url = f"ws://127.0.0.1:{port_of(watcher)}"

    @scenario
    async def run() -> None:
        watched = Watched(url)
        statuses: dict[tuple[str, str], str] = {}

        def note(message: Any, now_s: float) -> None:
            for status in message["status"]:
                statuses[status["hardware_id"], status["name"]] = status["message"]

        watched.node.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray", note)
        for name in ("husky-1", "carter"):
            await until(lambda name=name: (name, "alert_system: battery_level") in statuses)
            await until(lambda name=name: (name, "alert_system: monitor") in statuses)
        await until(lambda: any(name == "connect: monitor" for _, name in statuses))
        reset = await watched.call("/husky_1/alert_system/reset")
        assert reset == {"success": True, "message": "reset: nothing was latched"}
        await watched.close()

    run()


def test_robots_that_misbehave_do_not_affect_another_one(robot_health: Start, tmp_path: Path) -> None:
    """They flood, send huge messages, lie about types, never answer, and close every connection."""
    from harness.rosbridge_client import ForeignServer, scenario, until

    thresholds = tmp_path / "watch.yaml"
    thresholds.write_text(
        "alert_system: {ros__parameters: {signals: {battery_level: {type: std_msgs/Float32, warn_below: 20.0, "
        "stale_after_s: 0.0}}}}\n"  # on a busy machine, the robots take long to connect
    )
    small = json.dumps({"op": "publish", "topic": "/battery_level", "msg": {"data": 50.0}})
    huge = json.dumps({"op": "publish", "topic": "/battery_level", "msg": {"data": 50.0, "padding": "A" * 3_000_000}})
    lie = json.dumps({"op": "publish", "topic": "/battery_level", "msg": {"data": {"data": ["x"] * 1000}}})

    @scenario
    async def run() -> None:
        sent = {"flood": 0, "huge": 0, "lie": 0}

        def sending(name: str, text: str) -> Any:
            async def send(socket: Any) -> None:
                async def repeat() -> None:
                    while not socket.closed:
                        await socket.send_str(text)
                        sent[name] += 1
                        await asyncio.sleep(0)

                tasks.append(asyncio.ensure_future(repeat()))

            return send

        async def close(socket: Any) -> None:
            await socket.close()

        tasks: list[Any] = []
        servers = {name: ForeignServer() for name in ("flood", "huge", "lie", "closes", "good")}
        servers["flood"].on_connect = sending("flood", small)
        servers["huge"].on_connect = sending("huge", huge)
        servers["lie"].on_connect = sending("lie", lie)
        servers["closes"].on_connect = close
        mute = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0)
        urls = [f"{name}={await server.start()}" for name, server in servers.items()]
        urls.append(f"mute=ws://127.0.0.1:{mute.sockets[0].getsockname()[1]}")
        watcher = robot_health("connect", *urls, "--thresholds", thresholds, "--json")
        good = servers["good"]
        await until(lambda: any(fields.get("topic") == "/battery_level" for fields in good.received))
        await until(lambda: all(count > 1 for count in sent.values()))

        loop = asyncio.get_event_loop()
        for value, level in ((15.0, "WARN"), (50.0, "OK")):
            await good.publish("/battery_level", {"data": value})
            wanted = partial(_contains, ('"robot": "good"', f'"to_level": "{level}"'))
            await loop.run_in_executor(None, watcher.wait_for_line, wanted)
        assert len(good.requests) == 1
        watcher.signal()
        assert await loop.run_in_executor(None, watcher.wait) == 0
        events = [json.loads(line.text) for line in watcher.lines if line.stream == "out"]
        assert [(event["signal"], event["to_level"]) for event in events if event["robot"] == "good"] == [
            ("battery_level", "WARN"),
            ("battery_level", "OK"),
        ]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        mute.close()
        for server in servers.values():
            await server.close()

    run()


def _contains(words: Sequence[str], line: str) -> bool:
    return all(word in line for word in words)


def test_with_an_ops_yaml_the_robots_share_one_history(robot_health: Start, tmp_path: Path, free_port: int) -> None:
    (tmp_path / "ops.yaml").write_text("history: {file: history.db}\nserver: {port: 0}\n")
    addresses = [f"{name}=ws://127.0.0.1:{free_port}" for name in ("a", "b")]
    process = robot_health("connect", *addresses, "--ops", tmp_path / "ops.yaml")
    process.wait_for_text("connect: operations: history, server")
    process.wait_for_text("serving on ws://127.0.0.1:")
    for _ in addresses:
        process.wait_for_text(": link ERROR: ")
    process.signal()
    assert process.wait() == 0
    with reading(tmp_path / "history.db") as connection:
        found = [(each.robot, each.signal, each.to_level.name) for each in queries.transitions(connection)]
    assert sorted(found) == [("a", "link", "ERROR"), ("b", "link", "ERROR")]


def test_sighup_reads_the_ops_yaml_again(robot_health: Start, thresholds: Path, tmp_path: Path) -> None:
    ops = tmp_path / "ops.yaml"
    ops.write_text(f"history: {{file: {tmp_path}/history.db}}\n")
    watcher = robot_health("connect", "atlas=127.0.0.1:1", "--thresholds", thresholds, "--ops", ops)
    watcher.wait_for_text("link ERROR")
    ops.write_text(f"{ops.read_text()}notify: {{pager: {{type: webhook, url: 'http://127.0.0.1:1'}}}}\n")
    os.kill(watcher.pid, signal.SIGHUP)
    watcher.wait_for_text("[INFO] connect: reloaded: notify: other targets")
    ops.write_text("notify: {pager: {type: webhok}}\n")
    os.kill(watcher.pid, signal.SIGHUP)
    assert f"{ops}:1: notify.pager" in watcher.wait_for_text("[ERROR] connect: not reloaded")
    watcher.signal()
    assert watcher.wait() == 0


class ServedRobot:
    """A robot with this project's rosbridge server, that publishes a value ten times a second."""

    def __init__(self) -> None:
        self.value = 50.0
        self._loop = LoopThread("robot")
        self._bus = LocalBus(1000.0)
        self._server = Server(self._bus.node("rosbridge"), port=0, threads=False)
        self._loop.call(self._server.start())
        self.answered: list[str] = []
        """The services that were called."""
        self._call, self._server.services.call = self._server.services.call, self._note_call  # type: ignore[method-assign]
        self.url = f"ws://127.0.0.1:{self._server.port}"
        self._sensor = self._bus.node("sensor")
        self._sensor.advertise("/battery_level", "std_msgs/Float32")
        self._publishing = asyncio.run_coroutine_threadsafe(self._publish(), self._loop.loop)

    async def _note_call(self, service: str, *arguments: Any) -> Any:
        answer = await self._call(service, *arguments)
        self.answered.append(service)
        return answer

    async def _publish(self) -> None:
        while True:
            self._sensor.publish("/battery_level", {"data": self.value})
            await asyncio.sleep(0.1)

    def close(self) -> None:
        self._publishing.cancel()
        self._loop.call(self._server.close())
        self._loop.close()


def test_the_black_box_of_each_robot_replays_to_its_alert_lines(
    robot_health: Start, tmp_path: Path, command: list[str]
) -> None:
    pytest.importorskip("mcap")
    thresholds = tmp_path / "watch.yaml"
    thresholds.write_text(
        "alert_system: {ros__parameters: {signals: {battery_level: {type: std_msgs/Float32, unit: '%', "
        "warn_below: 20.0, error_below: 10.0, for_s: 0.5, stale_after_s: 60.0}}}}\n"
    )
    box = tmp_path / "box"
    (tmp_path / "ops.yaml").write_text(f"black_box: {{folder: {box}, before_s: 5, after_s: 60}}\nserver: {{port: 0}}\n")
    robots = {"atlas": ServedRobot(), "husky": ServedRobot()}
    urls = [f"{name}={robot.url}" for name, robot in robots.items()]
    watcher = robot_health("connect", *urls, "--thresholds", thresholds, "--ops", tmp_path / "ops.yaml", "--json")
    live: list[dict[str, Any]] = []

    def wait_for_alert(name: str, level: str) -> None:
        wanted = partial(_contains, (f'"robot": "{name}"', f'"to_level": "{level}"'))
        live.append(json.loads(watcher.wait_for_line(wanted)))

    watcher.wait_for_texts("atlas: connected to", "husky: connected to")
    # A message is recorded from when its definition is known.
    wait_for(lambda: all("/rosapi/message_details" in robot.answered for robot in robots.values()))
    robots["atlas"].value = 15.0
    wait_for_alert("atlas", "WARN")
    robots["husky"].value = 5.0
    wait_for_alert("husky", "ERROR")
    robots["atlas"].value = 5.0
    wait_for_alert("atlas", "ERROR")
    watcher.signal()  # the end completes the files
    assert watcher.wait() == 0
    for robot in robots.values():
        robot.close()
    for name in robots:
        announced = [alert for alert in live if alert["robot"] == name]
        (file,) = box.glob(f"{name}_*.mcap")
        assert {alert["black_box"] for alert in announced} == {file.name}
        done = subprocess.run([*command, "replay", str(file), "--json"], capture_output=True, text=True, check=False)
        replayed = [json.loads(line) for line in done.stdout.splitlines()]
        lines = [[re.sub(r" \(was .*", "", alert["text"]) for alert in alerts] for alerts in (announced, replayed)]
        assert lines[0] == lines[1], done.stderr
        assert {alert["robot"] for alert in replayed} == {name}
