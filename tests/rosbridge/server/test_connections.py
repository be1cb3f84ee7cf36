from __future__ import annotations

from typing import List, Tuple

from robot_health_monitor.rosbridge.server.connections import Connections, Stage, connection_limit


class Connection:
    def __init__(self) -> None:
        self.aborted = False

    def abort(self) -> None:
        self.aborted = True


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


def test_a_new_connection_replaces_the_oldest_that_has_presented_least() -> None:
    connections, (first, second, third, fourth), _, reports = fill(4)
    connections.set_stage(first, Stage.ACTIVE)
    connections.set_stage(second, Stage.ACCEPTED)
    connections.set_stage(third, Stage.KNOWN)
    gone = []
    for _ in range(3):
        new = Connection()
        assert connections.add(new)
        connections.set_stage(new, Stage.ACTIVE)
        gone.append([one.aborted for one in (first, second, third, fourth)])
    assert gone == [[False, False, False, True], [False, False, True, True], [False, True, True, True]]
    assert len(connections) == 4
    assert reports == ["full"]


def test_requests_without_the_token_do_not_make_a_connection_younger() -> None:
    connections, (first, second), _, _ = fill(2)
    connections.set_stage(first, Stage.OPENED)
    assert connections.add(Connection())
    assert (first.aborted, second.aborted) == (True, False)


def test_connections_in_use_are_never_replaced() -> None:
    connections, known, _, _ = fill(3)
    for one in known:
        connections.set_stage(one, Stage.ACTIVE)
    assert not connections.add(Connection())
    connections.remove(known[0])
    assert connections.add(Connection())


def test_connections_that_wait_for_a_request_are_closed_after_the_timeout() -> None:
    connections, (first, second, third, fourth), clock, _ = fill(4)
    connections.set_stage(first, Stage.ACCEPTED)
    connections.set_stage(second, Stage.KNOWN)
    clock.now_s = 10.35
    connections.set_stage(fourth, Stage.OPENED)  # a request was answered
    connections.sweep()
    assert [one.aborted for one in (first, second, third, fourth)] == [False, False, True, False]
    clock.now_s = 10.45
    connections.sweep()
    assert [one.aborted for one in (first, second, third, fourth)] == [False, True, True, False]


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


def test_all_are_closed_at_the_end() -> None:
    connections, known, _, _ = fill(3)
    connections.set_stage(known[1], Stage.ACTIVE)
    connections.abort_all()
    assert all(one.aborted for one in known)
    assert len(connections) == 0
    connections.remove(known[0])  # its transport reports the end later


def test_the_limit_leaves_descriptors_to_the_rest_of_the_process() -> None:
    assert connection_limit(5) == 5
    assert connection_limit(10**9) < 10**9


def test_the_time_without_a_request_begins_anew_after_each_request() -> None:
    connections, (connection, _), clock, _ = fill(2)
    assert connections.waiting_since_s(connection) == 0.0
    connections.set_stage(connection, Stage.ACTIVE)
    assert connections.waiting_since_s(connection) is None
    clock.now_s = 7.0
    connections.set_stage(connection, Stage.KNOWN)
    assert connections.waiting_since_s(connection) == 7.0
    connections.abort(connection)
    assert connections.waiting_since_s(connection) is None
