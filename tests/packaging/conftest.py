from __future__ import annotations

from pathlib import Path

import pytest
from harness.packaging_workspace import Workspace, has_ros1, need_ros1


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    """Returns a workspace in which nothing is built."""
    return Workspace(tmp_path)


@pytest.fixture(scope="session")
def both_targets(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """Returns a workspace that colcon has built for ROS 1, if this machine has it, and then for ROS 2."""
    workspace = Workspace(tmp_path_factory.mktemp("colcon"))
    if has_ros1():
        workspace.colcon("build", "1")
    workspace.colcon("build", "2")
    return workspace


@pytest.fixture(scope="session")
def by_catkin_make(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """Returns a workspace that catkin_make has built."""
    need_ros1()
    workspace = Workspace(tmp_path_factory.mktemp("catkin"))
    workspace.catkin_make()
    return workspace
