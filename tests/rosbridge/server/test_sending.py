from __future__ import annotations

import json
from typing import Any

import cbor2
import pytest
from harness.slow_transport import SlowTransport

from robot_health_monitor.core.values.errors import MessageError
from robot_health_monitor.rosbridge.server import sending
from robot_health_monitor.rosbridge.server.sending import (
    LARGE_BYTES,
    ClientQueue,
    estimated_bytes,
    frame,
    publication,
)


def payload(frame: bytes) -> bytes:
    """The payload of a short frame (RFC 6455, section 5.2)."""
    assert frame[1] < 126 and len(frame) == 2 + frame[1]
    return frame[2:]


def test_json_and_cbor_carry_the_same_operation() -> None:
    expected = {"op": "publish", "topic": "/a", "msg": {"data": 19.5}}
    assert json.loads(payload(publication("/a", {"data": 19.5}, "none"))) == expected
    assert cbor2.loads(payload(publication("/a", {"data": 19.5}, "cbor"))) == expected


def test_raw_bytes_come_from_the_middleware_or_from_the_serializer() -> None:
    for raw in (
        publication("/a", b"\x01\x02", "cbor-raw"),
        publication("/a", {"data": 1}, "cbor-raw", lambda message: b"\x01\x02"),
    ):
        assert cbor2.loads(payload(raw))["msg"]["bytes"] == b"\x01\x02"
    with pytest.raises(MessageError, match="definition of its type is not known"):
        publication("/a", {"data": 1}, "cbor-raw")


def test_a_message_that_cannot_be_encoded_is_a_message_error() -> None:
    for compression in ("none", "cbor"):
        with pytest.raises(MessageError):
            publication("/a", {"data": object()}, compression)


@pytest.mark.parametrize(
    "message",
    [
        {"data": "x" * 1_000_000},
        {"data": b"x" * 1_000_000},
        {"header": {"seq": 1}, "ranges": [0.5] * 10_000},
        {"status": [{"values": [{"key": "k" * 50, "value": "v" * 50}] * 20}] * 100},
        {"names": ["n" * 100] * 1_000},
    ],
)
def test_large_messages_are_recognised(message: Any) -> None:
    assert estimated_bytes(message) > LARGE_BYTES


@pytest.mark.parametrize("message", [{"data": 19.5}, {"data": "x" * 1_000}, {"ranges": [0.5] * 360}, {}, b""])
def test_small_messages_are_encoded_at_once(message: Any) -> None:
    assert estimated_bytes(message) < LARGE_BYTES


@pytest.mark.parametrize("size", [1_000, 1_000_000])
def test_the_estimate_follows_the_length_of_texts(size: int) -> None:
    assert size <= estimated_bytes({"data": "x" * size}) <= size + 1_000


def test_every_element_of_a_short_list_counts() -> None:
    assert estimated_bytes(["", "x" * 1_000_000, "", "", ""]) > 1_000_000


@pytest.mark.parametrize(
    ("message", "header"),
    [
        ("Hello", b"\x81\x05"),  # the example of RFC 6455, section 5.7
        ("", b"\x81\x00"),
        (b"\x01" * 125, b"\x82\x7d"),
        (b"\x01" * 126, b"\x82\x7e\x00\x7e"),
        (b"\x01" * 256, b"\x82\x7e\x01\x00"),  # the same section
        (b"\x01" * 65536, b"\x82\x7f\x00\x00\x00\x00\x00\x01\x00\x00"),  # and again
    ],
)
def test_frames_are_those_of_the_rfc(message: object, header: bytes) -> None:
    assert isinstance(message, (str, bytes))
    payload = message.encode() if isinstance(message, str) else message
    assert frame(message) == header + payload


def test_text_is_sent_as_utf_8() -> None:
    assert frame("\N{DEGREE SIGN}C") == b"\x81\x03\xc2\xb0C"


@pytest.fixture(autouse=True)
def _low_water(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "HIGH_WATER", 10)


def send_queue(bound: int) -> Any:
    transport = SlowTransport()
    return transport, ClientQueue(transport, bound)  # type: ignore[arg-type]


def test_frames_go_straight_through_while_the_transport_takes_them() -> None:
    transport, queue = send_queue(100)
    assert queue.put(b"one") is False
    assert queue.put(b"two") is False
    assert transport.written == [b"one", b"two"]
    assert not queue.behind


def test_frames_wait_in_order_when_the_transport_is_full() -> None:
    transport, queue = send_queue(100)
    transport.buffered = 11
    assert queue.put(b"a") is True
    transport.buffered = 0
    assert queue.put(b"b") is True  # never before one that waits
    queue.flush()
    assert b"".join(transport.written) == b"ab"
    assert not queue.behind and queue.dropped == 0


def test_beyond_the_bound_the_oldest_are_dropped_and_counted() -> None:
    transport, queue = send_queue(6)
    transport.buffered = 11
    for data in (b"aa", b"bb", b"cc", b"dd", b"ee"):
        queue.put(data)
    assert queue.dropped == 2
    transport.buffered = 0
    queue.flush()
    assert b"".join(transport.written) == b"ccddee"


def test_a_frame_larger_than_the_bound_waits_alone_and_is_written_in_pieces() -> None:
    transport, queue = send_queue(6)
    transport.buffered = 11
    queue.put(b"first")
    queue.put(b"y" * 25)
    assert queue.dropped == 1
    for _ in range(4):
        transport.buffered = 0
        queue.flush()
    assert transport.written == [b"y" * 10, b"y" * 10, b"y" * 5]
    assert not queue.behind


def test_a_frame_that_was_sent_in_part_is_completed() -> None:
    transport, queue = send_queue(12)
    queue.put(b"a" * 11 + b"b" * 11)  # larger than a piece
    queue.put(b"12345")
    queue.put(b"67890")
    queue.put(b"last")
    while queue.behind:
        transport.buffered = 0
        queue.flush()
    assert b"".join(transport.written) == b"a" * 11 + b"b" * 11 + b"67890last"
    assert queue.dropped == 1


def test_the_bytes_that_wait_are_bounded_whatever_is_put(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sending, "HIGH_WATER", 100)
    transport, queue = send_queue(1000)
    for number in range(500):
        queue.put(b"x" * (7 * number % 450))
        assert queue._frames.size + len(queue._rest) <= 1000 + 450 and transport.buffered <= 200
        transport.buffered //= 2
        queue.flush()


def test_a_cleared_queue_holds_nothing() -> None:
    transport, queue = send_queue(100)
    transport.buffered = 11
    queue.put(b"abc")
    queue.clear()
    transport.buffered = 0
    queue.flush()
    assert transport.written == []
    assert not queue.behind


def test_flushing_stops_where_the_transport_is_full_again() -> None:
    transport, queue = send_queue(1000)
    transport.buffered = 11
    for _ in range(10):
        queue.put(b"12345")
    transport.buffered = 0
    queue.flush()
    assert queue.behind
    assert transport.written == [b"12345"] * 3  # with 0, 5 and 10 bytes in the buffer, not with 15


def test_nothing_more_is_written_once_the_connection_has_broken() -> None:
    transport, queue = send_queue(1000)
    transport.buffered = 11
    for _ in range(10):
        queue.put(b"123456789")
    transport.buffered, transport.breaks = 0, True
    queue.flush()
    assert transport.written == [b"123456789"]
