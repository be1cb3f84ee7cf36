"""`robot-health init` over rosbridge: a robot served by this package's server, one without rosapi, and none."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import threading
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from harness import reserved
from harness.line_process import LineProcess

pytest.importorskip("aiohttp")

from aiohttp import ClientSession, web

from robot_health_monitor.core.config.monitor_config import load_config
from robot_health_monitor.runtime.event_loops import LoopThread

Start = Callable[..., LineProcess]

OWN = ["_simulated_sensors", "alerts", "battery_level", "cpu_usage", "rosout", "system_health", "temperature"]
"""Topics of the nodes that `robot-health run` starts."""


def out(process: LineProcess) -> list[str]:
    return [line.text for line in process.lines if line.stream == "out"]


def err(process: LineProcess) -> list[str]:
    return [line.text for line in process.lines if line.stream == "err"]


@pytest.fixture
def start_robot(robot_health: Start) -> Iterator[Callable[[float], str]]:
    """Starts a monitor with simulated sensors, and a driver that publishes /charge at a rate; returns the address."""
    drivers = LoopThread("drivers")

    async def drive(port: int, rate_hz: float) -> None:
        async with ClientSession() as session, session.ws_connect(f"ws://127.0.0.1:{port}") as socket:
            await socket.send_json({"op": "advertise", "topic": "/charge", "type": "std_msgs/Float32"})
            while True:
                await socket.send_json({"op": "publish", "topic": "/charge", "msg": {"data": 80.0}})
                await asyncio.sleep(1.0 / rate_hz)

    def start(rate_hz: float) -> str:
        port = reserved.free_port()
        robot_health("run", "--port", port, "--allow-publish", "/charge").wait_for_text("battery_sensor")
        asyncio.run_coroutine_threadsafe(drive(port, rate_hz), drivers.loop)
        return f"127.0.0.1:{port}"

    yield start
    drivers.close()


@pytest.fixture
def robot(start_robot: Callable[[float], str]) -> str:
    """The address of a robot whose driver publishes at 20 Hz."""
    return start_robot(20.0)


def test_a_robot_behind_rosbridge_gets_a_file_that_check_accepts(
    robot_health: Start, robot: str, tmp_path: Path
) -> None:
    process = robot_health("init", robot, "--seconds", "5")
    assert process.wait() == 0, process.text
    assert err(process) == []
    assert [line for line in out(process) if "published by this monitor" in line] == [
        f"    #   /{topic}: published by this monitor" for topic in OWN
    ]
    file = tmp_path / "thresholds.yaml"
    file.write_text("\n".join(out(process)))
    signals = load_config(file).signals
    assert list(signals) == ["charge_rate"]
    assert "    #   node /rosbridge: a tool, or an anonymous node: these come and go" in out(process)
    rate = signals["charge_rate"]
    assert (rate.field, rate.statistic, rate.bounds) == ("", "frequency_hz", rate.bounds)
    assert 10.0 < rate.bounds["warn_below"] < 20.0 < rate.bounds["warn_above"] < 30.0
    assert robot_health("check", file).wait() == 0
    watched = robot_health("init", robot, "--seconds", "3", "--against", file)
    assert watched.wait() == 0, watched.text
    assert f"# Only what {file} does not watch." in out(watched)
    assert "    signals: {}" in out(watched)
    assert not any("charge_rate" in line for line in out(watched))


@pytest.mark.newest_python
def test_what_was_heard_for_too_short_a_time_is_said_with_what_to_do(
    robot_health: Start, start_robot: Callable[[float], str]
) -> None:
    process = robot_health("init", start_robot(2.0), "--seconds", "3")
    assert process.wait() == 3, process.text
    (line,) = err(process)
    reason = r"/charge: only \d messages in [\d.]+ s: a rate needs 20"
    assert re.search(rf"{reason}.*; --seconds 660 listens longer$", line)


@pytest.mark.newest_python
def test_beside_nothing_but_the_monitor_itself_there_is_nothing_to_watch(robot_health: Start) -> None:
    port = reserved.free_port()
    robot_health("run", "--port", port).wait_for_text("battery_sensor")
    process = robot_health("init", f"127.0.0.1:{port}", "--seconds", "3")
    assert process.wait() == 3, process.text
    (line,) = err(process)
    assert " in 3 s (/_simulated_sensors: published by this monitor" in line


@pytest.mark.newest_python
def test_progress_is_shown_on_a_terminal_and_an_interrupt_ends_the_listening(
    on_terminal: Any, robot: str, tmp_path: Path
) -> None:
    file = tmp_path / "thresholds.yaml"
    terminal = on_terminal("init", robot, "--seconds", "600", columns=100, stdout=file)
    terminal.wait_until(
        lambda text: re.search(r"listening: \d+ of 600 s, \d+ topics, \d{3} messages;", text) is not None
    )
    terminal.signal(signal.SIGINT)
    assert terminal.wait() == 0, terminal.text
    assert terminal.text == ""
    assert ", interrupted: " in file.read_text().splitlines()[0]
    assert "charge_rate" in load_config(file).signals


@pytest.fixture
def served() -> Iterator[Callable[[Callable[[Any], Any]], str]]:
    """Serves WebSocket clients with a function that answers each of their messages; returns the address."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    runners: list[web.AppRunner] = []

    async def serve(answer: Callable[[Any], Any]) -> tuple[web.AppRunner, int]:
        async def handle(request: web.Request) -> web.WebSocketResponse:
            socket = web.WebSocketResponse()
            await socket.prepare(request)
            async for message in socket:
                reply = answer(json.loads(message.data))
                if reply is not None:
                    await socket.send_str(json.dumps(reply))
            return socket

        app = web.Application()
        app.router.add_get("/", handle)
        runner = web.AppRunner(app)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", 0)
        await site.start()
        return runner, runner.addresses[0][1]

    def start(answer: Callable[[Any], Any]) -> str:
        runner, port = asyncio.run_coroutine_threadsafe(serve(answer), loop).result(10)
        runners.append(runner)
        return f"127.0.0.1:{port}"

    yield start
    for runner in runners:
        asyncio.run_coroutine_threadsafe(runner.cleanup(), loop).result(10)
    loop.call_soon_threadsafe(loop.stop)
    thread.join(10)


