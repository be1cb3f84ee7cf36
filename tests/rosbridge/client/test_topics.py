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


@pytest.mark.parametrize(
    ("answer", "definition"),
    [
        ({"typedefs": [], "definition": "float32 torque\n"}, "float32 torque\n"),
        ({"typedefs": []}, ""),
        ({"definition": 3}, ""),
        ({"definition": "#" * 200_001}, ""),
    ],
)
def test_this_projects_server_gives_the_definition_as_text(answer: Any, definition: str) -> None:
    async def call(service: str, request: Mapping[str, Any], timeout_s: float) -> Any:
        assert (service, request) == ("/rosapi/message_details", {"type": "acme_msgs/Arm"})
        return answer

    assert asyncio.run(find_definition(call, "acme_msgs/Arm")) == definition
