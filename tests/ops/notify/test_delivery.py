"""Attempts and waits in virtual time; the queue is in a real history, the target a real server."""

from __future__ import annotations

import sqlite3
from typing import Any, Callable

import pytest
from harness.alertmanager import RunningAlertmanager, needs_alertmanager
from harness.http_server import HttpServer, hanging, responding
from harness.silences import FixedSilences
from harness.transitions import StoredAlerts, transition

from robot_health_monitor.core import Level
from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notify.delivery import LONGEST_RETRY_S, MOST_REFUSALS, Delivery
from robot_health_monitor.ops.notify.notification_queue import NotificationQueue
from robot_health_monitor.ops.notify.notifier import make_sender
from robot_health_monitor.ops.store import schema


class Database:
    """A database that can fail."""

    def __init__(self) -> None:
        self.connection = sqlite3.connect(":memory:", isolation_level=None)
        schema.prepare(self.connection)
        self.faults = Faults()
        self.fails_next = 0

    def run(self, function: Callable[[sqlite3.Connection], Any]) -> Any:
        if self.fails_next:
            self.fails_next -= 1
            raise ServiceError("history: no answer within 5 s")
        return function(self.connection)


class Bench:
    """One target in virtual time. It starts in the year 2023."""

    def __init__(self, url: str, type_name: str = "webhook", timeout_s: float = 10.0) -> None:
        self.now_s = 0.0
        self.database = Database()
        self.alerts = StoredAlerts(self.database.connection)
        self.faults = self.database.faults
        self.settings = TargetSettings("chat", type_name, url=url, timeout_s=timeout_s)
        self.restart()

    def restart(self) -> None:
        """Starts again with the same database, as after kill -9."""
        self.queue = NotificationQueue([self.settings], FixedSilences())
        self.queue.prepare(self.database.connection)
        self.delivery = Delivery(
            self.settings,
            make_sender(self.settings),
            self.queue,
            self.database,  # type: ignore[arg-type]
            lambda: self.now_s,
            lambda: 1.0,
        )

    def change(self, level: str, signal: str = "battery") -> None:
        event = transition(
            to_level=Level[level], signal=signal, fingerprint=signal, robot="r3", text=f"{signal} {level}"
        )
        self.alerts.record(self.queue, event, 1_700_000_000.0 + self.now_s)
        self.delivery.note_news()

    def run(self, until_s: float) -> list[float]:
        """Lets virtual time pass; returns when steps were made."""
        steps = []
        while True:
            wait_s = self.delivery.step()
            assert wait_s >= 0.0
            if self.now_s + wait_s > until_s:
                self.now_s = until_s
                return steps
            self.now_s += wait_s
            steps.append(self.now_s)

    def settle(self) -> None:
        """Makes all steps that are due now."""
        self.run(self.now_s)

    def fault(self) -> Any:
        return self.faults.current().get("notify chat")


@pytest.fixture
def bench(server: HttpServer) -> Bench:
    return Bench(server.url)


def received(server: HttpServer) -> list[str]:
    """Returns alert lines and kinds of the requests, all of robot r3."""
    found = [request.json for request in server.all()]
    assert all(each["text"].startswith("r3: ") for each in found)
    return [f"{each['text'][4:]} {each['notification']}" for each in found]


def test_notifications_are_sent_in_order_and_nothing_is_left(bench: Bench, server: HttpServer) -> None:
    for level in ("WARN", "ERROR", "OK"):
        bench.change(level)
    bench.settle()
    assert received(server) == ["battery WARN firing", "battery ERROR firing", "battery OK resolved"]
    assert bench.queue.waiting["chat"] == 0 and bench.fault() is None
    assert bench.delivery.step() >= 3600.0  # nothing to do until there is news


def test_retries_wait_longer_each_time_up_to_five_minutes(bench: Bench, server: HttpServer) -> None:
    attempts: list[float] = []

    def behave(handler: Any) -> None:
        attempts.append(bench.now_s)
        responding(500)(handler)

    server.behave = behave
    bench.change("WARN")
    bench.run(3600.0)
    server.all()
    waits = [after - before for before, after in zip(attempts, attempts[1:])]
    assert waits[:9] == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0]
    assert set(waits[9:]) == {LONGEST_RETRY_S}
    assert bench.fault() == (Level.WARN, f"{server.url}: response 500 Internal Server Error")
    server.behave = responding(200)
    bench.run(bench.now_s + LONGEST_RETRY_S)
    assert received(server) == ["battery WARN firing"] and bench.fault() is None


def test_a_target_that_is_gone_for_a_day_is_sent_everything_afterwards(bench: Bench, server: HttpServer) -> None:
    server.behave = responding(503)
    for number in range(50):
        bench.change("WARN", f"s{number % 10}")
        bench.run(bench.now_s + 860.0)
        bench.change("OK", f"s{number % 10}")
        bench.run(bench.now_s + 860.0)
    server.all()
    bench.restart()
    server.behave = responding(200)
    bench.run(bench.now_s + LONGEST_RETRY_S)
    lines = received(server)
    assert len(lines) == 100
    for number in range(10):
        name = f"s{number}"
        of_alert = [line for line in lines if line.startswith(f"{name} ")]
        assert of_alert == [f"{name} WARN firing", f"{name} OK resolved"] * 5


