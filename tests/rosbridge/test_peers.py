"""Third-party clients, unchanged, against the server: roslibpy from PyPI and roslib from npm.

roslib is installed under `.venv/` if Node.js is available.
"""

from __future__ import annotations

import asyncio
import fcntl
import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from harness.rosbridge_peer import Robot, with_robot

from robot_health_monitor.runtime.access import Access

HERE = Path(__file__).parent
ACCESS = Access(publish=("/in",), services=("/robot/reset", "/offered"), offer=("/offered",))


async def run_beside(robot: Robot, command: list[str]) -> dict[str, Any]:
    """Runs a program while the robot publishes; returns what it has seen."""
    robot.node.advertise_service("~reset", "std_srvs/Trigger", lambda request: {"success": True, "message": "done"})
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    waiting = asyncio.ensure_future(process.communicate())
    level = 100.0
    while not waiting.done():
        level -= 0.25
        robot.publish(level)
        await asyncio.sleep(0.01)
    output, errors = waiting.result()
    assert process.returncode == 0, errors.decode()
    seen: dict[str, Any] = json.loads(output)
    return seen


@pytest.fixture(scope="module")
def roslibjs() -> list[str]:
    """Returns the command that runs the program with roslib."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("there is no Node.js on this machine")
    folder = HERE.parents[1] / ".venv" / "roslib"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # `make test` runs these tests with two Pythons at once
        if not (folder / "node_modules" / "roslib").is_dir():
            (folder / "package.json").write_text('{"private": true, "type": "module"}')
            done = subprocess.run([npm, "install", "roslib", "ws"], cwd=folder, capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"npm cannot install roslib: {done.stderr.strip()[-200:]}")
    program = folder / "roslibjs_peer.mjs"  # Node.js looks for modules beside the program
    shutil.copy(HERE / "roslibjs_peer.mjs", program)
    return [node, str(program)]


@pytest.mark.skipif(importlib.util.find_spec("roslibpy") is None, reason="roslibpy is not installed")
def test_roslibpy_works_unchanged() -> None:
    @with_robot(ACCESS)
    async def scenario(robot: Robot) -> None:
        seen = await run_beside(robot, [sys.executable, str(HERE / "roslibpy_peer.py"), str(robot.server.port)])
        first = seen["levels"][0]
        assert seen["levels"] == [first - 0.25 * step for step in range(5)]
        assert seen["topics"] == ["/battery_level", "/rosout"]
        assert seen["type"] == "std_msgs/Float32"
        assert seen["nodes"] == ["/robot", "/rosbridge"]
        assert seen["services"] == ["/robot/reset"]
        assert seen["details"] == ["data"]
        assert "secs" in seen["time"]
        assert seen["reset"] == {"success": True, "message": "done"}
        assert "may not call" in seen["refused"]
        assert seen["echo"] == 3.5
        assert seen["offered"] == {"success": True, "message": "from roslibpy"}
        assert (seen["parameters"], seen["rate"]) == (["/rosbridge:rate"], 2.5)

    scenario()


def test_roslibjs_works_unchanged(roslibjs: list[str]) -> None:
    @with_robot(ACCESS)
    async def scenario(robot: Robot) -> None:
        seen = await run_beside(robot, [*roslibjs, str(robot.server.port)])
        assert seen["topics"] == ["/battery_level", "/rosout"]
        assert seen["type"] == "std_msgs/Float32"
        assert seen["ofType"] == ["/battery_level"]
        assert seen["nodes"] == ["/robot", "/rosbridge"]
        assert seen["services"] == ["/robot/reset"]
        assert seen["serviceType"] == "std_srvs/Trigger"
        assert list(seen["details"]) == ["data"]
        levels = seen["levels"]
        assert 100.0 > levels["none"] > levels["png"] > levels["cbor"]
        assert seen["reset"] == {"success": True, "message": "done"}
        assert "may not call" in str(seen["refused"])
        assert seen["echo"] == 3.5
        assert seen["rate"] == 2.5

    scenario()
