from __future__ import annotations

import asyncio

from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.rosbridge.server.graph import ServedGraph
from robot_health_monitor.rosbridge.server.node_access import NodeAccess


def test_the_servers_topics_and_services_are_added_to_the_middlewares() -> None:
    async def scenario() -> None:
        bus = LocalBus()
        robot, server = bus.node("robot"), bus.node("rosbridge")
        robot.advertise("/battery_level", "std_msgs/Float32")
        robot.advertise_service("~reset", "std_srvs/Trigger", lambda request: {})
        node = NodeAccess(asyncio.get_event_loop(), threads=False)
        graph = ServedGraph(server, node, lambda: {"/offered": "std_srvs/SetBool"}, adds_rosout=True)
        found = graph.read()
        assert found.topics == {"/battery_level": "std_msgs/Float32", "/rosout": "rosgraph_msgs/Log"}
        assert found.services == {"/robot/reset": "std_srvs/Trigger", "/offered": "std_srvs/SetBool"}
        assert list(found.nodes["/rosbridge"].publishes) == ["/rosout"]
        assert list(found.nodes["/rosbridge"].services) == ["/offered"]
        assert await graph.topic_type("battery_level") == "std_msgs/Float32"
        assert await graph.topic_type("/unknown") == ""
        assert await graph.has_service("/robot/reset") and not await graph.has_service("/offered")
        assert "/rosout" not in ServedGraph(server, node, dict, adds_rosout=False).read().topics

    asyncio.run(scenario())


def test_definitions_that_the_middleware_lacks_are_known_here() -> None:
    async def scenario() -> None:
        node = NodeAccess(asyncio.get_event_loop(), threads=False)
        graph = ServedGraph(LocalBus().node("rosbridge"), node, dict, adds_rosout=True)
        assert await graph.message_definition("std_msgs/Float32") == "float32 data\n"
        assert await graph.message_definition("nav_msgs/Odometry") == ""
        assert await graph.message_definition("") == ""

    asyncio.run(scenario())
