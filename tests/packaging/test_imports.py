"""What each folder may import, and that whatever is imported is a declared dependency."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from typing import Iterator, NamedTuple, Set
from xml.etree import ElementTree

import pytest
from harness.packaging_workspace import FOLDERS, NAME, ROOT
from harness.requirements import runtime_requirements

ROS1 = {"genpy", "rosgraph", "roslib", "rospy", "rosservice"}
ROS2 = {"ament_index_python", "builtin_interfaces", "rcl_interfaces", "rclpy", "rosidl_runtime_py"}
MESSAGES = {"diagnostic_msgs", "rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs"}
ALLOWED = {
    "core": {"psutil", "yaml"},
    "ros1": ROS1 | MESSAGES,
    "ros2": ROS2 | MESSAGES,
    "rosbridge": {"aiohttp", "cbor2"},
    NAME: {"rich"},
}
"""What a folder may import besides the standard library and this package."""

PIP_NAMES = {"yaml": "PyYAML"}
"""Where pip's name is not the module's."""

CARRIED = {"builtin_interfaces": "rcl_interfaces", "rosgraph_msgs": "rclpy"}
"""What comes with another dependency, always."""


class Import(NamedTuple):
    """One import of a module from outside the package."""

    file: Path
    line: int
    module: str
    at_start: bool
    """Whether it happens when the file is imported."""


def imports(folder: str) -> Iterator[Import]:
    """Yields what the files of a folder import from outside the package and the standard library."""
    for file in sorted((ROOT / folder).rglob("*.py")):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        late: Set[ast.AST] = set()
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                late.update(ast.walk(node))
        for node in ast.walk(tree):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                module = name.partition(".")[0]
                if module != NAME and module not in sys.stdlib_module_names:
                    yield Import(file, node.lineno, module, node not in late)


needs_names = pytest.mark.skipif(sys.version_info < (3, 10), reason="sys.stdlib_module_names came with Python 3.10")


@needs_names
@pytest.mark.parametrize("folder", [*FOLDERS, NAME])
def test_a_folder_imports_only_what_it_may(folder: str) -> None:
    assert [found for found in imports(folder) if found.module not in ALLOWED[folder]] == []


@needs_names
def test_core_imports_with_nothing_installed() -> None:
    assert [found for found in imports("core") if found.at_start] == []


@needs_names
def test_every_import_is_a_dependency_with_a_rosdep_key() -> None:
    keys = {element.text for element in ElementTree.parse(ROOT / "package.xml").getroot() if "depend" in element.tag}
    pip_names = {requirement.partition(">")[0] for requirement in runtime_requirements()}
    for folder in [*FOLDERS, NAME]:
        for found in imports(folder):
            module = CARRIED.get(found.module, found.module)
            if module in ROS1 | ROS2 | MESSAGES:
                assert module in keys, found
            else:
                assert f"python3-{module}" in keys, found
                assert PIP_NAMES.get(module, module) in pip_names, found


def test_launch_is_no_python_package() -> None:
    """With an `__init__.py` it would shadow ROS 2's own `launch`."""
    assert not (ROOT / "launch" / "__init__.py").exists()
