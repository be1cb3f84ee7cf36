from __future__ import annotations

from typing import List, Optional

from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.rosbridge.protocol.operations import Subscribe
from robot_health_monitor.rosbridge.server.subscriptions import ByteBudget, Options, Pacer, merge, options_of


def test_options_are_read_in_seconds_and_within_the_limits() -> None:
    request = Subscribe("/a", throttle_rate=250.0, queue_length=7, fragment_size=100, compression="png")
    assert options_of(request, Limits()) == Options(0.25, 7, 100, "png")
    assert options_of(request._replace(queue_length=10**9), Limits(queue_messages=50)).queue_length == 50


def test_several_requests_for_a_topic_are_merged_as_the_reference_server_does() -> None:
    requests = [Options(0.5, 10, 200, "none"), Options(0.1, 2, None, "cbor"), Options(1.0, 5, 100, "png")]
    assert merge(requests) == Options(0.1, 2, 100, "cbor")
    assert merge([Options(), Options(compression="cbor-raw"), Options(compression="cbor")]).compression == "cbor-raw"


def sent(pacer: Pacer[str], offers: List[Optional[str]], step_s: float = 0.1) -> List[Optional[str]]:
    """Offers one message per step, None: a step without one; returns what is sent at each."""
    results = []
    for index, message in enumerate(offers):
        now_s = index * step_s
        results.append(pacer.due(now_s) if message is None else pacer.offer(message, 1, now_s))
    return results


def test_without_a_queue_messages_in_between_are_left_out() -> None:
    pacer: Pacer[str] = Pacer(Options(throttle_s=0.25), ByteBudget(1000))
    assert sent(pacer, ["a", "b", "c", "d", "e", None, "f"]) == ["a", None, None, "d", None, None, "f"]
    assert pacer.next_s is None


def test_with_a_queue_the_newest_wait_for_their_time() -> None:
    pacer: Pacer[str] = Pacer(Options(throttle_s=0.25, queue_length=2), ByteBudget(1000))
    offers: List[Optional[str]] = ["a", "b", "c", "d", "e", None, None, None, None, None]
    assert sent(pacer, offers) == ["a", None, None, "c", None, None, "d", None, None, "e"]
    assert pacer.next_s is None


def test_a_waiting_message_says_when_its_time_comes() -> None:
    pacer: Pacer[str] = Pacer(Options(throttle_s=0.25, queue_length=2), ByteBudget(1000))
    assert pacer.offer("a", 1, 10.0) == "a"
    assert pacer.offer("b", 1, 10.1) is None
    assert pacer.next_s == 10.25
    assert pacer.due(10.2) is None
    assert pacer.due(10.25) == "b"


def test_the_queues_of_a_client_share_a_bound_in_bytes() -> None:
    budget = ByteBudget(100)
    one: Pacer[str] = Pacer(Options(throttle_s=1.0, queue_length=1000), budget)
    other: Pacer[str] = Pacer(Options(throttle_s=1.0, queue_length=1000), budget)
    assert one.offer("sent", 30, 0.0) == "sent" and budget.used == 0
    assert other.offer("sent", 30, 0.0) == "sent"
    assert [one.offer(name, 30, 0.1) for name in "abcd"] == [None] * 4
    assert budget.used == 90  # "a" was dropped
    assert other.offer("x", 30, 0.1) is None
    assert budget.used == 90  # "x" did not fit
    assert one.due(1.0) == "b"
    assert other.offer("y", 30, 0.2) is None
    assert budget.used == 90
    one.clear()
    assert budget.used == 30
