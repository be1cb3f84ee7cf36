"""The limits for one peer. Everything that a peer can make grow is bounded here."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["DEFAULT_LIMITS", "Limits"]


class Limits(NamedTuple):
    """Limits for one connection. What exceeds a limit is refused, never shortened."""

    message_bytes: int = 1_000_000
    """Size of a received message, before and after its fragments are joined."""
    first_message_bytes: int = 4_096
    """Size of the first message of a client that has not presented the token."""
    name_chars: int = 512
    """Length of the name of a topic, service, action or type, and of an id."""
    nesting: int = 64
    """Nesting depth of lists and objects."""
    containers: int = 50_000
    """Lists and objects in a received message."""
    partial_messages: int = 16
    """Incomplete fragmented messages at the same time."""
    fragments: int = 10_000
    """Fragments of one message."""
    fragment_chars: int = 256
    """Smallest `fragment_size` that a peer may request: each fragment costs about 100 bytes more."""
    fragment_timeout_s: float = 60.0
    """An incomplete message is dropped this long after its last fragment, in s."""
    subscriptions: int = 1_000
    """Subscriptions of one client."""
    advertisements: int = 100
    """Topics and services that one client advertises."""
    calls: int = 100
    """Pending service calls of one client."""
    queue_messages: int = 10_000
    """Largest `queue_length` of a subscription; a larger one counts as this."""
    queue_bytes: int = 1_000_000
    """Memory of the messages that wait for one client: those to be sent, and those held back by `throttle_rate`."""
    encoding_bytes: int = 8_000_000
    """Estimated size of the messages of a topic that wait to be encoded, per encoding."""
    sent_bytes: int = 16_000_000
    """Estimated size of a message to be sent; larger ones are dropped."""


DEFAULT_LIMITS = Limits()
