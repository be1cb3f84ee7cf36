"""Subscriptions at servers of this project and at others."""

from __future__ import annotations

import math
from typing import Any

from harness.rosbridge_client import ForeignServer, Watched, scenario, until
from harness.rosbridge_peer import FLOAT32, Robot, with_robot

SUBSCRIPTION = {"op": "subscribe", "topic": "/odom", "id": "subscribe:/odom", "compression": "none"}


@scenario
async def test_with_a_foreign_server_it_is_plain_json_with_ros_1s_names() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/battery_level", "std_msgs/msg/Float32", watched.hear, field="data")
        await until(lambda: len(foreign.received) == 1)
        assert foreign.received == [
            {
                "op": "subscribe",
                "topic": "/battery_level",
                "type": "std_msgs/Float32",
                "id": "subscribe:/battery_level",
                "compression": "none",
            },
        ]
        for text in (
            '{"op": "publish", "topic": "/battery_level", "msg": {"data": null}}',
            '{"op": "status", "level": "info", "msg": "hello"}',
            '{"op": "publish", "topic": "/other", "msg": {"data": 1.0}}',
            "not JSON at all",
            '{"op": "publish", "topic": "/battery_level", "msg": {"data": 19.5}}',
        ):
            await foreign.sockets[0].send_str(text)
        await until(lambda: len(watched.heard) == 2)
        assert math.isnan(watched.heard[0]) and watched.heard[1] == 19.5
        assert watched.ups == [True]
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_the_type_of_a_topic_is_requested_until_it_is_published() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/odom", "", watched.hear, field=None)
        await until(lambda: sum(fields["op"] == "call_service" for fields in foreign.received) >= 1)
        assert all(fields["op"] != "subscribe" for fields in foreign.received)
        foreign.types["/odom"] = "nav_msgs/msg/Odometry"
        await until(lambda: foreign.received[-1]["op"] == "subscribe")
        assert foreign.received[-1]["type"] == "nav_msgs/Odometry"
        await foreign.publish("/odom", {})
        await until(lambda: watched.heard == [1.0])
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_without_rosapi_a_subscription_without_a_type_is_tried_until_messages_come() -> None:
    foreign = ForeignServer()
    foreign.rosapi = False
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/odom", "", watched.hear, field=None)
        await until(lambda: foreign.received.count(SUBSCRIPTION) >= 2)
        await foreign.publish("/odom", {})
        await until(lambda: watched.heard == [1.0])
        assert not watched.client.connection.subscriptions._topics["/odom"].lacks
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_an_invalid_type_does_not_end_the_search() -> None:
    foreign = ForeignServer()
    answers: Any = foreign.types
    answers["/odom"] = ["nav_msgs/Odometry"]
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/odom", "", watched.hear, field=None)
        await until(lambda: len(foreign.received) >= 2)
        answers["/odom"] = "nav_msgs/Odometry"
        await until(lambda: foreign.received[-1]["op"] == "subscribe")
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_receivers_of_one_topic_share_a_subscription_until_the_last_one_leaves() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    try:
        await until(lambda: watched.ups == [True])
        both = [watched.node.subscribe("/odom", "nav_msgs/Odometry", watched.hear, field=None) for _ in range(2)]
        await watched.settle()
        watched.node.unsubscribe(both[0])
        await watched.settle()
        watched.node.unsubscribe(both[1])
        await watched.settle()
        operations = [fields["op"] for fields in foreign.received]
        assert operations == ["subscribe", "call_service", "call_service", "unsubscribe", "call_service"]
    finally:
        await watched.close()
        await foreign.close()


@with_robot()
async def test_a_large_message_is_not_decoded_where_only_its_arrival_counts(robot: Robot) -> None:
    """Shown by one that cannot be decoded: its end is missing."""
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/points", "sensor_msgs/PointCloud2", watched.hear, field=None)
        await until(lambda: watched.ups == [True])
        await foreign.sockets[0].send_str('{"op": "publish", "topic": "/points", "msg": {"data": "' + "A" * 10_000)
        await until(lambda: watched.heard == [1.0])
        watched.node.subscribe("/points", "sensor_msgs/PointCloud2", watched.hear, field="width")
        await foreign.publish("/points", {"width": 640, "data": "A" * 10_000})
        await until(lambda: watched.heard == [1.0, 1.0, 640])
        assert not watched.problems()
    finally:
        await watched.close()
        await foreign.close()


@with_robot()
async def test_with_this_projects_server_a_topic_needs_no_type(robot: Robot) -> None:
    watched = Watched(robot.url)
    watched.node.subscribe("/battery_level", "", watched.hear, field="data")
    await robot.until(lambda: watched.ups == [True])
    await watched.settle()
    robot.publish(float("inf"))
    await robot.until(lambda: watched.heard == [float("inf")])
    await watched.close()
    assert robot.bus.graph().topics["/battery_level"] == FLOAT32
