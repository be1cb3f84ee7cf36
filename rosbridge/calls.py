"""Service calls that wait for the response of a peer."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any, Callable

from ..core.values import JsonObject, ServiceError
from .protocol import Id
from .protocol.operations import ServiceResponse


class PendingCalls:
    """The calls that wait, each for one peer. Used in the event loop only."""

    def __init__(self) -> None:
        """Starts without calls."""
        self._waiting: dict[Id, tuple[str, object, asyncio.Future[Any]]] = {}
        self._numbers = itertools.count()

    async def call(
        self,
        send: Callable[[JsonObject], None],
        peer: object,
        service: str,
        request: JsonObject,
        timeout_s: float,
    ) -> Any:
        """Sends a call to a peer, and returns what it responds.

        Raises ServiceError if the service failed or did not respond in time, or what `fail` ended the call with.
        """
        id = f"call:{next(self._numbers)}"  # noqa: A001 - the protocol's own word
        future: asyncio.Future[Any] = asyncio.get_event_loop().create_future()
        self._waiting[id] = service, peer, future
        try:
            send({"op": "call_service", "service": service, "args": request, "id": id})
            return await asyncio.wait_for(future, timeout_s)
        except asyncio.TimeoutError:
            raise ServiceError(f"{service} did not respond within {timeout_s:g} s") from None
        finally:
            del self._waiting[id]

    def receive(self, response: ServiceResponse, peer: object, problem: str) -> None:
        """Ends the call that a response belongs to; ignores one that is not expected, or not from this peer.

        `problem` is the text of the error if the service failed.
        """
        _, called, future = self._waiting.get(response.id, ("", None, None))
        if future is None or called is not peer or future.done():
            return
        if response.result:
            future.set_result(response.values)
        else:
            future.set_exception(ServiceError(problem))

    def fail(self, error: Exception, service: str = "", peer: object = None) -> None:
        """Ends the calls of a service of a peer; of all services, if it is empty."""
        for name, called, future in tuple(self._waiting.values()):
            if not future.done() and service in ("", name) and called is peer:
                future.set_exception(error)
