"""Which packages each folder may import, and that each of them is a declared dependency."""

from __future__ import annotations

import ast
import os
import sys
from pathlib import Path
from typing import Iterator, NamedTuple
from xml.etree import ElementTree

import pytest
from harness.packaging_workspace import FOLDERS, NAME, ROOT, run
from harness.requirements import recordings_requirements, runtime_requirements

ROS1 = {"genpy", "rosgraph", "roslib", "rospy", "rosservice"}
ROS2 = {"ament_index_python", "builtin_interfaces", "rcl_interfaces", "rclpy", "rosidl_runtime_py"}
MESSAGES = {"diagnostic_msgs", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs"}
RECORDINGS = {"lz4", "mcap", "rosbags", "zstandard"}
"""The extra [recordings]: pip installs it, the ROS package does not depend on it."""
BY_HAND = {"pynvml"}
"""Only for computers with a card of NVIDIA, whose owners install it; without it there is one clear line."""
ALLOWED = {
    "core": {"psutil", "yaml"} | BY_HAND,
    "runtime": {"aiohttp"},
    "ros1": ROS1 | MESSAGES,
    "ros2": ROS2 | MESSAGES,
    "rosbridge": {"aiohttp", "cbor2"},
    "foxglove": {"aiohttp"},
    "recordings": {"yaml"} | RECORDINGS,
    "ops": {"aiohttp", "mcap", "yaml", "zstandard"},
    "cli": {"rich", "yaml"},
    NAME: set(),
}
"""Packages that a folder may import, in addition to the standard library and this package."""

PIP_NAMES = {"yaml": "PyYAML"}
"""Modules that pip knows by another name."""

OPTIONAL = {"cbor2", "rich"}
"""pip installs them; packages of ROS do not depend on them, because apt of Ubuntu 20.04 does not have them."""

CARRIED = {"builtin_interfaces": "rcl_interfaces", "rosgraph_msgs": "rclpy"}
"""Modules that always come with another dependency."""


class Import(NamedTuple):
    """One import of a module from outside the package."""

    file: Path
    line: int
    module: str


def imports(folder: str) -> Iterator[Import]:
    """Yields what the files of a folder import from outside the package and the standard library."""
    for file in sorted((ROOT / folder).rglob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                module = name.partition(".")[0]
                if module != NAME and module not in sys.stdlib_module_names:
                    yield Import(file, node.lineno, module)


needs_names = pytest.mark.skipif(sys.version_info < (3, 10), reason="sys.stdlib_module_names came with Python 3.10")


@needs_names
@pytest.mark.parametrize("folder", [*FOLDERS, NAME])
def test_a_folder_imports_only_what_it_may(folder: str) -> None:
    assert [found for found in imports(folder) if found.module not in ALLOWED[folder]] == []


def test_core_works_with_nothing_installed() -> None:
    """Only reading a file needs PyYAML."""
    code = """
import pathlib, importlib
for file in sorted(pathlib.Path("core").rglob("*.py")):
    if file.name != "yaml_loader.py":
        importlib.import_module(".".join(("robot_health_monitor", *file.with_suffix("").parts)))
from robot_health_monitor.core import Monitor, Sample, load_config
monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0}}}))
print(len(monitor.observe(Sample("battery_level", 19.0, 0.0))))
"""
    # -I and -S: no installed packages; the source tree is the only folder besides the standard library.
    start = ["-I", "-S", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}"]
    assert run([sys.executable, *start], ROOT, dict(os.environ)).stdout == "1\n"


@needs_names
def test_every_import_is_a_dependency_with_a_rosdep_key() -> None:
    keys = {element.text for element in ElementTree.parse(ROOT / "package.xml").findall("exec_depend")}
    pip_names = {requirement.partition(">")[0] for requirement in runtime_requirements()}
    extra = {requirement.partition(">")[0] for requirement in recordings_requirements()}
    for folder in [*FOLDERS, NAME]:
        for found in imports(folder):
            module = CARRIED.get(found.module, found.module)
            if module in ROS1 | ROS2 | MESSAGES:
                assert module in keys, found
            elif module in RECORDINGS:
                assert module in extra, found
            elif module not in BY_HAND:
                assert PIP_NAMES.get(module, module) in pip_names, found
                assert (f"python3-{module.replace('_', '-')}" in keys) == (module not in OPTIONAL), found


def test_launch_is_no_python_package() -> None:
    """With an `__init__.py` it would shadow ROS 2's own `launch`."""
    assert not (ROOT / "launch" / "__init__.py").exists()
