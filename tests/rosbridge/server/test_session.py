"""What one client may request, over real sockets in front of a local bus."""

from __future__ import annotations

from typing import Any

from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.rosbridge.protocol import Limits
from robot_health_monitor.runtime.access import Access

EVERYTHING = Access(publish=("*",), services=("*",), offer=("*",))


@with_robot()
async def test_an_unexpected_error_is_one_line_and_the_session_continues(robot: Robot) -> None:
    def fail(*arguments: Any, **options: Any) -> Any:
        raise RuntimeError("unexpected\ntraceback")

    robot.server._node.middleware.subscribe = fail  # type: ignore[method-assign]
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/battery_level")
        assert (await peer.receive())["msg"] == "internal error"
        await peer.settle()
    assert robot.log == ["an operation of a client failed: RuntimeError: unexpected traceback"]


@with_robot(EVERYTHING, limits=Limits(subscriptions=3, calls=2, advertisements=2))
async def test_requests_of_one_client_are_limited(robot: Robot) -> None:
    async with robot.peer() as peer, robot.peer() as other:
        await peer.send("set_level", level="error")
        for number in range(4):
            await peer.send("subscribe", topic="/battery_level", id=number)
        status = await peer.receive()
        assert (status["msg"], status["id"]) == ("subscribe: more than 3 subscriptions", 3)
        await peer.send("advertise_service", service="/slow", type="std_srvs/Trigger")
        await peer.send("advertise", topic="/one", type=FLOAT32)
        await peer.send("advertise", topic="/two", type=FLOAT32)
        assert (await peer.receive())["msg"] == "advertise: more than 2 topics and services"
        await peer.settle()
        for number in range(3):
            await other.send("call_service", service="/slow", id=number)
        response = await other.receive()
        assert (response["id"], response["result"], response["values"]) == (2, False, "more than 2 calls are pending")


@with_robot()
async def test_a_large_response_is_sent_as_requested(robot: Robot) -> None:
    for number in range(1000):
        robot.node.advertise(f"/topic_{number}_{'x' * 100}", FLOAT32)
    async with robot.peer(max_msg_size=0) as peer:
        for options, op in (
            ({}, "service_response"),
            ({"compression": "png"}, "service_response"),  # without images
            ({"fragment_size": 9999}, "service_response"),  # as whole
        ):
            await peer.send("call_service", service="/rosapi/topics", **options)
            assert (await peer.receive())["op"] == op
