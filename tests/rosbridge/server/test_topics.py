"""Subscriptions of clients, over real sockets in front of a local bus."""

from __future__ import annotations

import asyncio
import math
from typing import Any, List

from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.core.values.errors import ConfigError, ServiceError
from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.rosbridge.server.access import Access
from robot_health_monitor.rosbridge.server.topics import MOST_PUBLISHED


def subscriptions(robot: Robot) -> List[str]:
    return list(robot.bus.graph().nodes["/rosbridge"].subscribes)


@with_robot()
async def test_a_topic_is_subscribed_to_once_whatever_the_number_of_clients(robot: Robot) -> None:
    async with robot.peer() as one:
        async with robot.peer() as other:
            await one.subscribe("/battery_level")
            await other.subscribe("/battery_level", compression="cbor")
            assert subscriptions(robot) == ["/battery_level"]
        await robot.until(lambda: robot.server.clients == 1)
        robot.publish(1.0)
        assert await one.receive_many(1) == [1.0]


@with_robot()
async def test_a_wrong_type_is_refused_and_the_connection_continues(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/battery_level", type="std_msgs/String", id="s1")
        assert await peer.receive() == {
            "op": "status",
            "level": "error",
            "msg": "subscribe: type of /battery_level: expected std_msgs/Float32, got std_msgs/String",
            "id": "s1",
        }
        await peer.subscribe("/battery_level", type=FLOAT32)
        await peer.send("subscribe", topic="/battery_level", type="std_msgs/String", id="s2")
        assert "expected std_msgs/Float32" in (await peer.receive())["msg"]
        robot.publish(1.0)
        assert await peer.receive_many(1) == [1.0]


@with_robot()
async def test_while_the_master_is_down_subscribing_is_refused_and_no_client_is_disconnected(robot: Robot) -> None:
    served = robot.server._parts.node.middleware
    graph = served.graph

    def fail() -> Any:
        raise ServiceError("the ROS master does not respond")

    async with robot.peer() as peer, robot.peer() as reader:
        await reader.subscribe("/battery_level")
        served.graph = fail  # type: ignore[method-assign]
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/later", type=FLOAT32, id="s")
        assert (await peer.receive())["msg"] == "subscribe: the ROS master does not respond"
        response = await peer.call("/rosapi/topics")
        assert (response["result"], response["values"]) == (False, "the ROS master does not respond")
        robot.publish(1.0)
        assert await reader.receive_many(1) == [1.0]
        served.graph = graph  # type: ignore[method-assign]
        await peer.subscribe("/battery_level")
        robot.publish(2.0)
        assert await peer.receive_many(1) == [2.0]


@with_robot()
async def test_a_subscription_that_the_middleware_refuses_leaves_nothing_behind(robot: Robot) -> None:
    def refuse(*arguments: Any, **options: Any) -> Any:
        raise ConfigError("unknown type no_msgs/Type")

    robot.server._parts.node.middleware.subscribe = refuse  # type: ignore[method-assign]
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/later", type="no_msgs/Type", id="s")
        assert await peer.receive() == {
            "op": "status",
            "level": "error",
            "msg": "subscribe: unknown type no_msgs/Type",
            "id": "s",
        }
        assert robot.server._parts.topics._topics == {}


@with_robot()
async def test_clients_that_come_and_go_at_once_leave_the_topic_as_the_last_one_wants_it(robot: Robot) -> None:
    async with robot.peer() as stays:
        for _ in range(5):
            async with robot.peer() as leaves:
                await asyncio.gather(
                    leaves.send("subscribe", topic="/battery_level"),
                    stays.send("subscribe", topic="/battery_level", id="a"),
                    stays.send("unsubscribe", topic="/battery_level", id="a"),
                )
        await stays.settle()
        await robot.until(lambda: subscriptions(robot) == [])


OPEN = Access(publish=("/in",))


@with_robot(OPEN)
async def test_null_is_published_as_nan(robot: Robot) -> None:
    heard: List[float] = []
    robot.node.subscribe("/in", FLOAT32, lambda value, now_s: heard.append(value), field="data")
    async with robot.peer() as peer:
        await peer.send("advertise", topic="/in", type=FLOAT32)
        await peer.send("publish", topic="/in", msg={"data": None})
        await peer.send("publish", topic="/in", msg={"data": 1.0})
        await robot.until(lambda: len(heard) == 2)
    assert math.isnan(heard[0]) and heard[1] == 1.0


@with_robot(Access(services=("*",)))
async def test_subscribing_to_a_topic_does_not_open_it_for_publishing(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/battery_level")
        for op, fields in (("advertise", {"type": FLOAT32}), ("publish", {"msg": {"data": 0.0}})):
            await peer.send(op, topic="/battery_level", id="p", **fields)
            status = await peer.receive()
            assert (status["msg"], status["id"]) == (f"{op}: clients may not publish on /battery_level", "p")


@with_robot(OPEN)
async def test_a_relative_name_is_the_same_topic(robot: Robot) -> None:
    heard: List[float] = []
    robot.node.subscribe("/in", FLOAT32, lambda value, now_s: heard.append(value), field="data")
    async with robot.peer() as peer:
        await peer.send("advertise", topic="in", type=FLOAT32)
        await peer.send("publish", topic="in", msg={"data": 2.0})
        await robot.until(lambda: heard == [2.0])


@with_robot(OPEN)
async def test_while_the_master_is_down_publishing_is_refused_and_the_connection_continues(robot: Robot) -> None:
    def fail() -> Any:
        raise ServiceError("the ROS master does not respond")

    robot.server._parts.node.middleware.graph = fail  # type: ignore[method-assign]
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("advertise", topic="/in", type=FLOAT32, id="a")
        assert (await peer.receive())["msg"] == "advertise: the ROS master does not respond"
        await peer.settle()


@with_robot(Access(publish=("*",)), limits=Limits(advertisements=2_000))
async def test_clients_cannot_invent_any_number_of_topics(robot: Robot) -> None:
    """Each is advertised on the robot, and stays so when the client has left."""
    async with robot.peer() as peer:
        for number in range(MOST_PUBLISHED):
            await peer.send("advertise", topic=f"/invented{number}", type=FLOAT32)
        await peer.settle()
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("advertise", topic="/one_more", type=FLOAT32, id="a")
        assert (await peer.receive())["msg"] == "advertise: clients have advertised 1000 topics already"
        await peer.send("advertise", topic="/invented7", type=FLOAT32)
        await peer.settle()
    assert len(robot.bus.types) == 1 + MOST_PUBLISHED
