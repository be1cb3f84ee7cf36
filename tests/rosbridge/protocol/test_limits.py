from __future__ import annotations

from robot_health_monitor.rosbridge.protocol.limits import DEFAULT_LIMITS


def test_a_message_in_the_smallest_fragments_is_within_the_limits_of_a_receiver() -> None:
    assert DEFAULT_LIMITS.message_bytes <= DEFAULT_LIMITS.fragments * DEFAULT_LIMITS.fragment_chars
