"""The size of a request that is not complete."""

from __future__ import annotations

import asyncio
from typing import Any, List, Optional

from robot_health_monitor.rosbridge.server.request_size import MOST_REQUEST_BYTES, SizeLimitedProtocol


class Recorder:
    """The protocol behind: records every event."""

    def __init__(self) -> None:
        self.events: List[Any] = []

    def __getattr__(self, name: str) -> Any:
        def record(*arguments: Any) -> bool:
            self.events.append((name, *arguments))
            return True

        return record


class Connection:
    def __init__(self) -> None:
        self.since_s: Optional[float] = 5.0
        self.behind = Recorder()
        self.excesses = 0
        self.protocol = SizeLimitedProtocol(self.behind, lambda: self.since_s, self.note_excess)

    def note_excess(self) -> None:
        self.excesses += 1

    def passed(self) -> int:
        return sum(len(data) for name, data in self.behind.events if name == "data_received")


def test_what_a_waiting_connection_sends_is_limited_in_sum() -> None:
    connection = Connection()
    for _ in range(2):
        connection.protocol.data_received(bytes(MOST_REQUEST_BYTES // 2))
    assert (connection.excesses, connection.passed()) == (0, MOST_REQUEST_BYTES)
    connection.protocol.data_received(b"x")
    assert (connection.excesses, connection.passed()) == (1, MOST_REQUEST_BYTES)


def test_every_request_counts_anew() -> None:
    connection = Connection()
    connection.protocol.data_received(bytes(MOST_REQUEST_BYTES))
    connection.since_s = 6.0
    connection.protocol.data_received(bytes(MOST_REQUEST_BYTES))
    assert connection.excesses == 0


def test_a_connection_that_has_presented_its_request_is_not_limited() -> None:
    connection = Connection()
    connection.since_s = None
    for _ in range(3):
        connection.protocol.data_received(bytes(MOST_REQUEST_BYTES))
    assert (connection.excesses, connection.passed()) == (0, 3 * MOST_REQUEST_BYTES)


def test_every_event_reaches_the_protocol_behind() -> None:
    connection = Connection()
    transport, error = asyncio.Transport(), OSError()
    connection.protocol.connection_made(transport)
    connection.protocol.pause_writing()
    connection.protocol.resume_writing()
    assert connection.protocol.eof_received() is True
    connection.protocol.connection_lost(error)
    assert connection.behind.events == [
        ("connection_made", transport),
        ("pause_writing",),
        ("resume_writing",),
        ("eof_received",),
        ("connection_lost", error),
    ]
