"""Real servers of other projects.

PyPI's foxglove-sdk speaks `foxglove.sdk.v1`, npm's @foxglove/ws-protocol `foxglove.websocket.v1`, and so does an older
foxglove_bridge where ROS 2 is sourced.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib.metadata
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, Iterator, Sequence

import pytest
from harness.foxglove_client import Watched
from harness.reserved import free_port
from harness.rosbridge_client import scenario, until

from robot_health_monitor.core.nodes import AlertSystem

HERE = Path(__file__).parent
BATTERY = {"topic": "/battery", "type": "std_msgs/Float32", "warn_below": 20.0, "error_below": 10.0}


@contextlib.contextmanager
def running(command: Sequence[str], **options: Any) -> Iterator[int]:
    """Runs a peer until the end of the context; returns its port."""
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options)
    try:
        assert process.stdout is not None and process.stdin is not None
        yield int(process.stdout.readline())
        process.stdin.close()
        assert process.wait(30) == 0
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def sdk_port() -> Iterator[int]:
    try:
        importlib.metadata.version("foxglove-sdk")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("foxglove-sdk is not installed; pip has it for Python 3.10 and newer")
    with running([sys.executable, str(HERE / "sdk_peer.py")]) as port:
        yield port


@pytest.fixture
def npm_port() -> Iterator[int]:
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("there is no Node.js on this machine")
    folder = HERE.parents[1] / ".venv" / "foxglove"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # `make test` runs these tests with two Pythons at once
        if not (folder / "node_modules" / "@foxglove").is_dir():
            (folder / "package.json").write_text('{"private": true, "type": "module"}')
            install = [npm, "install", "@foxglove/ws-protocol", "ws"]
            done = subprocess.run(install, cwd=folder, capture_output=True, text=True)
            if done.returncode:
                pytest.skip(f"npm cannot install @foxglove/ws-protocol: {done.stderr.strip()[-200:]}")
    shutil.copy(HERE / "npm_peer.mjs", folder)  # Node.js looks for modules beside the program
    with running([node, str(folder / "npm_peer.mjs")]) as port:
        yield port


async def lines_of(watched: Watched, signals: Any, expected: Sequence[str]) -> list[str]:
    """Returns the alert lines until those that are expected have come, without what follows the level."""
    lines: list[str] = []
    node = watched.client.node("alert_system", parameters={"signals": signals})
    alert_system = AlertSystem(node, {"test": lambda event: lines.append(str(getattr(event, "text", event)))})
    await until(lambda: {line.partition(":")[0] for line in lines} >= set(expected))
    alert_system.close()
    return [line.partition(":")[0] for line in lines]


def test_what_the_sdks_server_publishes_is_judged(sdk_port: int) -> None:
    @scenario
    async def run() -> None:
        watched = Watched(f"foxglove://127.0.0.1:{sdk_port}")
        # The hint is looked up when half of the grace has passed: by then the link must be up, also on a busy machine.
        picture = {"topic": "/picture", "statistic": "frequency_hz", "warn_below": 1.0, "startup_grace_s": 10.0}
        voltage = {"topic": "/voltage", "field": "data", "warn_below": 12.0}
        signals = {"battery": BATTERY, "voltage": voltage, "picture": picture}
        lines = await lines_of(watched, signals, ["battery WARN", "battery ERROR", "picture STALE"])
        assert [line for line in lines if not line.startswith("picture")] == ["battery WARN", "battery ERROR"]
        (hint,) = (each for each in watched.problems() if each.startswith("picture STALE"))
        assert hint.endswith("[its messages have the encoding protobuf, which is not supported]")
        assert watched.ups == [True]
        topics = {each.topic: each.type_name for each in await watched.client.known_topics()}
        assert topics == {"/battery": "std_msgs/Float32", "/voltage": ""}
        await watched.close()

    run()


def test_what_a_server_of_the_first_version_publishes_is_judged(npm_port: int) -> None:
    @scenario
    async def run() -> None:
        watched = Watched(f"foxglove://127.0.0.1:{npm_port}")
        assert await lines_of(watched, {"battery": BATTERY}, ["battery WARN"]) == ["battery WARN"]
        assert watched.ups == [True]
        await watched.close()

    run()


@pytest.mark.skipif(
    shutil.which("ros2") is None
    or subprocess.run(["ros2", "pkg", "prefix", "foxglove_bridge"], capture_output=True).returncode != 0,
    reason="foxglove_bridge is not installed, or ROS 2 is not sourced here",
)
def test_what_foxglove_bridge_passes_on_is_judged() -> None:
    @scenario
    async def run() -> None:
        port = free_port()
        environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        bridge = ["ros2", "run", "foxglove_bridge", "foxglove_bridge", "--ros-args", "-p", f"port:={port}"]
        driver = ["ros2", "topic", "pub", "-r", "20", "/battery", "std_msgs/msg/Float32", "{data: 15.0}"]
        processes = [subprocess.Popen(each, env=environment, stdout=subprocess.DEVNULL) for each in (bridge, driver)]
        try:
            watched = Watched(f"foxglove://127.0.0.1:{port}")
            assert await lines_of(watched, {"battery": BATTERY}, ["battery WARN"]) == ["battery WARN"]
            await watched.close()
        finally:
            for process in processes:
                process.terminate()
                process.wait()

    run()
