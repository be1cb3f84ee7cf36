"""The limits for one peer, and the error for messages that exceed one or are not valid rosbridge."""

from __future__ import annotations

from typing import NamedTuple, Union

from ...core.values import MessageError

Id = Union[str, int, None]
"""Identifies an operation; None if the peer gave no id."""


class Limits(NamedTuple):
    """Limits for one connection, and of a server. What a peer makes grow is bounded, and refused, never shortened."""

    message_bytes: int = 1_000_000
    """Size of a received message."""
    nesting: int = 64
    """Nesting depth of lists and objects."""
    containers: int = 50_000
    """Lists and objects in a received message."""
    subscriptions: int = 1_000
    """Subscriptions of one client."""
    advertisements: int = 100
    """Topics and services that one client advertises."""
    calls: int = 100
    """Pending service calls of one client."""
    queue_bytes: int = 1_000_000
    """Memory of the messages that wait to be sent to one client."""
    encoding_bytes: int = 8_000_000
    """Estimated size of the messages of a topic that wait to be encoded."""
    sent_bytes: int = 16_000_000
    """Estimated size of a message to be sent; larger ones are dropped."""
    waiting_bytes: int = 16_000_000
    """Estimated size of the messages of ROS that wait for the server's event loop."""
    clients: int = 500
    """Most open connections of a server."""
    heartbeat_s: float = 10.0
    """Period of pings in s; a client that does not answer within half of it is disconnected."""
    request_timeout_s: float = 10.0
    """Time for a connection to send a request, in s."""
    call_timeout_s: float = 10.0
    """Longest service call, in s."""
    slow_client_timeout_s: float = 10.0
    """A client whose messages have been waiting for this long is disconnected, in s."""


DEFAULT_LIMITS = Limits()


class ProtocolError(MessageError):
    """A message that is not valid rosbridge or exceeds a limit. `str()` is one line."""
