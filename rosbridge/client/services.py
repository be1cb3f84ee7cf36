"""Services over one connection: calls of the server's services, and answers to calls of services offered here."""

from __future__ import annotations

import asyncio
import itertools
import threading
from typing import Any, Callable, Dict, Mapping, Optional, Tuple

from robot_health_monitor.core.errors import LinkError, MessageError, ServiceError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.middleware import canonical_type

from ..protocol import Id, Operation, operations

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]

_LONGEST_ERROR = 200


class ServiceCalls:
    """Calls of the server's services that wait for their response. Used in the event loop only."""

    def __init__(self, send: Callable[[Operation], None], down: Callable[[], Optional[str]]) -> None:
        """Starts without calls.

        Args:
            send: sends an operation.
            down: returns why the connection is down; None: it is up.
        """
        self._send = send
        self._down = down
        self._waiting: Dict[Id, asyncio.Future[Any]] = {}
        self._numbers = itertools.count()

    async def call(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Mapping[str, Any]:
        """Calls a service and returns its response.

        Args:
            service: its name.
            request: the fields.
            timeout_s: how long to wait for the response, in s.

        Raises:
            LinkError: the connection is down, or went down during the call.
            ServiceError: the service failed or did not answer in time.
        """
        down = self._down()
        if down is not None:
            raise LinkError(f"{service} was not called: {down}")
        id = f"call:{next(self._numbers)}"  # noqa: A001 - the protocol's own word
        future: asyncio.Future[Any] = asyncio.get_event_loop().create_future()
        self._waiting[id] = future
        try:
            self._send(operations.CallService(service, request, id))
            values = await asyncio.wait_for(future, timeout_s)
        except asyncio.TimeoutError:
            raise ServiceError(f"{service} did not answer within {timeout_s:g} s") from None
        finally:
            del self._waiting[id]
        return values if isinstance(values, dict) else {}

    def receive(self, response: operations.ServiceResponse) -> None:
        """Ends the call that a response belongs to; any other response is ignored."""
        future = self._waiting.get(response.id)
        if future is None or future.done():
            return
        if response.result:
            future.set_result(response.values)
        else:
            reason = printable(str(response.values)[:_LONGEST_ERROR])
            future.set_exception(ServiceError(f"{printable(response.service)} failed: {reason}"))

    def fail_all(self, cause: str) -> None:
        """Ends every call because the connection went down."""
        for future in self._waiting.values():
            if not future.done():
                future.set_exception(LinkError(cause))


class OfferedServices:
    """Services that nodes on this side offer. `add` and `remove` may be called from any thread."""

    def __init__(self, send: Callable[[Operation], None]) -> None:
        """Starts without services.

        Args:
            send: sends an operation; drops it while the connection is down.
        """
        self._send = send
        self._lock = threading.RLock()
        self._services: Dict[str, Tuple[str, Handler]] = {}

    def add(self, service: str, type_name: str, handler: Handler) -> None:
        """Offers a service.

        Args:
            service: its name.
            type_name: its type.
            handler: called in the event loop with the request; returns the response, or raises ServiceError.
        """
        with self._lock:
            self._services[service] = canonical_type(type_name), handler
            self._send(operations.AdvertiseService(service, canonical_type(type_name)))

    def remove(self, service: str) -> None:
        """Ends an `add`."""
        with self._lock:
            if self._services.pop(service, None) is not None:
                self._send(operations.UnadvertiseService(service))

    def send_all(self) -> None:
        """Offers every service on a new connection."""
        with self._lock:
            for service, (type_name, _) in self._services.items():
                self._send(operations.AdvertiseService(service, type_name))

    def answer(self, request: operations.CallService) -> None:
        """Sends the response to a request."""
        _, handler = self._services.get(request.service, ("", None))
        arguments = request.args if isinstance(request.args, dict) else {}
        values: object = "this service is not offered here"
        answered = False
        if handler is not None:
            try:
                values, answered = dict(handler(arguments)), True
            except (ServiceError, MessageError) as error:
                values = str(error)
        self._send(operations.ServiceResponse(request.service, values, answered, request.id))
