"""Service calls of clients: to rosapi, to other clients and to the middleware."""

from __future__ import annotations

import asyncio
from typing import Any, List, Mapping, Optional, Union

from robot_health_monitor.core.errors import MessageError, ServiceError
from robot_health_monitor.core.middleware import ServedMiddleware

from ..protocol.definitions import service_definition
from .access import Access
from .client_services import ClientServices
from .graph import ServedGraph
from .node_access import NodeAccess
from .rosapi import PREFIX, Rosapi

Arguments = Union[Mapping[str, Any], List[Any]]


class Services:
    """The services that clients may call."""

    def __init__(
        self,
        middleware: ServedMiddleware,
        node: NodeAccess,
        graph: ServedGraph,
        rosapi: Rosapi,
        access: Access,
        timeout_s: float,
    ) -> None:
        """Stores the providers.

        Args:
            middleware: the served node, which calls services.
            node: access to it.
            graph: resolves names.
            rosapi: always open.
            access: services that clients may call and provide.
            timeout_s: longest wait for a response, in s.
        """
        self.of_clients = ClientServices()
        self.access = access
        self._middleware = middleware
        self._node = node
        self._graph = graph
        self._rosapi = rosapi
        self._timeout_s = timeout_s

    async def call(self, service: str, arguments: Arguments, timeout_s: Optional[float]) -> Any:
        """Calls a service for a client and returns the response.

        Args:
            service: its name; `/service#id` is accepted too, an older way to send an id.
            arguments: the fields of the request, by name or in order.
            timeout_s: longest wait in s; None: that of the server.

        Raises:
            ServiceError: the service does not exist, may not be called, failed or did not respond in time.
            MessageError: the request does not match its type.
        """
        timeout_s = min(timeout_s or self._timeout_s, self._timeout_s)
        service = self._graph.resolve(service.partition("#")[0])
        if service.startswith(PREFIX):
            return await self._ask_rosapi(service, arguments, timeout_s)
        if not self.access.may_call(service):
            raise ServiceError(f"clients may not call {service}")
        type_name = self.of_clients.types.get(service, "")
        request = _by_name(service, type_name, arguments)
        if type_name:
            return await self.of_clients.call(service, request, timeout_s)
        return await self._node.call_service(
            self._middleware.call_service, service, "", request, timeout_s, timeout_s=timeout_s
        )

    async def _ask_rosapi(self, service: str, arguments: Arguments, timeout_s: float) -> Mapping[str, Any]:
        try:
            return await asyncio.wait_for(self._node.call(self._rosapi.answer, service, arguments), timeout_s)
        except asyncio.TimeoutError:
            raise ServiceError(f"{service} did not respond within {timeout_s:g} s") from None


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
