"""The heartbeat: calls while ticks come, in virtual time, against a real server."""

from __future__ import annotations

from harness.http_server import HttpServer, responding

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notifications.heartbeat import Heartbeat


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def run(heartbeat: Heartbeat, clock: Clock, until_s: float, ticks: bool = True) -> None:
    """Lets virtual time pass, with a tick each second."""
    while clock.now_s < until_s:
        clock.now_s += 1.0
        if ticks:
            heartbeat.note_tick()
        assert heartbeat.step() >= 0.0


def test_it_calls_every_period_while_ticks_come_and_stops_with_them(server: HttpServer) -> None:
    clock = Clock()
    heartbeat = Heartbeat(TargetSettings("alive", "heartbeat", url=f"{server.url}/ping"), Faults(), clock)
    assert heartbeat.step() > 0.0 and server.all() == []  # no tick yet
    run(heartbeat, clock, 1.0)
    assert [(call.method, call.path) for call in server.all()] == [("GET", "/ping")]
    run(heartbeat, clock, 60.0)
    assert server.all() == []
    run(heartbeat, clock, 181.0)
    assert len(server.all()) == 3
    run(heartbeat, clock, 1000.0, ticks=False)
    assert server.all() == []
    run(heartbeat, clock, 1001.0)
    assert len(server.all()) == 1


def test_a_failure_is_a_fault_and_retried_with_growing_waits(server: HttpServer) -> None:
    clock, faults = Clock(), Faults()
    heartbeat = Heartbeat(TargetSettings("alive", "heartbeat", url=server.url), faults, clock)
    server.behave = responding(500)
    run(heartbeat, clock, 63.0)
    assert len(server.all()) == 6  # after 1, 2, 4, 8, 16, 32 s
    (fault,) = faults.current().items()
    assert fault == ("notify alive", (Level.WARN, f"{server.url}: response 500 Internal Server Error"))
    server.behave = responding(200)
    run(heartbeat, clock, 200.0)
    assert faults.current() == {}


def test_a_requested_wait_is_respected(server: HttpServer) -> None:
    clock = Clock()
    heartbeat = Heartbeat(TargetSettings("alive", "heartbeat", url=server.url, every_s=10.0), Faults(), clock)
    server.behave = responding(429, Retry_After="40")
    run(heartbeat, clock, 40.0)
    assert len(server.all()) == 1
    run(heartbeat, clock, 41.0)
    assert len(server.all()) == 1
