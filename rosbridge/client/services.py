"""Calls of the server's services."""

from __future__ import annotations

from typing import Any, Awaitable, Callable, Mapping, Optional

from ...core.values.errors import LinkError
from ...core.values.formatting import printable
from ..calls import PendingCalls
from ..protocol import Operation, operations

Call = Callable[[str, Mapping[str, Any], float], Awaitable[Mapping[str, Any]]]
"""Calls a service of the server: name, request, time limit in s."""

_LONGEST_ERROR = 200


class ServiceCalls:
    """Calls of the server's services that wait for their response. Used in the event loop only."""

    def __init__(self, send: Callable[[Operation], None], down: Callable[[], Optional[str]]) -> None:
        """Starts without calls; `down` returns why the connection is down, None while it is up."""
        self._send = send
        self._down = down
        self._pending = PendingCalls()

    async def call(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Mapping[str, Any]:
        """Returns the response of a service.

        Raises LinkError if the connection is or went down, and ServiceError if the service failed, or did not respond
        within `timeout_s`.
        """
        down = self._down()
        if down is not None:
            raise LinkError(f"{service} was not called: {down}")
        values = await self._pending.call(self._send, None, service, request, timeout_s)
        return values if isinstance(values, dict) else {}

    def receive(self, response: operations.ServiceResponse) -> None:
        """Ends the call that a response belongs to; any other response is ignored."""
        reason = printable(str(response.values)[:_LONGEST_ERROR])
        self._pending.receive(response, None, f"{printable(response.service)} failed: {reason}")

    def fail_all(self, cause: str) -> None:
        """Ends every call because the connection went down."""
        self._pending.fail(LinkError(cause))
