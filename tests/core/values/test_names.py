"""Names of types, topics and nodes: the examples of ROS's pages on names."""

import pytest

from robot_health_monitor.core.values.names import canonical_type, is_namespace, resolve_name, split_type_name


@pytest.mark.parametrize(
    ("name", "resolved"),
    [("scan", "/carter/scan"), ("/scan", "/scan"), ("~reset", "/carter/alert_system/reset"), ("a/b", "/carter/a/b")],
)
def test_names_are_relative_to_the_namespace_absolute_or_private(name: str, resolved: str) -> None:
    assert resolve_name(name, "/carter/alert_system") == resolved


@pytest.mark.parametrize("spelt", ["std_msgs/Float32", "std_msgs/msg/Float32"])
def test_both_spellings_of_a_type_are_one(spelt: str) -> None:
    assert canonical_type(spelt) == "std_msgs/Float32"
    assert split_type_name(spelt) == ["std_msgs", "Float32"]


@pytest.mark.parametrize("text", ["Float32", "a/b/c", "a/msg/b/c", "a b/c", "", "/"])
def test_other_texts_are_no_types(text: str) -> None:
    assert split_type_name(text) is None


def test_namespaces() -> None:
    assert [is_namespace(text) for text in ("", "carter", "/fleet/carter", "7up", "a//b", "a b")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip
