"""Service calls of clients: to rosapi, to other clients and to the middleware."""

from __future__ import annotations

import asyncio
from typing import Any, Dict, Mapping, Optional, Protocol

from ...core.values.errors import MessageError, ServiceError
from ..calls import PendingCalls
from ..protocol import Operation
from ..protocol.definitions import service_definition
from ..protocol.operations import Arguments, ServiceResponse
from .access import Access, matches
from .rosapi import PREFIX, Rosapi
from .served_node import ServedNode


class Provider(Protocol):
    """A client that provides services."""

    def send(self, operation: Operation) -> None:
        """Sends an operation to the client."""


class Services:
    """The services that clients may call: rosapi, those of other clients, and those of the middleware."""

    def __init__(self, node: ServedNode, rosapi: Rosapi, access: Access, timeout_s: float) -> None:
        """Stores the providers; `timeout_s` is the longest wait for a response."""
        self.types: Dict[str, str] = {}
        """Type per service that a client provides."""
        self._providers: Dict[str, Provider] = {}
        self._pending = PendingCalls()
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
                raise ServiceError(f"{service} did not respond within {timeout_s:g} s") from None
        if not matches(service, self._access.services):
            raise ServiceError(f"clients may not call {service}")
        provider = self._providers.get(service)
        request = _by_name(service, self.types.get(service, ""), arguments)
        if provider is None:
            return await self._node.call_service(service, request, timeout_s)
        return await self._pending.call(provider.send, provider, service, request, timeout_s)

    def add(self, service: str, type_name: str, provider: Provider) -> None:
        """Routes calls of a service to a client, in place of an earlier provider."""
        self.types[service] = type_name
        self._providers[service] = provider

    def remove(self, service: str, provider: Provider) -> None:
        """Removes a service of this client; its pending calls fail."""
        if self._providers.get(service) is provider:
            del self._providers[service], self.types[service]
        self._pending.fail(ServiceError(f"the provider of {service} disconnected"), service, provider)

    def respond(self, response: ServiceResponse, provider: Provider) -> None:
        """Processes a response. Ignores one that is not expected, or not from this client."""
        self._pending.receive(response, provider, str(response.values))


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
