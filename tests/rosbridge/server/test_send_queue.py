from __future__ import annotations

from typing import Any, List

from robot_health_monitor.rosbridge.server.send_queue import Outbox


class SlowTransport:
    """A transport whose buffer empties when the test says so; a real one cannot be stopped at a byte."""

    def __init__(self) -> None:
        self.buffered = 0
        self.written: List[bytes] = []

    def write(self, data: bytes) -> None:
        self.written.append(bytes(data))
        self.buffered += len(data)

    def get_write_buffer_size(self) -> int:
        return self.buffered


def outbox(bound: int, high_water: int = 10) -> Any:
    transport = SlowTransport()
    return transport, Outbox(transport, bound, high_water)  # type: ignore[arg-type]


def test_frames_go_straight_through_while_the_transport_takes_them() -> None:
    transport, box = outbox(100)
    assert box.put(b"one") is False
    assert box.put(b"two") is False
    assert transport.written == [b"one", b"two"]
    assert not box.behind


def test_frames_wait_in_order_when_the_transport_is_full() -> None:
    transport, box = outbox(100)
    box.put(b"x" * 11)
    assert box.put(b"a") is True
    transport.buffered = 0
    assert box.put(b"b") is True  # never before one that waits
    box.flush()
    assert b"".join(transport.written[1:]) == b"ab"
    assert not box.behind and box.dropped == 0


def test_beyond_the_bound_the_oldest_are_dropped_and_counted() -> None:
    transport, box = outbox(6)
    box.put(b"x" * 11)
    for frame in (b"aa", b"bb", b"cc", b"dd", b"ee"):
        box.put(frame)
    assert box.dropped == 2
    transport.buffered = 0
    box.flush()
    assert b"".join(transport.written[1:]) == b"ccddee"


def test_a_frame_that_is_larger_than_the_bound_does_not_wait() -> None:
    transport, box = outbox(6)
    box.put(b"x" * 11)
    box.put(b"y" * 7)
    assert box.dropped == 1
    assert box.behind
    transport.buffered = 0
    assert not box.behind


def test_flushing_stops_where_the_transport_is_full_again() -> None:
    transport, box = outbox(1000)
    box.put(b"x" * 11)
    for _ in range(10):
        box.put(b"12345")
    transport.buffered = 0
    box.flush()
    assert box.behind
    assert transport.written[1:] == [b"12345" * 3]
