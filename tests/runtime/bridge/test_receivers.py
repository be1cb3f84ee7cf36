"""What a subscription over a bridge reports of messages that cannot be read."""

from __future__ import annotations

from typing import Any

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.runtime.bridge.receivers import BridgeReceiver


class Scan(BridgeReceiver):
    topic = "/scan"
    active = True
    largest_bytes = 1_000_000

    def __init__(self, node: Any) -> None:
        self._node = node


def test_messages_that_are_too_large_are_one_fault_until_one_can_be_read_or_the_end() -> None:
    node = LocalBus().node("watcher")
    scan = Scan(node)
    for size_bytes in (3_000_000, 2_540_000):
        scan.too_large(size_bytes)
    (fault,) = node.faults.current().values()
    assert (fault.level, fault.text) == (Level.WARN, "dropped 2 messages, the last of 2.5 MB (limit 1.0 MB)")
    scan.note_readable()
    assert not node.faults.current()
    scan.too_large(2_000_000)
    scan.end()
    assert (scan.active, scan.dropped, dict(node.faults.current())) == (False, 3, {})


def test_a_message_that_does_not_match_its_type_is_logged_once_on_one_line() -> None:
    bus = LocalBus()
    scan = Scan(bus.node("watcher"))
    for text in ("4 bytes\nleft", "8 bytes left"):
        scan.note_mismatch(ValueError(text))
    lines: list[str] = [line.text for line in bus.log_lines]
    assert len(lines) == 1
    assert lines[0].startswith("/scan: a message does not match its type: 4 bytes") and lines[0].isprintable()
