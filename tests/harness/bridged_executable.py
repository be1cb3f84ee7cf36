"""A node's executable that serves rosbridge clients, seen by this project's own client over a real socket."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import platform
import re
import signal
import time
from pathlib import Path
from typing import Any, Mapping

from harness.port_conformance import Recorder
from harness.raw_conformance import Capture
from harness.rosbridge_peer import Peer
from harness.waiting import WAIT_S
from robot_health_monitor.rosbridge.client import RosbridgeClient

_SETTINGS = (
    "alert_system:\n  ros__parameters:\n    rosbridge_port: {port}\n    rosbridge_token_file: {token_file}\n"
    "    signals:\n      battery_level: {{warn_below: 20.0}}\n      odometry: {{warn_below: 1.0}}\n"
)
GRAPH = [("node", "*"), ("node", "/no_such_node"), ("publishers", "/battery_level")]
GRAPH += [("subscribers", topic) for topic in ("/battery_level", "/heard_by_none")]
"""What is counted of the robot over rosbridge."""


def settings(folder: Path, port: int, token: str) -> str:
    """Returns a thresholds.yaml with a rosbridge server; writes the token to a file in `folder`."""
    file = folder / "token"
    file.write_text(f"{token}\n", encoding="utf-8")
    file.chmod(0o600)
    return _SETTINGS.format(port=port, token_file=file)


async def look_at(port: int, token: str) -> list[Any]:
    """Returns what a client sees: a battery level, the answer of `reset`, that of a service that it may not call, the
    names of the parameters, and the answers to HTTP requests."""
    import aiohttp

    headers = {"Authorization": f"Bearer {token}"}
    url = f"http://127.0.0.1:{port}/"
    async with aiohttp.ClientSession(headers=headers) as session, session.ws_connect(url) as socket:
        peer = Peer(socket)
        reset = await peer.call("/alert_system/reset")
        refused = await peer.call("/alert_system/set_logger_level")
        await peer.subscribe("/battery_level", type="std_msgs/Float32")
        level = await peer.receive()
        parameters = (await peer.call("/rosapi/get_param_names"))["values"]["names"]
        answers = {}
        for path in ("", "api/state", "healthz", "metrics"):
            async with session.get(url + path) as response:
                answers[path] = response.status, await response.text()
        give_up_s = time.monotonic() + WAIT_S
        while answers["healthz"][0] != 200 and time.monotonic() < give_up_s:  # a busy machine: a tick was late
            await asyncio.sleep(0.1)
            async with session.get(f"{url}healthz") as response:
                answers["healthz"] = response.status, await response.text()
        async with session.post(f"{url}api/reset", json={"robot": platform.node()}) as response:
            answers["api/reset"] = response.status, await response.text()
    async with aiohttp.ClientSession() as session, session.get(f"{url}api/state") as response:
        answers["without a token"] = response.status, await response.text()
    captured = await _capture(url.replace("http", "ws", 1), token)
    return [level["msg"]["data"], reset["values"], refused["values"], parameters, answers, captured]


async def _capture(url: str, token: str) -> tuple[Capture, list[float], Any]:
    """Returns what a node of the client captures of a topic, what it judges meanwhile, and counts in the graph."""
    client = RosbridgeClient(url, token=token, on_link=lambda up, cause: None, on_log=lambda line: None)
    node, capture, judged = client.node("watcher"), Capture(), Recorder()
    node.subscribe("/battery_level", "", judged, field="data")
    node.subscribe_raw("/battery_level", "", capture)
    graph: list[Any] = []
    node.follow_graph(lambda: GRAPH, lambda counts, now_s: graph.append(counts))
    running = asyncio.ensure_future(client.run())
    while len(capture.items) < 2 or len(graph) < 2 or len(graph[-1]) < len(GRAPH):
        await asyncio.sleep(0.05)
    client.close()
    running.cancel()
    await asyncio.wait({running})
    return capture, judged.values, graph[-1]


def _check_captured(capture: Capture, judged: list[float], graph: Any) -> None:
    """Checks that the bytes are those of ROS, with the definition that reads them, and are judged as such."""
    assert graph["publishers", "/battery_level"] == 1.0
    assert graph["subscribers", "/heard_by_none"] == 0.0
    assert graph["node", "/no_such_node"] == 0.0 < graph["node", "*"]
    (profile,) = {raw_format.profile for _, _, raw_format in capture.items}
    assert profile == ("ros2" if importlib.util.find_spec("rclpy") else "ros1")
    values = capture.values()
    assert all(0.0 <= value <= 100.0 for value in values)
    assert judged[-len(values) :] == values


def check_web(answers: Mapping[str, tuple[int, str]]) -> None:
    """Checks the answers to the HTTP requests of `look_at`."""
    assert answers[""][0] == 200 and "<!DOCTYPE html>" in answers[""][1]
    robot = json.loads(answers["api/state"][1])["robots"][platform.node()]
    battery = robot["signals"]["battery_level"]
    assert (battery["level"], battery["state"]) == ("OK", "inactive")
    assert battery["window"][-1][1] == battery["value"]
    assert abs(battery["window"][-1][0] - time.time()) < 60.0
    assert answers["healthz"] == (200, '{"ok":true,"faults":[]}')
    assert answers["api/reset"] == (200, '{"message":"reset: nothing was latched"}')
    status, refusal = answers["without a token"]
    assert (status, json.loads(refusal)) == (401, {"error": "a token is required"})
    assert f'robot_health_level{{robot="{platform.node()}",signal="battery_level"}} 0.0' in answers["metrics"][1]


def check_served(process: Any, seen: list[Any]) -> None:
    """Checks what `look_at` saw of `health_monitor`, and that the process ends as it should."""
    level, reset, refused, parameters, answers, captured = seen
    _check_captured(*captured)
    assert 0.0 <= level <= 100.0
    assert reset == {"success": True, "message": "reset: nothing was latched"}
    assert refused == "clients may not call /alert_system/set_logger_level"
    assert "/alert_system:signals.battery_level.warn_below" in parameters
    assert "/alert_system:rosbridge_token" not in parameters
    check_web(answers)
    process.wait_for_text("web page: http://127.0.0.1:")
    process.signal(signal.SIGINT)
    assert process.wait() == 0
    assert not re.search("Traceback|ERROR", process.text)