def test_news_does_not_wait_for_the_end_of_a_long_delay(bench: Bench, server: HttpServer) -> None:
    server.behave = responding(500)
    bench.change("WARN")
    bench.run(2000.0)
    server.all()
    server.behave = responding(200)
    bench.run(2001.0)
    bench.change("ERROR", "cpu")
    bench.settle()
    assert received(server) == ["cpu ERROR firing", "battery WARN firing"]


def test_news_does_not_lead_to_more_than_one_attempt_per_second(bench: Bench, server: HttpServer) -> None:
    server.behave = responding(500)
    for number in range(40):
        bench.change("WARN", f"s{number}")
        bench.run(bench.now_s + 0.25)
    assert len(server.all()) <= 11


def test_one_notification_that_fails_delays_no_other(bench: Bench, server: HttpServer) -> None:
    def behave(handler: Any) -> None:
        responding(500 if b"poison" in last_body() else 200)(handler)

    seen: list[bytes] = []

    def last_body() -> bytes:
        request = server.next()
        seen.append(request.body)
        return request.body

    server.behave = behave
    bench.change("WARN", "poison")
    bench.run(1000.0)
    for number in range(5):
        bench.change("WARN", f"s{number}")
    bench.run(bench.now_s + 5.0)
    assert sum(b"poison" not in body for body in seen) == 5
    assert bench.queue.waiting["chat"] == 1


def test_a_refused_notification_is_given_up_and_reported(bench: Bench, server: HttpServer) -> None:
    server.behave = responding(404)
    bench.change("WARN")
    bench.run(60.0)
    assert len(server.all()) == MOST_REFUSALS
    text = f"{server.url}: response 404 Not Found; given up after 5 attempts: r3: battery WARN"
    assert bench.fault() == (Level.ERROR, text) and bench.queue.waiting["chat"] == 0
    server.behave = responding(200)
    bench.change("OK")
    bench.run(bench.now_s + 60.0)
    assert received(server) == ["battery OK resolved"] and bench.fault() is None


def test_a_requested_wait_is_respected(bench: Bench, server: HttpServer) -> None:
    server.behave = responding(429, Retry_After="120")
    bench.change("WARN")
    bench.run(119.0)
    assert len(server.all()) == 1
    bench.run(120.0)
    assert len(server.all()) == 1


@pytest.mark.parametrize("signal", ["battery", "cpu"])
def test_news_does_not_shorten_a_requested_wait(bench: Bench, server: HttpServer, signal: str) -> None:
    server.behave = responding(429, Retry_After="60")
    bench.change("WARN")
    bench.settle()
    for level in ("ERROR", "WARN") * 29:
        bench.change(level, signal)
        bench.run(bench.now_s + 1.0)
    bench.run(59.9)
    assert len(server.all()) == 1
    text = f"{server.url}: response 429 Too Many Requests; the server asks to wait 60 s"
    assert bench.fault() == (Level.WARN, text)
    server.behave = responding(200)
    bench.run(60.0)
    assert "battery WARN firing" in received(server) and bench.fault() is None


def test_repetitions_do_not_shorten_a_requested_wait(server: HttpServer) -> None:
    bench = Bench(server.url, "alertmanager")
    bench.change("WARN")
    bench.settle()
    server.all()
    server.behave = responding(503, Retry_After="200")
    bench.run(30.0)
    assert len(server.all()) == 1
    bench.run(229.0)
    assert server.all() == []
    bench.run(230.0)
    assert len(server.all()) == 1


def test_a_restart_loses_nothing_and_repeats_nothing(bench: Bench, server: HttpServer) -> None:
    bench.change("WARN", "cpu")
    bench.settle()
    server.behave = responding(500)
    bench.change("WARN")
    bench.settle()
    server.all()
    server.behave = responding(200)
    bench.restart()
    bench.settle()
    assert received(server) == ["battery WARN firing"]


def test_what_was_sent_is_not_sent_again_because_the_database_failed(bench: Bench, server: HttpServer) -> None:
    bench.change("WARN")

    def behave(handler: Any) -> None:
        bench.database.fails_next = 3
        responding(200)(handler)

    server.behave = behave
    bench.run(10.0)
    assert received(server) == ["battery WARN firing"] and bench.queue.waiting["chat"] == 0


def test_a_target_that_hangs_is_a_fault(server: HttpServer) -> None:
    bench = Bench(server.url, timeout_s=0.2)
    server.behave = hanging
    bench.change("WARN")
    bench.settle()
    assert bench.fault() == (Level.WARN, f"{server.url}: no response within 0.2 s")
    assert bench.queue.waiting["chat"] == 1 and not bench.delivery.has_work()


