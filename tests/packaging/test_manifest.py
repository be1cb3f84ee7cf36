"""package.xml: complete, valid for both versions of ROS, and in agreement with setup.py and CMakeLists.txt."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from harness.packaging_workspace import NAME, ROOT, version
from harness.requirements import runtime_requirements

from release import manifest
from robot_health_monitor.runtime.libraries import debian_package

parse_package = pytest.importorskip("catkin_pkg.package").parse_package

ROS1 = {"ROS_VERSION": "1", "ROS_DISTRO": "noetic", "ROS_PYTHON_VERSION": "3"}
ROS2 = {"ROS_VERSION": "2", "ROS_DISTRO": "jazzy", "ROS_PYTHON_VERSION": "3"}
OPTIONAL = {"cbor2", "rich"}
"""Apt of Ubuntu 20.04 does not have these, so that nothing built from package.xml may depend on them."""


def package(context: object) -> Any:
    warnings: list[str] = []
    found = parse_package(str(ROOT), warnings=warnings)
    found.evaluate_conditions(context)
    assert warnings == []
    found.validate(warnings=warnings)
    assert warnings == []
    return found


def keys(depends: Any) -> set[str]:
    return {depend.name for depend in depends if depend.evaluated_condition}


@pytest.mark.parametrize(("context", "build_type"), [(ROS1, "catkin"), (ROS2, "ament_python")])
def test_it_is_valid_for_both_versions_of_ros(context: object, build_type: str) -> None:
    found = package(context)
    assert (found.name, found.version, found.get_build_type()) == (NAME, version(), build_type)
    assert found.package_format == 3


def test_it_says_who_made_it_and_where_to_find_it() -> None:
    found = package(ROS2)
    assert {url.type for url in found.urls} == {"website", "bugtracker", "repository"}
    assert found.authors and found.maintainers
    assert found.licenses == ["Apache-2.0"]
    assert "\n" not in found.plaintext_description


def test_each_version_of_ros_gets_its_own_dependencies_only() -> None:
    ros1, ros2 = package(ROS1), package(ROS2)
    assert keys(ros1.buildtool_depends) == {"catkin"}
    assert keys(ros2.buildtool_depends) == set()
    assert {"rospy", "roslaunch"} <= keys(ros1.exec_depends) and "rclpy" not in keys(ros1.exec_depends)
    assert {"rclpy", "ros2launch"} <= keys(ros2.exec_depends) and "rospy" not in keys(ros2.exec_depends)


def test_the_nodes_depend_on_what_pip_installs_except_what_is_optional() -> None:
    required = {debian_package(re.split("[<>=]", each)[0]) for each in runtime_requirements()}
    optional = {debian_package(each) for each in OPTIONAL}
    for context in (ROS1, ROS2):
        found = {key for key in keys(package(context).exec_depends) if key.startswith("python3-")}
        assert found == required - optional


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("maintainers@robot-health-monitor.example", "maintainers@robot-health-monitor.example"),
        ("https://example.com/robots/issues", "https://example.com/robots/issues"),
        ("jane@fleet.invalid", "jane@fleet.invalid"),
        ("jane@contest.testing.de", ""),
        ("https://github.com/jane/example.robots", ""),
    ],
)
def test_a_placeholder_is_found_outside_of_comments(address: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "package.xml"
    file.write_text(f"<package>\n<!-- nobody@robots.example\n-->\n<url>{address}</url></package>\n")
    assert manifest.placeholder(file) == expected


def test_rosdoc2_finds_its_configuration_and_the_documents() -> None:
    exported = [export.content for export in package(ROS2).exports if export.tagname == "rosdoc2"]
    (file,) = (ROOT / name for name in exported)
    attic, settings = yaml.safe_load_all(file.read_text("utf-8"))
    assert attic == {"type": "rosdoc2 config", "version": 1}
    ((builder,),) = ([each["sphinx"]] for each in settings["builders"])
    assert (ROOT / builder["sphinx_sourcedir"]).is_dir()
