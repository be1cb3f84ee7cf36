"""What a server's rosapi knows of its topics."""

from __future__ import annotations

import asyncio
from typing import Any, Mapping

import pytest

from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.rosbridge.client.topics import find_definition, list_topics
from robot_health_monitor.runtime.bridge.node import KnownTopic


def listed(answers: Mapping[str, Any]) -> list[KnownTopic]:
    async def call(service: str, request: Mapping[str, Any], timeout_s: float) -> dict[str, Any]:
        if service not in answers:
            raise ServiceError(f"no service {service}")
        return dict(answers[service])

    return asyncio.run(list_topics(call))


RAW = "/rosapi/topics_and_raw_types"


def test_topics_have_their_type_and_its_definition() -> None:
    answer = {"topics": ["/a"], "types": ["std_msgs/msg/Float32"], "typedefs_full_text": ["float32 data"]}
    assert listed({RAW: answer}) == [KnownTopic("/a", "std_msgs/Float32", "float32 data")]


def test_an_old_rosapi_knows_no_definitions() -> None:
    answer = {"topics": ["/a", "/b"], "types": ["std_msgs/Float32", ""]}
    assert listed({"/rosapi/topics": answer}) == [KnownTopic("/a", "std_msgs/Float32", ""), KnownTopic("/b", "", "")]


def test_a_server_without_rosapi_is_an_error() -> None:
    with pytest.raises(ServiceError):
        listed({})


@pytest.mark.parametrize("answer", [{}, {"topics": 3, "types": 4}, {"topics": ["/a"]}, {"topics": [1], "types": [2]}])
def test_answers_of_another_form_are_no_topics(answer: Any) -> None:
    assert listed({RAW: answer}) == []


def test_the_number_of_topics_is_bounded() -> None:
    answer = {"topics": [f"/t{number}" for number in range(20_000)], "types": ["std_msgs/Empty"] * 20_000}
    assert len(listed({RAW: answer})) == 10_000


def defined(type_name: str, typedefs: Any) -> str:
    async def call(service: str, request: Mapping[str, Any], timeout_s: float) -> dict[str, Any]:
        assert (service, request) == ("/rosapi/message_details", {"type": type_name})
        return {"typedefs": typedefs}

    return asyncio.run(find_definition(call, type_name))


def typedef(type_name: str, *fields: Any) -> Any:
    names, kinds, lengths = zip(*fields)
    return {"type": type_name, "fieldnames": list(names), "fieldtypes": list(kinds), "fieldarraylen": list(lengths)}


def test_a_definition_is_put_together_from_its_details() -> None:
    found = defined(
        "acme_msgs/Arm",
        [
            typedef("acme_msgs/Arm", ("stamp", "time", -1), ("joints", "acme_msgs/Joint", 0), ("limits", "float64", 6)),
            typedef("acme_msgs/Joint", ("name", "string", -1)),
        ],
    )
    separator = "=" * 80
    assert found == (
        f"time stamp\nacme_msgs/Joint[] joints\nfloat64[6] limits\n{separator}\nMSG: acme_msgs/Joint\nstring name\n"
    )


def test_ros_2_names_slots_and_some_types_as_idl_does() -> None:
    """As rosapi/objectutils.py of rosbridge_suite answers on ROS 2."""
    fields = [("_ok", "boolean", -1), ("_x", "double", -1), ("_raw", "octet", 0), ("_check_fields", "boolean", -1)]
    found = defined("acme_msgs/msg/Arm", [typedef("acme_msgs/Arm", *fields, ("_id", "string<12>", -1))])
    assert found == "bool ok\nfloat64 x\nbyte[] raw\nstring id\n"


@pytest.mark.parametrize(
    "typedefs",
    [
        None,
        3,
        [3],
        [{"type": 3}],
        [{"type": "acme_msgs/Arm"}],
        [{"type": "acme_msgs/Arm", "fieldnames": [1, "a\nb"], "fieldtypes": [1, "x"], "fieldarraylen": [-1, -1]}],
    ],
)
def test_details_of_another_form_are_no_definition(typedefs: Any) -> None:
    assert defined("acme_msgs/Arm", typedefs) == ""
