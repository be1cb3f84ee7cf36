"""What the tests install: the lists in setup.py, its only place for requirements and folders, and ROS 2 from PyPI."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

ROS2_WHEELS = [
    "ros-jazzy-rclpy",
    "ros-jazzy-rmw-fastrtps-cpp",
    "ros-jazzy-std-msgs",
    "ros-jazzy-diagnostic-msgs",
    "ros-std-srvs==5.3.6",
    "ros-sensor-msgs==5.3.6",
]
"""ROS 2 from PyPI, for machines without Jazzy."""


def runtime_requirements() -> list[str]:
    """Returns the packages that the monitor needs."""
    requirements: list[str] = _setup_argument("install_requires")
    return requirements


def test_requirements() -> list[str]:
    """Returns the packages that the tests need in addition."""
    requirements: list[str] = _setup_argument("extras_require")["test"]
    return requirements


def recordings_requirements() -> list[str]:
    """Returns the packages that reading recordings needs in addition."""
    requirements: list[str] = _setup_argument("extras_require")["recordings"]
    return requirements


def package_folders() -> list[str]:
    """Returns the top-level folders that are packages below the root package."""
    for node in ast.walk(_setup_file()):
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "FOLDERS":
            folders: list[str] = ast.literal_eval(node.value)
            return folders
    raise AssertionError("setup.py has no FOLDERS")


def _setup_argument(name: str) -> Any:
    for node in ast.walk(_setup_file()):
        if isinstance(node, ast.keyword) and node.arg == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"setup.py has no {name}")


def _setup_file() -> ast.Module:
    return ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))
