"""Service calls in both directions."""

from __future__ import annotations

import asyncio
from typing import Any, Mapping

import pytest
from harness.rosbridge_client import ForeignServer, Watched, scenario, until
from harness.rosbridge_peer import Robot, with_robot

from robot_health_monitor.core.errors import LinkError, ServiceError
from robot_health_monitor.rosbridge.server.access import Access

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

    call = asyncio.ensure_future(watched.client.connection.calls.call("/slow", {"topic": "/x"}, 10.0))
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

    def swallow(response: object) -> None:
        pass

    watched.client.connection.calls.receive = swallow  # type: ignore[method-assign]
    with pytest.raises(ServiceError, match=r"/slow did not answer within 0\.2 s"):
        await watched.client.connection.calls.call("/slow", {}, 0.2)
    await until(lambda: any(fields["op"] == silent["op"] for fields in foreign.received))
    await watched.close()
    await foreign.close()


@with_robot(EVERYTHING)
async def test_offered_services_answer_or_fail_with_a_reason(robot: Robot) -> None:
    watched = Watched(robot.url)

    def fail(request: Mapping[str, Any]) -> Mapping[str, Any]:
        raise RuntimeError("no battery")

    watched.node.advertise_service("~echo", "std_srvs/SetBool", lambda request: {"message": str(request["data"])})
    watched.node.advertise_service("~fail", "std_srvs/Trigger", fail)
    await robot.until(lambda: watched.ups == [True])
    await watched.settle()
    assert await robot.server.services.call("/watcher/echo", {"data": True}, None) == {"message": "True"}
    with pytest.raises(Exception, match="RuntimeError in a callback: no battery"):
        await robot.server.services.call("/watcher/fail", {}, None)
    await watched.close()
