"""Publishing by clients, over real sockets in front of a local bus."""

from __future__ import annotations

import math
from typing import Any, List

from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.rosbridge.server.access import Access, monitor_access
from robot_health_monitor.rosbridge.server.publications import MOST_TOPICS

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


@with_robot(monitor_access("/alert_system"))
async def test_subscribing_to_a_topic_does_not_open_it_for_publishing(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/battery_level")
        for op, fields in (("advertise", {"type": FLOAT32}), ("publish", {"msg": {"data": 0.0}})):
            await peer.send(op, topic="/battery_level", id="p", **fields)
            status = await peer.receive()
            assert (status["msg"], status["id"]) == ("advertise: clients may not publish on /battery_level", "p")


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

    robot.server._middleware.graph = fail  # type: ignore[method-assign]
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("advertise", topic="/in", type=FLOAT32, id="a")
        assert (await peer.receive())["msg"] == "advertise: the ROS master does not respond"
        await peer.settle()


@with_robot(Access(publish=("*",)), limits=Limits(advertisements=2_000))
async def test_clients_cannot_invent_any_number_of_topics(robot: Robot) -> None:
    """Each is advertised on the robot, and stays so when the client has left."""
    async with robot.peer() as peer:
        for number in range(MOST_TOPICS):
            await peer.send("advertise", topic=f"/invented{number}", type=FLOAT32)
        await peer.settle()
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("advertise", topic="/one_more", type=FLOAT32, id="a")
        assert (await peer.receive())["msg"] == "advertise: clients have advertised 1000 topics already"
        await peer.send("advertise", topic="/invented7", type=FLOAT32)
        await peer.settle()
    assert len(robot.bus.types) == 1 + MOST_TOPICS
