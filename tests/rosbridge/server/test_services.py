"""Service calls of clients, over real sockets in front of a local bus."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest
from harness.rosbridge_peer import Robot, with_robot

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import LinkError, ServiceError
from robot_health_monitor.rosbridge.protocol import Limits
from robot_health_monitor.rosbridge.protocol.operations import ServiceResponse
from robot_health_monitor.rosbridge.server.served_node import ServedNode
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.rosbridge.server.services import Services
from robot_health_monitor.runtime.access import Access


@with_robot(Access(offer=("/offered",)))
async def test_calling_a_service_of_another_client_needs_permission(robot: Robot) -> None:
    async with robot.peer() as provider, robot.peer() as caller:
        await provider.send("advertise_service", service="/offered", type="std_srvs/Trigger")
        await provider.settle()
        response = await caller.call("/offered")
        assert (response["result"], response["values"]) == (False, "clients may not call /offered")


@with_robot(Access(offer=("*",), services=("*",)))
async def test_a_client_cannot_replace_a_service_of_the_robot(robot: Robot) -> None:
    robot.node.advertise_service("~reset", "std_srvs/Trigger", lambda request: {"success": True, "message": "robot"})
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        for service in ("/robot/reset", "/rosapi/topics"):
            await peer.send("advertise_service", service=service, type="std_srvs/Trigger")
        assert (await peer.receive())["msg"] == "advertise_service: /robot/reset exists already"
        assert (await peer.call("/robot/reset"))["values"]["message"] == "robot"
        assert "topics" in (await peer.call("/rosapi/topics"))["values"]


@with_robot(Access(services=("/robot/re*",)))
async def test_a_service_that_matches_is_open(robot: Robot) -> None:
    robot.node.advertise_service("~reset", "std_srvs/Trigger", lambda request: {"success": True, "message": "done"})
    async with robot.peer() as peer:
        assert (await peer.call("/robot/reset"))["values"] == {"success": True, "message": "done"}
        assert (await peer.call("/robot/reset#7"))["result"] is True
        assert (await peer.call("/robot/shutdown"))["values"] == "clients may not call /robot/shutdown"


@pytest.mark.parametrize("error", [ServiceError("jammed"), ValueError("jammed"), LinkError("jammed"), KeyError("x")])
def test_a_call_that_fails_in_any_way_is_answered(error: Exception) -> None:
    @with_robot(Access(services=("*",)))
    async def scenario(robot: Robot) -> None:
        def fail(*arguments: Any) -> Any:
            raise error

        robot.server._node.middleware.call_service = fail  # type: ignore[method-assign]
        async with robot.peer() as peer:
            response = await peer.call("/dock")
            assert response["result"] is False
            assert str(error) in response["values"]
            await peer.settle()

    scenario()


@with_robot(Access(services=("*",)))
async def test_a_response_that_cannot_be_encoded_is_a_failed_call(robot: Robot) -> None:
    robot.server._node.middleware.call_service = lambda *arguments: {"x": object()}  # type: ignore[method-assign]
    async with robot.peer() as peer:
        response = await peer.call("/dock")
        assert (response["result"], response["values"]) == (False, "object cannot be encoded as JSON")


def test_the_timeout_of_a_call_reaches_the_middleware_once() -> None:
    async def scenario() -> None:
        node = LocalBus().node("rosbridge")
        seen: list[float] = []
        released = threading.Event()

        def call_service(service: str, type_name: str, request: Any, timeout_s: float) -> dict[str, Any]:
            seen.append(timeout_s)
            if service == "/hangs":
                released.wait(20.0)
            return {}

        node.call_service = call_service  # type: ignore[method-assign]
        server = Server(node, port=0, access=Access(services=("*",)), limits=Limits(call_timeout_s=2.0))
        await server.start()
        await server.services.call("/dock", {}, 0.5)
        await server.services.call("/dock", {}, None)
        await server.services.call("/dock", {}, 60.0)
        assert seen == [0.5, 2.0, 2.0]
        with pytest.raises(ServiceError, match=r"no response within 0\.1 s"):
            await server.services.call("/hangs", {}, 0.1)
        released.set()
        await asyncio.wait_for(server.close(), 20.0)

    asyncio.run(scenario())


@with_robot(Access(services=("*",)))
async def test_arguments_are_given_by_name(robot: Robot) -> None:
    robot.node.advertise_service("~set", "std_srvs/SetBool", lambda request: {"success": request["data"]})
    async with robot.peer() as peer:
        for args in ({"data": True}, [{"data": True}]):
            assert (await peer.call("/robot/set", args))["values"] == {"success": True}
        for args in ([True], [{}, {}]):
            response = await peer.call("/robot/set", args)
            assert (response["result"], response["values"]) == (
                False,
                "the arguments of /robot/set must be given by name",
            )


class Client:
    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, operation: Any) -> None:
        self.sent.append(operation)


def of_clients() -> Services:
    """The services of a server without clients."""
    return Services(ServedNode(LocalBus().node("rosbridge"), threads=True, access=Access(services=("*",))))


def respond(services: Services, response: ServiceResponse, provider: Client) -> None:
    services.pending.receive(response, provider, str(response.values))


async def start_call(services: Services, timeout_s: float = 20.0) -> asyncio.Future[Any]:
    call = asyncio.ensure_future(services.call("/dock", {"x": 1}, timeout_s))
    await asyncio.sleep(0)
    return call


def test_a_call_goes_to_the_provider_and_its_response_to_the_caller() -> None:
    async def scenario() -> None:
        services, provider, other = of_clients(), Client(), Client()
        services.add("/dock", "some_srvs/Dock", provider)
        call = await start_call(services)
        (request,) = provider.sent
        assert request == {"op": "call_service", "service": "/dock", "args": {"x": 1}, "id": request["id"]}
        respond(services, ServiceResponse("/dock", {"ok": False}, True, request["id"]), other)
        respond(services, ServiceResponse("/dock", {"ok": False}, True, "unknown"), provider)
        respond(services, ServiceResponse("/dock", {"ok": True}, True, request["id"]), provider)
        respond(services, ServiceResponse("/dock", {"ok": False}, True, request["id"]), provider)
        assert await call == {"ok": True}

    asyncio.run(scenario())


def test_a_failed_call_a_lost_provider_and_a_missing_response_are_service_errors() -> None:
    async def scenario() -> None:
        services, provider = of_clients(), Client()
        services.add("/dock", "some_srvs/Dock", provider)
        call = await start_call(services)
        respond(services, ServiceResponse("/dock", "jammed", False, provider.sent[0]["id"]), provider)
        with pytest.raises(ServiceError, match=r"^jammed$"):
            await call
        call = await start_call(services)
        services.remove("/dock", provider)
        with pytest.raises(ServiceError, match="the provider of /dock disconnected"):
            await call
        with pytest.raises(ServiceError, match="no service /dock"):
            await services.call("/dock", {}, 1.0)
        services.add("/dock", "some_srvs/Dock", provider)
        with pytest.raises(ServiceError, match=r"/dock did not respond within 0\.01 s"):
            await services.call("/dock", {}, 0.01)

    asyncio.run(scenario())


def test_a_service_is_removed_only_by_its_provider() -> None:
    node = ServedNode(LocalBus().node("rosbridge"), threads=True)
    services, first, second = Services(node), Client(), Client()
    services.add("/dock", "some_srvs/Dock", first)
    services.add("/dock", "some_srvs/Dock", second)
    services.remove("/dock", first)
    assert node.added_services["/dock"] == "some_srvs/Dock"
    services.remove("/dock", second)
    assert "/dock" not in node.added_services
