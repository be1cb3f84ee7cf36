"""How much one peer may ask of this process. Everything that a peer can make grow has its bound here."""

from __future__ import annotations

from typing import NamedTuple


class Limits(NamedTuple):
    """Bounds for one connection; what is beyond them is refused, never shortened."""

    message_bytes: int = 1_000_000
    """Largest message, as it arrives, after its fragments are joined and after it is unpacked."""
    name_chars: int = 512
    """Longest name of a topic, service, action or type, and longest id."""
    nesting: int = 64
    """Deepest nesting of lists and mappings."""
    integer_digits: int = 400
    """Longest whole number; the time that Python takes to read one grows with the square of its length."""
    partial_messages: int = 16
    """Messages whose fragments are incomplete, at the same time."""
    fragments: int = 10_000
    """Fragments of one message."""
    fragment_timeout_s: float = 60.0
    """An incomplete message is dropped this long after its last fragment, in s."""
    subscriptions: int = 1_000
    """Subscriptions of one client."""
    advertisements: int = 100
    """Topics and services together that one client offers."""
    calls: int = 100
    """Service calls of one client that wait for their answer at the same time."""
    queue_messages: int = 100_000
    """Longest `queue_length` of a subscription; a longer one counts as this."""


DEFAULT_LIMITS = Limits()
