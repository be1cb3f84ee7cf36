"""The catkin builds: `rosrun`, `roslaunch` and `robot-health` work in the install space and in the devel space."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from harness.packaging_workspace import (
    NAME,
    NODES,
    Workspace,
    check_share,
    installed_modules,
    need_pytest_of_ros1,
    need_ros1,
    source_modules,
    version,
)


@pytest.fixture(params=["colcon", "colcon --symlink-install", "catkin_make", "catkin_make install"])
def built(request: Any) -> Workspace:
    need_ros1()
    if request.param == "colcon":
        return request.getfixturevalue("both_targets").use_colcon("1")
    if request.param == "colcon --symlink-install":
        workspace: Workspace = request.getfixturevalue("workspace")
        workspace.colcon("build", "1", "--symlink-install")
        return workspace
    workspace = request.getfixturevalue("by_catkin_make")
    if request.param == "catkin_make install":
        workspace.catkin_make("install")
    return workspace.use_space("install" if request.param == "catkin_make install" else "devel")


def test_rosrun_and_roslaunch_find_everything_and_the_monitor_runs(built: Workspace) -> None:
    share = Path(built.shell(f"rospack find {NAME}"))
    assert share == (built.package if built.prefix.name == "devel" else built.prefix / "share" / NAME)
    check_share(share)
    for node in NODES:
        assert (built.prefix / "lib" / NAME / node).read_text().startswith("#!/usr/bin/python3\n")

    module = Path(built.shell(f"/usr/bin/python3 -c 'import {NAME}; print({NAME}.__file__)'"))
    assert built.folder in module.parents
    if built.prefix.name != "devel":
        assert installed_modules(module.parent) == source_modules()

    assert version() in built.shell("robot-health --version")
    built.shell(f"robot-health check {share}/config/thresholds.yaml")

    launch = built.start(f"roslaunch {NAME} health_monitor.launch")
    try:
        for node in ("battery_sensor", "aggregator", "alert_system"):
            built.wait_for_node(f"/{node}")
        assert built.shell("rostopic echo -n 1 /system_health").startswith("data: ")
    finally:
        launch.send_signal(signal.SIGINT)
        output, _ = launch.communicate(timeout=30)
    assert launch.returncode == 0
    assert "Traceback" not in output


def test_rosrun_starts_the_composed_node(both_targets: Workspace) -> None:
    need_ros1()
    workspace = both_targets.use_colcon("1")
    master = workspace.start(f"roscore -p {workspace.variables['ROS_MASTER_URI'].rpartition(':')[2]}")
    try:
        workspace.wait_for_node("/rosout")
        node = workspace.start(f"rosrun {NAME} health_monitor")
        try:
            workspace.wait_for_node("/health_monitor")
            assert workspace.shell("rostopic echo -n 1 /battery_level").startswith("data: ")
        finally:
            node.send_signal(signal.SIGINT)
            output, _ = node.communicate(timeout=30)
        assert node.returncode == 0, output
    finally:
        master.send_signal(signal.SIGINT)
        master.communicate(timeout=30)


@pytest.mark.parametrize(("body", "fails"), [("assert True", False), ("assert False", True)])
def test_colcon_test_runs_the_tests_and_fails_when_they_do(both_targets: Workspace, body: str, fails: bool) -> None:
    need_ros1()
    need_pytest_of_ros1()
    both_targets.replace_tests(body)
    both_targets.colcon("test", "1", "--return-code-on-test-failure", fails=fails)
    results = both_targets.folder / "build" / "ros1" / NAME / "test_results" / NAME / "pytest.xml"
    assert 'name="test_the_only_one"' in results.read_text()


@pytest.mark.parametrize(("body", "fails"), [("assert True", False), ("assert False", True)])
def test_catkin_make_run_tests_runs_the_tests_and_fails_when_they_do(
    by_catkin_make: Workspace, body: str, fails: bool
) -> None:
    need_pytest_of_ros1()
    by_catkin_make.replace_tests(body)
    by_catkin_make.catkin_make("run_tests")
    assert "1 tests" in by_catkin_make.shell("catkin_test_results build/test_results", fails=fails)
