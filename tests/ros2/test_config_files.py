"""The files in config/ are read by ROS 2's own parser, with the values that Python's YAML reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robot_health_monitor.core.config.monitor_config import find_section, sections
from robot_health_monitor.core.config.parameters import flatten
from robot_health_monitor.core.config.yaml_file import read_yaml

CONFIG = Path(__file__).resolve().parents[2] / "config"
SECTIONS = [(path.name, each.node) for path in sorted(CONFIG.glob("*.yaml")) for each in sections(read_yaml(path).tree)]


@pytest.mark.parametrize(("file", "node"), SECTIONS)
def test_ros_2_reads_the_same_values(file: str, node: str, ros_environment: dict[str, str]) -> None:
    from rclpy.context import Context
    from rclpy.node import Node

    context = Context()
    context.init(args=["--ros-args", "--params-file", str(CONFIG / file)])
    reader = Node(node, context=context, automatically_declare_parameters_from_overrides=True)
    try:
        found: dict[str, Any] = {
            name: list(parameter.value) if hasattr(parameter.value, "tolist") else parameter.value
            for name, parameter in reader.get_parameters_by_prefix("").items()
        }
    finally:
        reader.destroy_node()
        context.shutdown()
    expected = dict(flatten(find_section(read_yaml(CONFIG / file).tree, node).tree))
    assert {name: found.get(name) for name in expected} == expected
