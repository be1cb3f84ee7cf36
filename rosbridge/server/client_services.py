"""Services that clients offer to one another through the server."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any, Dict, Mapping, Protocol, Tuple

from ..protocol import CallService, Operation, ServiceResponse
from ..protocol.errors import Id


class Provider(Protocol):
    """A client that answers requests."""

    def send(self, operation: Operation) -> None:
        """Sends it an operation."""


class Offers:
    """Who offers what, and which requests wait for their answer."""

    def __init__(self) -> None:
        """Starts with none."""
        self.types: Dict[str, str] = {}
        """Type per service."""
        self._providers: Dict[str, Provider] = {}
        self._waiting: Dict[Id, Tuple[str, Provider, asyncio.Future[Any]]] = {}
        self._numbers = itertools.count()

    def offer(self, service: str, type_name: str, provider: Provider) -> None:
        """Gives requests for a service to a client from now on; an earlier provider is replaced."""
        self.types[service] = type_name
        self._providers[service] = provider

    def withdraw(self, service: str, provider: Provider) -> None:
        """Ends an offer, if it is this client's; its requests that wait fail."""
        if self._providers.get(service) is provider:
            del self._providers[service], self.types[service]
        for name, waiting_for, future in tuple(self._waiting.values()):
            if name == service and waiting_for is provider and not future.done():
                future.set_exception(ValueError(f"the provider of {service} has left"))

    async def call(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Any:
        """Asks the client that offers a service.

        Raises:
            ValueError: it answered with a failure, or left.
            asyncio.TimeoutError: it did not answer in time.
        """
        provider = self._providers[service]
        id = f"call:{next(self._numbers)}"  # noqa: A001 - the protocol's own word
        future: asyncio.Future[Any] = asyncio.get_event_loop().create_future()
        self._waiting[id] = (service, provider, future)
        try:
            provider.send(CallService(service, request, id))
            return await asyncio.wait_for(future, timeout_s)
        except asyncio.TimeoutError:
            raise ValueError(f"{service} did not answer within {timeout_s:g} s") from None
        finally:
            del self._waiting[id]

    def answer(self, response: ServiceResponse, provider: Provider) -> None:
        """Takes a client's answer; one that nobody waits for, or that is another client's to give, is ignored."""
        waiting = self._waiting.get(response.id)
        if waiting is None or waiting[1] is not provider or waiting[2].done():
            return
        if response.result:
            waiting[2].set_result(response.values)
        else:
            waiting[2].set_exception(ValueError(str(response.values)))
