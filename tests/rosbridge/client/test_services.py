"""Service calls in both directions, and why a topic brings no samples."""

from __future__ import annotations

import asyncio
from typing import Any, Mapping

import pytest
from harness.rosbridge_client import ForeignServer, Watched, scenario, until
from harness.rosbridge_peer import Robot, with_robot

from robot_health_monitor.core.values.errors import LinkError, ServiceError
from robot_health_monitor.rosbridge.client.topics import PublisherLookup
from robot_health_monitor.runtime.access import Access

EVERYTHING = Access(publish=("*",), services=("*",), offer=("*",))


@scenario
async def test_a_call_while_the_connection_is_down_is_a_link_error() -> None:
    watched = Watched("ws://127.0.0.1:1")
    with pytest.raises(LinkError, match=r"/rosapi/get_time was not called: no connection to ws://127"):
        await watched.call("/rosapi/get_time")
    await watched.close()


@scenario
async def test_a_connection_that_is_lost_during_a_call_is_a_link_error() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    await until(lambda: watched.ups == [True])

    async def lose(socket: Any) -> None:
        await socket.close()

    call = asyncio.ensure_future(watched.client.connection.call("/slow", {"topic": "/x"}, 10.0))
    foreign.types["/x"] = ""
    await foreign.sockets[0].close()
    with pytest.raises(LinkError, match="went down"):
        await call
    await watched.close()
    await foreign.close()


@with_robot()
async def test_a_service_that_fails_is_a_service_error_with_its_reason(robot: Robot) -> None:
    watched = Watched(robot.url)
    await robot.until(lambda: watched.ups == [True])
    with pytest.raises(ServiceError, match="/no_such_service failed: "):
        await watched.call("/no_such_service")
    await watched.close()


@scenario
async def test_a_service_that_does_not_answer_is_a_service_error() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    await until(lambda: watched.ups == [True])
    silent = {"op": "call_service", "service": "/slow"}

    def swallow(response: object, peer: object, problem: str) -> None:
        pass

    watched.client.connection._calls.receive = swallow  # type: ignore[method-assign]
    with pytest.raises(ServiceError, match=r"/slow did not respond within 0\.2 s"):
        await watched.client.connection.call("/slow", {}, 0.2)
    await until(lambda: any(fields["op"] == silent["op"] for fields in foreign.received))
    await watched.close()
    await foreign.close()


FLOAT32 = "std_msgs/Float32"


