"""Service calls of clients: to rosapi, to other clients and to the middleware."""

from __future__ import annotations

import asyncio
from typing import Any, Mapping, Protocol

from ...core.values import JsonObject, MessageError, ServiceError
from ...runtime.access import matches
from ..calls import PendingCalls
from ..protocol.operations import Arguments
from . import rosapi
from .served_node import ServedNode


class Provider(Protocol):
    """A client that provides services."""

    def send(self, operation: JsonObject) -> None:
        """Sends an operation to the client."""


class Services:
    """The services that clients may call: rosapi, those of other clients, and those of the middleware."""

    def __init__(self, node: ServedNode) -> None:
        """Adds those of rosapi to a node."""
        self._providers: dict[str, Provider] = {}
        self.pending = PendingCalls()
        """Calls that wait for the response of a provider."""
        self._node = node
        node.added_services.update(rosapi.SERVICES)

    async def call(self, service: str, arguments: Arguments, timeout_s: float | None) -> Any:
        """Returns the response to a client's call, within `timeout_s` or, if None, the server's time.

        `/service#id` is accepted too, an older way to send an id. Raises ServiceError if the service does not exist,
        may not be called, failed or did not respond in time, MessageError if the arguments do not match its type.
        """
        longest_s = self._node.limits.call_timeout_s
        timeout_s = min(timeout_s or longest_s, longest_s)
        service = self._node.resolve(service.partition("#")[0])
        request = arguments or {}
        if isinstance(request, list) and len(request) == 1:
            request = request[0]
        if not isinstance(request, Mapping):
            raise MessageError(f"the arguments of {service} must be given by name")
        if service.startswith(rosapi.PREFIX):
            try:
                return await asyncio.wait_for(self._node.call(rosapi.answer, self._node, service, request), timeout_s)
            except asyncio.TimeoutError:
                raise ServiceError(f"{service} did not respond within {timeout_s:g} s") from None
        if not matches(service, self._node.access.services):
            raise ServiceError(f"clients may not call {service}")
        provider = self._providers.get(service)
        if provider is None:
            return await self._node.call_service(service, request, timeout_s)
        return await self.pending.call(provider.send, provider, service, request, timeout_s)

    def add(self, service: str, type_name: str, provider: Provider) -> None:
        """Routes calls of a service to a client, in place of an earlier provider."""
        self._node.added_services[service] = type_name
        self._providers[service] = provider

    def remove(self, service: str, provider: Provider) -> None:
        """Removes a service of this client; its pending calls fail."""
        if self._providers.get(service) is provider:
            del self._providers[service], self._node.added_services[service]
        self.pending.fail(ServiceError(f"the provider of {service} disconnected"), service, provider)
