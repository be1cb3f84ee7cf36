from __future__ import annotations

import asyncio
from typing import Any, List

import pytest

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.rosbridge.protocol.operations import CallService, ServiceResponse
from robot_health_monitor.rosbridge.server.client_services import ClientServices


class Client:
    def __init__(self) -> None:
        self.sent: List[Any] = []

    def send(self, operation: Any) -> None:
        self.sent.append(operation)


async def start_call(services: ClientServices, timeout_s: float = 20.0) -> asyncio.Future[Any]:
    call = asyncio.ensure_future(services.call("/dock", {"x": 1}, timeout_s))
    await asyncio.sleep(0)
    return call


def test_a_call_goes_to_the_provider_and_its_response_to_the_caller() -> None:
    async def scenario() -> None:
        services, provider, other = ClientServices(), Client(), Client()
        services.add("/dock", "some_srvs/Dock", provider)
        call = await start_call(services)
        (request,) = provider.sent
        assert request == CallService("/dock", {"x": 1}, request.id)
        services.respond(ServiceResponse("/dock", {"ok": False}, True, request.id), other)
        services.respond(ServiceResponse("/dock", {"ok": False}, True, "unknown"), provider)
        services.respond(ServiceResponse("/dock", {"ok": True}, True, request.id), provider)
        services.respond(ServiceResponse("/dock", {"ok": False}, True, request.id), provider)
        assert await call == {"ok": True}

    asyncio.run(scenario())


def test_a_failed_call_a_lost_provider_and_a_missing_response_are_service_errors() -> None:
    async def scenario() -> None:
        services, provider = ClientServices(), Client()
        services.add("/dock", "some_srvs/Dock", provider)
        call = await start_call(services)
        services.respond(ServiceResponse("/dock", "jammed", False, provider.sent[0].id), provider)
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
    services, first, second = ClientServices(), Client(), Client()
    services.add("/dock", "some_srvs/Dock", first)
    services.add("/dock", "some_srvs/Dock", second)
    services.remove("/dock", first)
    assert services.types == {"/dock": "some_srvs/Dock"}
    services.remove("/dock", second)
    assert services.types == {}
