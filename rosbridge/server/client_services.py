"""Services that clients provide to other clients."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any, Dict, Mapping, Protocol, Tuple

from robot_health_monitor.core.errors import ServiceError

from ..protocol import Id, Operation
from ..protocol.operations import CallService, ServiceResponse


class Provider(Protocol):
    """A client that provides services."""

    def send(self, operation: Operation) -> None:
        """Sends an operation to the client."""


class ClientServices:
    """The services of all clients, and the calls that wait for a response."""

    def __init__(self) -> None:
        """Starts without services."""
        self.types: Dict[str, str] = {}
        """Type per service."""
        self._providers: Dict[str, Provider] = {}
        self._pending: Dict[Id, Tuple[str, Provider, asyncio.Future[Any]]] = {}
        self._numbers = itertools.count()

    def add(self, service: str, type_name: str, provider: Provider) -> None:
        """Routes calls of a service to a client, in place of an earlier provider."""
        self.types[service] = type_name
        self._providers[service] = provider

    def remove(self, service: str, provider: Provider) -> None:
        """Removes a service of this client; its pending calls fail."""
        if self._providers.get(service) is provider:
            del self._providers[service], self.types[service]
        for name, called, future in tuple(self._pending.values()):
            if name == service and called is provider and not future.done():
                future.set_exception(ServiceError(f"the provider of {service} disconnected"))

    async def call(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Any:
        """Calls a service of a client and returns the response.

        Raises:
            ServiceError: the call failed, the client disconnected or did not respond in time.
        """
        provider = self._providers.get(service)
        if provider is None:
            raise ServiceError(f"no service {service}")
        id = f"call:{next(self._numbers)}"  # noqa: A001 - the protocol's word
        future: asyncio.Future[Any] = asyncio.get_event_loop().create_future()
        self._pending[id] = (service, provider, future)
        try:
            provider.send(CallService(service, request, id))
            return await asyncio.wait_for(future, timeout_s)
        except asyncio.TimeoutError:
            raise ServiceError(f"{service} did not respond within {timeout_s:g} s") from None
        finally:
            del self._pending[id]

    def respond(self, response: ServiceResponse, provider: Provider) -> None:
        """Processes a response. Ignores one that is not expected, or not from this client."""
        pending = self._pending.get(response.id)
        if pending is None or pending[1] is not provider or pending[2].done():
            return
        if response.result:
            pending[2].set_result(response.values)
        else:
            pending[2].set_exception(ServiceError(str(response.values)))
