"""The ament_python build: executables where `ros2 run` finds them, `robot-health` on the PATH."""

from __future__ import annotations

import importlib.util
import os
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
from harness.packaging_workspace import (
    NAME,
    NODES,
    Workspace,
    check_share,
    installed_modules,
    need_ros1,
    run,
    source_modules,
    version,
)


@pytest.fixture(params=["", "--symlink-install"])
def built(request: Any) -> Workspace:
    if not request.param:
        return request.getfixturevalue("both_targets").use_colcon("2")
    workspace: Workspace = request.getfixturevalue("workspace")
    workspace.colcon("build", "2", request.param)
    return workspace


def test_ros2_run_and_ros2_launch_find_everything(built: Workspace) -> None:
    share = built.prefix / "share"
    check_share(share / NAME)
    assert (share / "ament_index" / "resource_index" / "packages" / NAME).is_file()
    assert built.shell("echo $AMENT_PREFIX_PATH").split(os.pathsep)[0] == str(built.prefix)
    for command in (*NODES, "robot-health"):
        assert os.access(built.prefix / "lib" / NAME / command, os.X_OK)

    module = Path(built.shell(f"{sys.executable} -c 'import {NAME}.core; print({NAME}.__file__)'"))
    assert built.folder in module.parents
    if "build" not in module.parts:
        assert installed_modules(module.parent) == source_modules()

    assert built.shell("command -v robot-health") == str(built.prefix / "bin" / "robot-health")
    assert version() in built.shell("robot-health --version")
    built.shell(f"robot-health check {share / NAME}/config/thresholds.yaml")
    # Nothing but the two is on the PATH: `aggregator` is too common a name for it.
    assert [path.name for path in (built.prefix / "bin").iterdir()] == ["robot-health"]


def test_the_debian_rules_of_bloom_install_the_nodes_where_ros2_run_finds_them(workspace: Workspace) -> None:
    # The options of bloom's debian/rules for ament_python, which sends all commands to bin/.
    options = ["--prefix", "/opt/ros/jazzy", "--install-scripts", "$base/bin", "--install-lib", "$base/lib/python3"]
    root = workspace.folder / "root"
    run([sys.executable, "setup.py", "install", "--root", str(root), *options], workspace.package, workspace.variables)
    prefix = root / "opt" / "ros" / "jazzy"
    assert sorted(path.name for path in (prefix / "lib" / NAME).iterdir()) == sorted([*NODES, "robot-health"])
    assert [path.name for path in (prefix / "bin").iterdir()] == ["robot-health"]
    assert installed_modules(prefix / "lib" / "python3" / NAME) == source_modules()
    check_share(prefix / "share" / NAME)


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed")
@pytest.mark.parametrize("node", NODES)
def test_an_executable_is_a_node_that_ends_cleanly(both_targets: Workspace, node: str) -> None:
    workspace = both_targets.use_colcon("2")
    # Its user has sourced ROS 2, if this shell has: rclpy is found through these.
    sourced = {name: os.environ[name] for name in ("AMENT_PREFIX_PATH", "PYTHONPATH") if name in os.environ}
    process = workspace.start(str(workspace.prefix / "lib" / NAME / node), **sourced)
    try:
        assert process.stdout is not None
        first_line = process.stdout.readline()
    finally:
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=30)
    assert "INFO" in first_line
    assert process.returncode == 0, first_line + rest
    assert "Traceback" not in rest


@pytest.mark.parametrize(("body", "fails"), [("assert True", False), ("assert False", True)])
def test_colcon_test_runs_the_tests_and_fails_when_they_do(both_targets: Workspace, body: str, fails: bool) -> None:
    both_targets.replace_tests(body)
    both_targets.colcon("test", "2", "--return-code-on-test-failure", fails=fails)
    results = both_targets.folder / "build" / "ros2" / NAME / "pytest.xml"
    assert 'name="test_the_only_one"' in results.read_text()


def test_both_targets_build_in_one_workspace(both_targets: Workspace) -> None:
    need_ros1()
    for ros_version, has_ament in (("1", False), ("2", True)):
        workspace = both_targets.use_colcon(ros_version)
        assert ("ament" in str(sorted((workspace.prefix / "share").iterdir()))) == has_ament
        assert version() in workspace.shell("robot-health --version")
