"""The policy for SROS2. tests/ros2/test_security_policy.py compares it with the graph of ROS 2."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from robot_health_monitor.core.config.yaml_file import read_yaml
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ops.configuration import OpsConfig, read_ops
from robot_health_monitor.ops.export.sros2 import Robot, export_policy

TREE: dict[str, Any] = {
    "alert_system": {"ros__parameters": {"signals": {"soc": {"topic": "bms/soc", "warn_below": 20.0}}}},
    "aggregator": {"ros__parameters": {"inputs": ["soc"]}},
}

ALONE = """<?xml version="1.0" encoding="UTF-8"?>
<policy version="0.2.0">
  <enclaves>
    <enclave path="/fleet/r1/health_monitor">
      <profiles>
        <profile ns="/fleet/r1" node="alert_system">
          <topics publish="ALLOW">
            <topic>/diagnostics</topic>
            <topic>/fleet/r1/alert_system/_executor_probe</topic>
            <topic>/fleet/r1/alerts</topic>
            <topic>/parameter_events</topic>
            <topic>/rosout</topic>
          </topics>
          <topics subscribe="ALLOW">
            <topic>/clock</topic>
            <topic>/fleet/r1/_simulated_sensors</topic>
            <topic>/fleet/r1/_unavailable_sensors</topic>
            <topic>/fleet/r1/alert_system/_executor_probe</topic>
            <topic>/fleet/r1/bms/soc</topic>
          </topics>
          <services reply="ALLOW">
            <service>/fleet/r1/alert_system/describe_parameters</service>
            <service>/fleet/r1/alert_system/get_parameter_types</service>
            <service>/fleet/r1/alert_system/get_parameters</service>
            <service>/fleet/r1/alert_system/get_type_description</service>
            <service>/fleet/r1/alert_system/list_parameters</service>
            <service>/fleet/r1/alert_system/reset</service>
            <service>/fleet/r1/alert_system/set_parameters</service>
            <service>/fleet/r1/alert_system/set_parameters_atomically</service>
          </services>
        </profile>
      </profiles>
    </enclave>
  </enclaves>
</policy>
"""


def names(policy: str, node: str, kind: str, verb: str) -> list[str]:
    """Returns the names of one list of a policy; empty: there is none."""
    (profile,) = (each for each in ElementTree.fromstring(policy).iter("profile") if each.attrib["node"] == node)
    return [str(element.text) for element in profile.findall(f"{kind}s[@{verb}='ALLOW']/{kind}")]


def test_a_policy_has_the_form_of_sros2() -> None:
    """Written by hand after sros2/policy/schemas/policy.xsd and the policies in its tests."""
    tree = {"alert_system": TREE["alert_system"]}
    found = export_policy(tree, Robot("fleet/r1", "none"))
    without_comment = [line for line in found.splitlines() if not line.startswith("<!--")]
    assert "\n".join(without_comment) + "\n" == ALONE


def test_the_sensors_decide_which_nodes_run() -> None:
    def nodes(sensors: str) -> list[str]:
        policy = ElementTree.fromstring(export_policy(TREE, Robot(sensors=sensors)))
        return [profile.attrib["node"] for profile in policy.iter("profile")]

    assert nodes("simulated") == ["alert_system", "aggregator", "battery_sensor"]
    assert nodes("none") == ["alert_system", "aggregator"]  # its inputs are configured


def test_only_a_host_lists_sensors_that_it_does_not_have() -> None:
    def published(sensors: str) -> list[str]:
        return names(export_policy(TREE, Robot("r1", sensors)), "battery_sensor", "topic", "publish")

    name = "/r1/_unavailable_sensors"
    assert name in published("host") and name not in published("simulated")


def test_remapped_and_absolute_names_are_written_in_full() -> None:
    tree = {"alert_system": {"ros__parameters": {"signals": {"a": {"topic": "/scan", "field": ""}, "b": {}}}}}
    policy = export_policy(tree, Robot("r1", "none", {"b": "/other/b"}))
    subscribed = names(policy, "alert_system", "topic", "subscribe")
    assert "/scan" in subscribed and "/other/b" in subscribed and "/r1/b" not in subscribed


def test_without_a_namespace_names_are_absolute_and_the_enclave_is_at_the_root() -> None:
    policy = export_policy(TREE, Robot(sensors="none"))
    assert ElementTree.fromstring(policy).find("enclaves/enclave").attrib == {"path": "/health_monitor"}  # type: ignore[union-attr]
    assert "/bms/soc" in names(policy, "alert_system", "topic", "subscribe")
    assert '<profile ns="/" node="alert_system">' in policy
    assert '<enclave path="/a&amp;b">' in export_policy(TREE, Robot(), "/a&b")


@pytest.fixture
def ops(tmp_path: Path) -> OpsConfig:
    file = tmp_path / "ops.yaml"
    file.write_text(
        "black_box: {folder: boxes, topics: [/scan, '/camera*/info']}\n"
        "server: {allow_publish: [cmd_vel], allow_call: ['/dock*'], allow_offer: [/assist]}\n"
    )
    return read_ops(read_yaml(file))


def test_a_black_box_subscribes_to_its_topics(ops: OpsConfig) -> None:
    subscribed = names(export_policy(TREE, Robot("r1", ops=ops)), "alert_system", "topic", "subscribe")
    assert {"/scan", "/camera*/info", "/r1/bms/soc"} <= set(subscribed)


def test_the_clients_of_a_server_may_read_everything_and_what_was_granted(ops: OpsConfig) -> None:
    policy = export_policy(TREE, Robot("r1", ops=ops))
    assert names(policy, "rosbridge", "topic", "subscribe") == ["/*"]
    assert names(policy, "rosbridge", "topic", "publish") == ["/cmd_vel", "/parameter_events", "/rosout"]
    assert names(policy, "rosbridge", "service", "request") == ["/dock*", "/r1/alert_system/reset"]
    assert "/assist" in names(policy, "rosbridge", "service", "reply")


def test_a_mistake_is_reported_with_its_section() -> None:
    tree = {**TREE, "aggregator": {"ros__parameters": {"methods": "mean"}}}
    with pytest.raises(ConfigError, match=r"^aggregator\.ros__parameters\.methods: unknown key; did you mean method"):
        export_policy(tree, Robot())
