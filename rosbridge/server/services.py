"""Service calls of clients: to rosapi, to other clients and to the middleware."""

from __future__ import annotations

import asyncio
from typing import Any, Dict, List, Mapping, Optional, Protocol, Union

from ...core.values.errors import MessageError, ServiceError
from ..calls import PendingCalls
from ..protocol import Operation
from ..protocol.definitions import service_definition
from ..protocol.operations import ServiceResponse
from .access import Access, matches
from .rosapi import PREFIX, Rosapi
from .served_node import ServedNode

Arguments = Union[Mapping[str, Any], List[Any]]


class Services:
    """The services that clients may call."""

    def __init__(self, node: ServedNode, rosapi: Rosapi, access: Access, timeout_s: float) -> None:
        """Stores the providers; `timeout_s` is the longest wait for a response."""
        self.of_clients = ClientServices()
        self._access = access
        self._node = node
        self._rosapi = rosapi
        self._timeout_s = timeout_s

    async def call(self, service: str, arguments: Arguments, timeout_s: Optional[float]) -> Any:
        """Returns the response to a client's call, within `timeout_s` or, if None, the server's time.

        `/service#id` is accepted too, an older way to send an id. `arguments` are by name or in order. ServiceError: it
        does not exist, may not be called, failed or did not respond in time; MessageError: it does not match its type.
        """
        timeout_s = min(timeout_s or self._timeout_s, self._timeout_s)
        service = self._node.resolve(service.partition("#")[0])
        if service.startswith(PREFIX):
            try:
                return await asyncio.wait_for(self._node.call(self._rosapi.answer, service, arguments), timeout_s)
            except asyncio.TimeoutError:
                raise _no_response(service, timeout_s) from None
        if not matches(service, self._access.services):
            raise ServiceError(f"clients may not call {service}")
        type_name = self.of_clients.types.get(service, "")
        request = _by_name(service, type_name, arguments)
        call = self.of_clients.call if type_name else self._node.call_service
        return await call(service, request, timeout_s)


class Provider(Protocol):
    """A client that provides services."""

    def send(self, operation: Operation) -> None:
        """Sends an operation to the client."""


class ClientServices:
    """The services that clients provide to other clients, and the calls that wait for a response."""

    def __init__(self) -> None:
        """Starts without services."""
        self.types: Dict[str, str] = {}
        """Type per service."""
        self._providers: Dict[str, Provider] = {}
        self._pending = PendingCalls()

    def add(self, service: str, type_name: str, provider: Provider) -> None:
        """Routes calls of a service to a client, in place of an earlier provider."""
        self.types[service] = type_name
        self._providers[service] = provider

    def remove(self, service: str, provider: Provider) -> None:
        """Removes a service of this client; its pending calls fail."""
        if self._providers.get(service) is provider:
            del self._providers[service], self.types[service]
        self._pending.fail(ServiceError(f"the provider of {service} disconnected"), service, provider)

    async def call(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Any:
        """Calls a service of a client; raises ServiceError if it failed, disconnected or did not respond in time."""
        provider = self._providers.get(service)
        if provider is None:
            raise ServiceError(f"no service {service}")
        return await self._pending.call(provider.send, provider, service, request, timeout_s)

    def respond(self, response: ServiceResponse, provider: Provider) -> None:
        """Processes a response. Ignores one that is not expected, or not from this client."""
        self._pending.receive(response, provider, str(response.values))


def _no_response(service: str, timeout_s: float) -> ServiceError:
    return ServiceError(f"{service} did not respond within {timeout_s:g} s")


def _by_name(service: str, type_name: str, arguments: Arguments) -> Mapping[str, Any]:
    """Returns the fields of a request by name; those of a list in the order of the service's definition."""
    if isinstance(arguments, Mapping):
        return arguments
    if not arguments:
        return {}
    if len(arguments) == 1 and isinstance(arguments[0], dict):
        return arguments[0]
    for definition in service_definition(type_name, response=False).values():
        names = [field.name for field in definition.fields]
        if len(arguments) <= len(names):
            return dict(zip(names, arguments))
    raise MessageError(f"the arguments of {service} must be given by name")
