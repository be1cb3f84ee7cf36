"""`robot-health init` over rosbridge: a robot served by this package's server, one without rosapi, and none."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import threading
from pathlib import Path
from typing import Any, Callable, Iterator, List, Tuple

import pytest
from harness import reserved
from harness.line_process import LineProcess

pytest.importorskip("aiohttp")

from aiohttp import web

from robot_health_monitor.core.config import load_config

Start = Callable[..., LineProcess]

FAST = """
alert_system:
  ros__parameters:
    rosbridge_port: PORT
    signals: {battery_level: {unit: "%"}}
battery_sensor:
  ros__parameters: {publish_rate: 20.0, temperature: {source: none}, cpu_usage: {source: none}}
"""


def out(process: LineProcess) -> List[str]:
    return [line.text for line in process.lines if line.stream == "out"]


def err(process: LineProcess) -> List[str]:
    return [line.text for line in process.lines if line.stream == "err"]


@pytest.fixture
def robot(robot_health: Start, tmp_path: Path) -> str:
    """The address of a robot that publishes battery_level at 20 Hz."""
    port = reserved.free_port()
    file = tmp_path / "robot.yaml"
    file.write_text(FAST.replace("PORT", str(port)))
    robot_health("run", "--thresholds", file, "--port", port).wait_for_text("battery_sensor")
    return f"127.0.0.1:{port}"


def test_a_robot_behind_rosbridge_gets_a_file_that_check_accepts(
    robot_health: Start, robot: str, tmp_path: Path
) -> None:
    process = robot_health("init", robot, "--seconds", "3")
    assert process.wait() == 0, process.text
    assert err(process) == []
    file = tmp_path / "thresholds.yaml"
    file.write_text("\n".join(out(process)))
    rate = load_config(file).signals["battery_level_rate"]
    assert (rate.field, rate.statistic, rate.bounds) == ("", "frequency_hz", rate.bounds)
    assert 10.0 < rate.bounds["warn_below"] < 20.0 < rate.bounds["warn_above"] < 30.0
    assert robot_health("check", file).wait() == 0
    watched = robot_health("init", robot, "--seconds", "3", "--against", file)
    assert watched.wait() == 0, watched.text
    assert not any("battery_level_rate" in line for line in out(watched))


def test_what_was_heard_for_too_short_a_time_is_said_with_what_to_do(robot_health: Start, tmp_path: Path) -> None:
    port = reserved.free_port()
    file = tmp_path / "robot.yaml"
    file.write_text(FAST.replace("PORT", str(port)).replace("20.0", "2.0"))
    robot_health("run", "--thresholds", file, "--port", port).wait_for_text("battery_sensor")
    process = robot_health("init", f"127.0.0.1:{port}", "--seconds", "3")
    assert process.wait() == 3, process.text
    (line,) = err(process)
    assert re.search(
        r"\(/battery_level: \d messages in [\d.]+ s; expected at least 20\); --seconds 60 listens longer$", line
    )


def test_progress_is_shown_on_a_terminal_and_an_interrupt_ends_the_listening(
    on_terminal: Any, robot: str, tmp_path: Path
) -> None:
    file = tmp_path / "thresholds.yaml"
    terminal = on_terminal("init", robot, "--seconds", "600", columns=100, stdout=file)
    terminal.wait_until(
        lambda text: re.search(r"listening: \d+ of 600 s, \d topics, \d{3} messages;", text) is not None
    )
    terminal.signal(signal.SIGINT)
    assert terminal.wait() == 0, terminal.text
    assert terminal.text == ""
    assert ", interrupted: " in file.read_text().splitlines()[0]
    assert "battery_level_rate" in load_config(file).signals


@pytest.fixture
def served() -> Iterator[Callable[[Callable[[Any], Any]], str]]:
    """Serves WebSocket clients with a function that answers each of their messages; returns the address."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    runners: List[web.AppRunner] = []

    async def serve(answer: Callable[[Any], Any]) -> Tuple[web.AppRunner, int]:
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
        (["a:1", "--seconds", "0.5"], "argument --seconds: expected at least 1"),
        (["http://robot"], "expected host:port"),
        (["a:1", "--against", "/nowhere.yaml"], "/nowhere.yaml"),
    ],
)
def test_wrong_usage_is_one_line(robot_health: Start, arguments: List[str], problem: str) -> None:
    process = robot_health("init", *arguments)
    assert process.wait() == 2, process.text
    (line,) = err(process)
    assert problem in line