def test_a_server_without_rosapi_is_one_line(robot_health: Start, served: Any) -> None:
    def answer(message: Any) -> Any:
        if message.get("op") == "call_service":
            response = {"op": "service_response", "service": message["service"], "id": message.get("id")}
            return {**response, "result": False, "values": "Service does not exist"}
        return None

    process = robot_health("init", served(answer), "--seconds", "3")
    assert process.wait() == 3, process.text
    (line,) = err(process)
    assert "does not list its topics (no rosapi?): " in line
    assert out(process) == []


def test_a_robot_with_nothing_is_one_line(robot_health: Start, served: Any) -> None:
    def answer(message: Any) -> Any:
        if message.get("op") == "call_service":
            values = {"topics": [], "types": [], "typedefs_full_text": []}
            response = {"op": "service_response", "service": message["service"], "id": message.get("id")}
            return {**response, "result": True, "values": values}
        return None

    process = robot_health("init", served(answer), "--seconds", "1")
    assert process.wait() == 3, process.text
    assert err(process) == ["robot-health: nothing to watch on 127.0.0.1: 0 topics, 0 messages in 1 s"]
    assert out(process) == []


def test_a_robot_that_does_not_answer_is_one_line(robot_health: Start) -> None:
    process = robot_health("init", f"127.0.0.1:{reserved.free_port()}", "--seconds", "1")
    assert process.wait() == 3, process.text
    (line,) = err(process)
    assert line.startswith("robot-health: no connection to ws://127.0.0.1:")
    assert "refused" in line


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["a:1", "--ros1"], "expected one of URL, --ros1 and --ros2"),
        (["http://robot"], "expected host:port"),
        (["a:1", "--against", "/nowhere.yaml"], "/nowhere.yaml"),
    ],
)
def test_wrong_usage_is_one_line(robot_health_here: Start, arguments: list[str], problem: str) -> None:
    process = robot_health_here("init", *arguments)
    assert process.wait() == 2, process.text
    (line,) = err(process)
    assert problem in line
