"""Clock, timers and guarded callbacks of a node, beyond the conformance suite."""

from __future__ import annotations

from typing import Any, Mapping

import pytest

from robot_health_monitor.core.port.clocked_node import ClockedNode
from robot_health_monitor.core.port.hints import Answer
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ServiceError


class Node(ClockedNode):
    """A node without a transport, on a clock that is set by hand."""

    def __init__(self, sim_time_s: float | None = None) -> None:
        self.steady = 10.0
        self.lines: list[tuple[Severity, str]] = []
        super().__init__(
            "/robot1/node", clock=lambda: self.steady, wall_clock=lambda: 1_700_000_000.0, sim_time_s=sim_time_s
        )

    def log(self, severity: Severity, text: str) -> None:
        self.lines.append((severity, text))

    def look_up_silence(self, topic: str, type_name: str, answer: Answer) -> None:
        answer(f"{topic} is not connected")


class Delivered:
    """A subscription."""

    def __init__(self) -> None:
        self.active = True
        self.received: list[tuple[Any, float]] = []

    def callback(self, value: Any, now_s: float) -> None:
        self.received.append((value, now_s))


def test_messages_wait_for_the_first_message_on_clock() -> None:
    node, subscription = Node(0.0), Delivered()
    node.call_back(subscription, 1.0)
    assert subscription.received == [] and node.waiting_for_clock()
    node.set_sim_time(100.5)
    assert subscription.received == [(1.0, 100.5)] and not node.waiting_for_clock()
    node.call_back(subscription, 2.0)
    assert subscription.received[1:] == [(2.0, 100.5)]


def test_at_most_1000_messages_wait_for_the_clock_and_the_oldest_are_dropped() -> None:
    node, subscription = Node(0.0), Delivered()
    for number in range(1500):
        node.call_back(subscription, number)
    node.set_sim_time(100.0)
    assert [value for value, _ in subscription.received] == list(range(500, 1500))


def test_timers_on_simulated_time_start_with_the_first_message_on_clock() -> None:
    node, times_s = Node(0.0), []  # type: ignore[var-annotated]
    node.create_timer(1.0, times_s.append)
    for now_s in (100.5, 101.5, 102.5):
        node.set_sim_time(now_s)
    assert times_s == [101.5, 102.5]


def test_steady_timers_run_while_simulated_time_stands_still() -> None:
    node, times_s = Node(0.0), []  # type: ignore[var-annotated]
    node.create_timer(1.0, times_s.append, steady=True)
    node.steady = 11.0
    node.run_steady_timers()
    assert times_s == [0.0]
    assert node.next_steady_s() == 12.0


def test_a_callback_that_raises_is_a_log_line() -> None:
    def fail(value: Any, now_s: float) -> None:
        raise RuntimeError("no\nluck")

    node, subscription = Node(), Delivered()
    subscription.callback = fail  # type: ignore[method-assign]
    node.call_back(subscription, 1.0)
    assert node.lines == [(Severity.ERROR, "RuntimeError in a callback: no luck")]


def test_a_handler_that_raises_is_a_service_error_and_a_log_line() -> None:
    def fail(request: Mapping[str, Any]) -> Mapping[str, Any]:
        raise RuntimeError("no\nluck")

    node = Node()
    with pytest.raises(ServiceError, match="no luck"):
        node.answer(fail, {})
    assert node.lines == [(Severity.ERROR, "RuntimeError in a callback: no luck")]


def test_a_closed_node_calls_nothing_back() -> None:
    node, subscription = Node(), Delivered()
    node.closed = True
    node.call_back(subscription, 1.0)
    node.call(subscription.callback, 1.0, 2.0)
    assert subscription.received == []
    with pytest.raises(ServiceError):
        node.answer(dict, {})
