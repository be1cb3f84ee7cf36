from __future__ import annotations

from typing import List, Tuple

from robot_health_monitor.rosbridge.server.connections import Connections, Stage, connection_limit


class Connection:
    """The part of aiohttp's RequestHandler that is used."""

    def __init__(self, handshake: bool = False) -> None:
        self.aborted = False
        self.transport = None if handshake else self

    def abort(self) -> None:
        self.aborted = True

    def is_closing(self) -> bool:
        return self.aborted


class Clock:
    now_s = 0.0


def fill(limit: int) -> Tuple[Connections, List[Connection], Clock, List[str]]:
    clock = Clock()
    reports: List[str] = []
    connections = Connections(limit, 10.0, lambda: clock.now_s, lambda: reports.append("full"))
    known = []
    for _ in range(limit):
        known.append(Connection())
        assert connections.add(known[-1])
        clock.now_s += 0.1
    return connections, known, clock, reports


def test_a_new_connection_replaces_the_oldest_that_has_presented_nothing() -> None:
    connections, (first, second, third), _, reports = fill(3)
    connections.set_stage(first, Stage.ACTIVE)
    connections.set_stage(second, Stage.ACCEPTED)
    new = Connection()
    assert connections.add(new)
    assert [one.aborted for one in (first, second, third, new)] == [False, False, True, False]
    connections.set_stage(new, Stage.ACCEPTED)
    assert connections.add(Connection())
    assert second.aborted and not first.aborted
    assert len(connections) == 3
    assert reports == ["full"]


def test_connections_in_use_are_never_replaced() -> None:
    connections, known, _, _ = fill(3)
    for one in known:
        connections.set_stage(one, Stage.ACTIVE)
    assert not connections.add(Connection())
    known[0].abort()
    assert connections.add(Connection())


def test_connections_that_present_nothing_are_closed_after_the_timeout() -> None:
    connections, (first, second, third), clock, _ = fill(3)
    connections.set_stage(first, Stage.ACCEPTED)
    clock.now_s = 10.15
    connections.sweep()
    assert [one.aborted for one in (first, second, third)] == [False, True, False]


def test_that_it_is_full_is_reported_once_until_it_is_not() -> None:
    connections, _, clock, reports = fill(10)
    for _ in range(1100):
        connections.add(Connection())
    assert reports == ["full"]
    clock.now_s += 11.0
    connections.sweep()
    assert len(connections) == 0
    for _ in range(11):
        connections.add(Connection())
    assert reports == ["full", "full"]


def test_connections_in_a_tls_handshake_count() -> None:
    clock = Clock()
    connections = Connections(2, 10.0, lambda: clock.now_s, lambda: None)
    assert connections.add(Connection(handshake=True)) and connections.add(Connection(handshake=True))
    assert not connections.add(Connection())
    clock.now_s = 11.0
    connections.sweep()
    assert connections.add(Connection())


def test_the_limit_leaves_descriptors_to_the_rest_of_the_process() -> None:
    assert connection_limit(5) == 5
    assert connection_limit(10**9) < 10**9


def test_the_time_without_a_request_begins_anew_after_each_request() -> None:
    connections, (connection, _), clock, _ = fill(2)
    assert connections.opened_s(connection) == 0.0
    connections.set_stage(connection, Stage.ACTIVE)
    assert connections.opened_s(connection) is None
    clock.now_s = 7.0
    connections.set_stage(connection, Stage.OPENED)
    assert connections.opened_s(connection) == 7.0
    connections.abort(connection)
    assert connections.opened_s(connection) is None