class Rosapi:
    """Answers of a server; a missing service fails."""

    def __init__(self, topics: Mapping[str, str], publishers: Mapping[str, list[str]]) -> None:
        self.calls: list[tuple[str, Mapping[str, Any]]] = []
        self.running = self.most_running = 0
        self.topics: Any = {"topics": list(topics), "types": list(topics.values())}
        self.publishers: dict[str, Any] = dict(publishers)
        self.error: Exception | None = None

    async def __call__(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Mapping[str, Any]:
        self.calls.append((service, request))
        self.running += 1
        self.most_running = max(self.running, self.most_running)
        await asyncio.sleep(0)
        self.running -= 1
        if self.error is not None:
            raise self.error
        if service == "/rosapi/topics":
            return self.topics  # type: ignore[no-any-return]
        return {"publishers": self.publishers.get(request["topic"], [])}


async def answer_of(rosapi: Rosapi, topic: str, type_name: str = FLOAT32) -> str | None:
    answers: list[str | None] = []
    PublisherLookup(rosapi).look_up(topic, type_name, answers.append)
    await until(lambda: bool(answers))
    return answers[0]


@scenario
async def test_the_types_and_publishers_of_the_server_give_the_reason() -> None:
    topics = {"/battery": "sensor_msgs/msg/Temperature", "/fan": "", "/battery_state": "sensor_msgs/BatteryState"}
    rosapi = Rosapi(topics, {"/battery": ["/driver"], "/fan": ["/driver"], "/battery_state": ["/driver"]})
    text = "/battery is published as sensor_msgs/Temperature, configured as std_msgs/Float32"
    assert await answer_of(rosapi, "/battery") == text
    assert await answer_of(rosapi, "/battery", "sensor_msgs/Temperature") is None
    assert await answer_of(rosapi, "/battery", "") is None
    assert await answer_of(rosapi, "/fan") is None
    assert await answer_of(rosapi, "/batery") == "no publisher on /batery; /battery exists"
    assert await answer_of(rosapi, "/none") == "no publisher on /none"


@scenario
async def test_a_similar_topic_without_a_publisher_is_not_meant() -> None:
    """The list of topics also has those that have only subscribers."""
    rosapi = Rosapi({"/battery_1": FLOAT32}, {"/battery_1": ["/driver"]})
    assert await answer_of(rosapi, "/battery") == "no publisher on /battery; /battery_1 exists"
    rosapi.publishers = {}
    assert await answer_of(rosapi, "/battery") == "no publisher on /battery"


@scenario
async def test_questions_are_asked_one_after_the_other() -> None:
    rosapi = Rosapi({}, {})
    lookup, answers = PublisherLookup(rosapi), []  # type: ignore[var-annotated]
    for number in range(20):
        lookup.look_up(f"/topic_{number}", FLOAT32, answers.append)
    await until(lambda: len(answers) == 20)
    assert rosapi.most_running == 1
    assert [service for service, _ in rosapi.calls] == ["/rosapi/topics"] + ["/rosapi/publishers"] * 20


@pytest.mark.parametrize("error", [ServiceError("no such service"), LinkError("down")])
def test_a_server_that_fails_gives_no_reason_and_is_asked_once_for_all_topics(error: Exception) -> None:
    @scenario
    async def test() -> None:
        rosapi = Rosapi({}, {})
        rosapi.error = error
        lookup, answers = PublisherLookup(rosapi), []  # type: ignore[var-annotated]
        for number in range(20):
            lookup.look_up(f"/topic_{number}", FLOAT32, answers.append)
        await until(lambda: len(answers) == 20)
        assert set(answers) == {None}
        assert len(rosapi.calls) == 1
        rosapi.error = None
        lookup.look_up("/battery", FLOAT32, answers.append)
        await until(lambda: len(answers) == 21)
        assert answers[20] == "no publisher on /battery"

    test()


@pytest.mark.parametrize(
    "topics", [{}, {"topics": "/battery"}, {"topics": ["/battery"]}, {"topics": [["/b"], 7], "types": [None, {}]}]
)
def test_a_server_that_answers_nonsense_is_survived(topics: Any) -> None:
    @scenario
    async def test() -> None:
        rosapi = Rosapi({}, {"/fan": 7})  # type: ignore[dict-item]
        rosapi.topics = topics
        assert await answer_of(rosapi, "/battery") == "no publisher on /battery"
        assert await answer_of(rosapi, "/fan") is None

    test()


@scenario
async def test_a_server_without_rosapi_gives_no_reason() -> None:
    foreign = ForeignServer()
    foreign.rosapi = False
    watched = Watched(await foreign.start())
    await until(lambda: watched.ups == [True])
    assert watched.node.why_silent("battery", FLOAT32) is None
    await until(lambda: any(each["op"] == "call_service" for each in foreign.received))
    assert [each["service"] for each in foreign.received if each["op"] == "call_service"] == ["/rosapi/topics"]
    assert watched.node.why_silent("battery", FLOAT32) is None
    assert watched.problems() == []
    await watched.close()
    await foreign.close()


@scenario
async def test_a_server_that_does_not_answer_delays_nothing() -> None:
    foreign = ForeignServer()
    foreign.types["/battery"] = FLOAT32
    watched = Watched(await foreign.start())
    await until(lambda: watched.ups == [True])
    watched.client.connection._calls.receive = lambda response, peer, problem: None  # type: ignore[method-assign]
    assert watched.node.why_silent("battery", FLOAT32) is None
    await until(lambda: any(each["op"] == "call_service" for each in foreign.received))
    watched.node.subscribe("battery", FLOAT32, watched.hear, field="data")
    await until(lambda: any(each["op"] == "subscribe" for each in foreign.received))
    await foreign.publish("/battery", {"data": 50.0})
    await until(lambda: watched.heard == [50.0])
    await watched.close()
    await foreign.close()