def test_an_unprotected_secret_is_a_warning(server: HttpServer, tmp_path: Any) -> None:
    bench = Bench(server.url)
    file = tmp_path / "chat.url"
    file.write_text(f"{server.url}/s3cret")
    file.chmod(0o644)
    bench.settings = TargetSettings("chat", "webhook", url_file=str(file))
    bench.restart()
    bench.change("WARN")
    bench.settle()
    faults = bench.faults.current()
    assert list(faults) == ["notify chat: url_file"] and "chmod 600" in faults["notify chat: url_file"].text
    file.chmod(0o600)
    bench.change("OK")
    bench.settle()
    assert bench.faults.current() == {}


@needs_alertmanager
def test_an_open_alert_is_repeated_also_after_a_restart_and_ends(alertmanager: RunningAlertmanager) -> None:
    bench = Bench(alertmanager.url, "alertmanager")

    def updates() -> dict[str, str]:
        return {alert["labels"]["signal"]: alert["updatedAt"] for alert in alertmanager.alerts()}

    bench.change("WARN")
    bench.settle()
    first = updates()
    assert list(first) == ["battery"]
    bench.run(bench.now_s + 29.0)
    assert updates() == first
    bench.run(bench.now_s + 2.0)
    second = updates()
    assert second["battery"] > first["battery"]
    bench.restart()
    bench.settle()
    assert updates()["battery"] > second["battery"]
    bench.change("ERROR")
    bench.settle()
    assert alertmanager.levels() == {"battery": "ERROR"}
    bench.change("OK")
    bench.settle()
    assert alertmanager.levels() == {}
    bench.run(bench.now_s + 100.0)
    assert alertmanager.levels() == {}


def test_repetitions_go_on_while_one_notification_fails(server: HttpServer) -> None:
    bench = Bench(server.url, "alertmanager")
    bench.change("WARN", "cpu")
    bench.settle()
    bench.change("WARN", "poison")

    def behave(handler: Any) -> None:
        request = server.next()
        texts = [alert["labels"]["signal"] for alert in request.json]
        seen.append((bench.now_s, texts))
        responding(500 if "poison" in texts else 200)(handler)

    seen: list[Any] = []
    server.behave = behave
    server.all()
    bench.run(600.0)
    repeated = [now_s for now_s, texts in seen if texts == ["cpu"]]
    assert repeated == [30.0 * number for number in range(1, 21)]


# The heartbeat


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def make_heartbeat(clock: Clock, **settings: Any) -> tuple[Delivery, Faults]:
    """Returns a heartbeat in virtual time, with its faults."""
    database, target = Database(), TargetSettings("alive", "heartbeat", **settings)
    queue = NotificationQueue([target], FixedSilences())
    delivery = Delivery(target, make_sender(target), queue, database, clock, lambda: 1.0)  # type: ignore[arg-type]
    return delivery, database.faults


def beat(heartbeat: Delivery, clock: Clock, until_s: float, ticks: bool = True) -> None:
    """Lets virtual time pass, with a tick each second."""
    while clock.now_s < until_s:
        clock.now_s += 1.0
        if ticks:
            heartbeat.note_tick()
        assert heartbeat.step() >= 0.0


def test_a_heartbeat_calls_every_period_while_ticks_come_and_stops_with_them(server: HttpServer) -> None:
    clock = Clock()
    heartbeat, _ = make_heartbeat(clock, url=f"{server.url}/ping")
    assert heartbeat.step() > 0.0 and server.all() == []  # no tick yet
    beat(heartbeat, clock, 1.0)
    assert [(call.method, call.path) for call in server.all()] == [("GET", "/ping")]
    beat(heartbeat, clock, 60.0)
    assert server.all() == []
    beat(heartbeat, clock, 181.0)
    assert len(server.all()) == 3
    beat(heartbeat, clock, 1000.0, ticks=False)
    assert server.all() == []
    beat(heartbeat, clock, 1001.0)
    assert len(server.all()) == 1


def test_a_failed_heartbeat_is_a_fault_and_retried_with_growing_waits(server: HttpServer) -> None:
    clock = Clock()
    heartbeat, faults = make_heartbeat(clock, url=server.url)
    server.behave = responding(500)
    beat(heartbeat, clock, 63.0)
    assert len(server.all()) == 6  # after 1, 2, 4, 8, 16, 32 s
    (fault,) = faults.current().items()
    assert fault == ("notify alive", (Level.WARN, f"{server.url}: response 500 Internal Server Error"))
    server.behave = responding(200)
    beat(heartbeat, clock, 200.0)
    assert faults.current() == {}


def test_a_heartbeat_respects_a_requested_wait(server: HttpServer) -> None:
    clock = Clock()
    heartbeat, _ = make_heartbeat(clock, url=server.url, every_s=10.0)
    server.behave = responding(429, Retry_After="40")
    beat(heartbeat, clock, 40.0)
    assert len(server.all()) == 1
    beat(heartbeat, clock, 41.0)
    assert len(server.all()) == 1
