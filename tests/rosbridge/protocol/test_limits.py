from __future__ import annotations

from robot_health_monitor.core.values.errors import MessageError
from robot_health_monitor.rosbridge.protocol.limits import DEFAULT_LIMITS, ProtocolError


def test_the_limits_are_those_of_the_documentation() -> None:
    """docs/bridges.md lists them."""
    limits = DEFAULT_LIMITS
    assert (limits.clients, limits.request_timeout_s, limits.slow_client_timeout_s) == (500, 10.0, 10.0)
    assert (limits.message_bytes, limits.containers, limits.nesting) == (1_000_000, 50_000, 64)
    assert (limits.queue_bytes, limits.sent_bytes) == (1_000_000, 16_000_000)
    assert (limits.subscriptions, limits.calls, limits.advertisements) == (1_000, 100, 100)


def test_an_invalid_message_is_a_message_error() -> None:
    assert issubclass(ProtocolError, MessageError)
