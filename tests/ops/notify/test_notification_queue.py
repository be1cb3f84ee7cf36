"""What each target is sent, and what it is not: levels, silences, restarts and outages."""

from __future__ import annotations

import json
import sqlite3
from typing import Any, Optional, Tuple

import pytest
from harness.silences import FixedSilences
from harness.transitions import StoredAlerts, transition

from robot_health_monitor.core import Level, Status
from robot_health_monitor.core.nodes.outlets import json_line
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.notify import notification_queue
from robot_health_monitor.ops.notify.notification_queue import NotificationQueue, Taken, is_transition
from robot_health_monitor.ops.store import schema

Sent = Tuple[str, str, Optional[str]]
"""Signal and level (or `resolved`), and the level that was open at the target before."""


class Bench:
    """A queue on a real database, with targets that work when asked to."""

    def __init__(self, *targets: TargetSettings) -> None:
        self.connection = sqlite3.connect(":memory:", isolation_level=None)
        schema.prepare(self.connection)
        self.alerts = StoredAlerts(self.connection)
        self.silences = FixedSilences()
        self.simulated: set[tuple[str, str]] = set()
        self.now_s = 1000.0
        self.restart(*targets)

    def restart(self, *targets: TargetSettings) -> None:
        """Starts again with the same database."""
        targets = targets or (TargetSettings("chat", "webhook"),)
        self.queue = NotificationQueue(
            targets,
            self.silences,
            lambda *alert: alert in self.simulated,
            lambda: self.now_s,
        )
        self.queue.prepare(self.connection)

    def change(self, to_level: str, from_level: str = "OK", signal: str = "battery", **fields: Any) -> None:
        self.now_s += 1.0
        event = transition(
            to_level=Level[to_level],
            from_level=Level[from_level],
            signal=signal,
            robot=fields.pop("robot", "r3"),
            fingerprint=f"fp-{signal}",
            text=f"{signal} {to_level}",
            **fields,
        )
        self.alerts.record(self.queue, event, self.now_s)

    def take(self, target: str = "chat") -> Taken | None:
        return self.queue.take(self.connection, target)

    def deliver(self, target: str = "chat") -> list[Sent]:
        """Delivers all that waits."""
        sent: list[Sent] = []
        while True:
            taken = self.take(target)
            if taken is None:
                return sent
            self.queue.finish(self.connection, taken)
            sent.append(described(taken))

    def expire_silences(self) -> None:
        self.silences.alerts = ()
        if self.queue.is_reconciliation_due():
            self.queue.prepare(self.connection)


def described(taken: Taken) -> Sent:
    notification = taken.notification
    state = "resolved" if notification.is_resolved else notification.level.name
    return notification.signal, state, notification.before.level.name if notification.before else None


BATTERY = ("r3", "battery")


def test_an_alert_is_sent_when_it_begins_changes_and_ends() -> None:
    bench = Bench()
    bench.change("WARN")
    assert bench.queue.waiting["chat"] == 1
    assert bench.deliver() == [("battery", "WARN", None)]
    bench.change("ERROR", "WARN")
    bench.change("OK", "ERROR")
    assert bench.deliver() == [("battery", "ERROR", "WARN"), ("battery", "resolved", "ERROR")]
    assert bench.queue.waiting["chat"] == 0


@pytest.mark.parametrize(
    ("min_level", "sent"),
    [
        ("WARN", ["WARN", "STALE", "ERROR", "STALE", "WARN", "resolved"]),
        ("STALE", ["STALE", "ERROR", "STALE", "resolved"]),
        ("ERROR", ["ERROR", "resolved"]),
    ],
)
def test_below_min_level_nothing_is_sent_except_the_end_of_what_was_sent(min_level: str, sent: list[str]) -> None:
    bench = Bench(TargetSettings("chat", "webhook", Level[min_level]))
    for level in ("WARN", "STALE", "ERROR", "STALE", "WARN", "OK"):
        bench.change(level)
    assert [state for _, state, _ in bench.deliver()] == sent


TARGETS = (TargetSettings("chat", "webhook"), TargetSettings("trial", "webhook", simulated=True))


def test_simulated_values_notify_only_targets_that_ask_for_them() -> None:
    bench = Bench(*TARGETS)
    bench.simulated.add(BATTERY)
    bench.change("WARN")
    bench.change("WARN", signal="temperature")
    assert [sent[0] for sent in bench.deliver("chat")] == ["temperature"]
    assert [sent[0] for sent in bench.deliver("trial")] == ["battery", "temperature"]
    bench.change("OK", "WARN")
    assert bench.deliver("chat") == []
    assert bench.deliver("trial") == [("battery", "resolved", "WARN")]


def test_it_is_said_in_what_a_target_receives() -> None:
    bench = Bench(*TARGETS)
    bench.change("WARN", signal="temperature")
    bench.simulated.add(BATTERY)
    bench.change("WARN")
    shown = []
    for _ in range(2):
        taken = bench.take("trial")
        assert taken is not None
        bench.queue.finish(bench.connection, taken)
        shown.append(json.loads(taken.notification.as_json()).get("simulated"))
    assert shown == [None, True]


def test_a_restarted_monitor_still_knows_that_an_open_alert_is_simulated() -> None:
    """battery_sensor has not said so again when the first notifications are sent."""
    bench = Bench(*TARGETS)
    bench.simulated.add(BATTERY)
    bench.change("ERROR")
    assert bench.deliver("chat") == []
    bench.simulated.clear()
    bench.restart(*TARGETS)
    assert bench.deliver("chat") == []
    assert bench.deliver("trial") == [("battery", "ERROR", None)]


def test_an_alert_that_turns_out_to_be_simulated_before_it_is_sent_is_not_sent() -> None:
    bench = Bench(*TARGETS)
    bench.change("WARN")
    bench.simulated.add(BATTERY)
    assert bench.deliver("chat") == []


def test_a_sent_alert_is_resolved_when_its_values_become_simulated() -> None:
    bench = Bench(*TARGETS)
    bench.change("WARN")
    assert bench.deliver("chat") == [("battery", "WARN", None)]
    bench.simulated.add(BATTERY)
    bench.change("ERROR", "WARN")
    assert bench.deliver("chat") == [("battery", "resolved", "WARN")]


def test_patterns_choose_robots_and_signals() -> None:
    bench = Bench(TargetSettings("chat", "webhook", robots=("r?", "husky*", "arm[1]"), signals=("batt*",)))
    for robot, signal in (
        ("r3", "battery"),
        ("r33", "battery2"),
        ("husky1", "batt"),
        ("r3", "cpu"),
        ("R3", "batt_"),
        ("arm[1]", "batt1"),
    ):
        bench.change("WARN", signal=signal, robot=robot)
    assert [signal for signal, _, _ in bench.deliver()] == ["battery", "batt", "batt1"]


def test_a_repetition_is_sent_again_except_to_alertmanager() -> None:
    bench = Bench(TargetSettings("chat", "webhook"), TargetSettings("pager", "alertmanager"))
    bench.change("WARN")
    bench.change("WARN", "WARN", repeat=True)
    assert bench.deliver() == [("battery", "WARN", None), ("battery", "WARN", "WARN")]
    assert bench.deliver("pager") == [("battery", "WARN", None)]
    begin_s = 1001.0  # that of the alert, not that of its repetition
    assert [alert.at_s for alert in bench.queue.open_at(bench.connection, "chat")] == [begin_s]


def test_nothing_is_sent_again_after_a_restart() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.restart()
    assert bench.deliver() == []
    bench.change("OK", "WARN")
    assert bench.deliver() == [("battery", "resolved", "WARN")]


def test_what_was_waiting_is_sent_after_a_restart() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.change("OK", "WARN")
    taken = bench.take()
    assert taken is not None and described(taken) == ("battery", "WARN", None)
    bench.restart()  # killed while it was being sent
    assert bench.deliver() == [("battery", "WARN", None), ("battery", "resolved", "WARN")]


def test_a_new_target_is_sent_what_is_open_and_a_removed_one_is_forgotten() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.restart(TargetSettings("pager", "webhook"))
    assert bench.deliver("pager") == [("battery", "WARN", None)]
    bench.restart(TargetSettings("chat", "webhook"), TargetSettings("pager", "webhook"))
    assert (bench.deliver("chat"), bench.deliver("pager")) == ([("battery", "WARN", None)], [])


def test_an_alert_that_a_changed_configuration_excludes_is_resolved() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.restart(TargetSettings("chat", "webhook", Level.ERROR))
    assert bench.deliver() == [("battery", "resolved", "WARN")]
    bench.restart(TargetSettings("chat", "webhook", Level.ERROR))
    assert bench.deliver() == []


def test_an_alert_whose_end_the_history_lost_is_resolved() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.connection.execute("DELETE FROM open_alerts")
    bench.restart()
    assert bench.deliver() == [("battery", "resolved", "WARN")]


def test_a_silenced_alert_is_sent_once_when_the_silence_expires() -> None:
    bench = Bench()
    bench.silences.alerts = {BATTERY}
    bench.change("WARN")
    assert bench.deliver() == [] and not bench.queue.is_reconciliation_due()
    bench.expire_silences()
    assert bench.deliver() == [("battery", "WARN", None)]
    bench.expire_silences()
    assert bench.deliver() == []


def test_a_silenced_alert_that_ends_during_the_silence_is_never_sent() -> None:
    bench = Bench()
    bench.silences.alerts = {BATTERY}
    bench.change("WARN")
    bench.deliver()
    bench.change("OK", "WARN")
    bench.deliver()
    bench.expire_silences()
    assert bench.deliver() == []


def test_resolved_is_sent_for_what_was_sent_before_the_silence() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.silences.alerts = {BATTERY}
    bench.change("OK", "WARN")
    assert bench.deliver() == [("battery", "resolved", "WARN")]
    bench.change("WARN")
    assert bench.deliver() == []
    bench.expire_silences()
    assert bench.deliver() == [("battery", "WARN", None)]


def test_an_alert_that_is_after_the_silence_as_it_was_before_is_not_sent_again() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.silences.alerts = {BATTERY}
    bench.change("ERROR", "WARN")
    bench.change("WARN", "ERROR")
    assert bench.deliver() == []
    bench.expire_silences()
    assert bench.deliver() == []


def test_a_level_that_changed_during_the_silence_is_sent_after_it() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.silences.alerts = {BATTERY}
    bench.change("ERROR", "WARN")
    assert bench.deliver() == []
    open_alerts = bench.queue.open_at(bench.connection, "chat")
    assert [alert.level for alert in open_alerts] == [Level.WARN]  # repeated meanwhile: the target would end it
    bench.expire_silences()
    assert bench.deliver() == [("battery", "ERROR", "WARN")]


def test_a_silence_that_expired_while_the_monitor_was_down() -> None:
    bench = Bench()
    bench.silences.alerts = {BATTERY}
    bench.change("WARN")
    bench.deliver()
    bench.silences.alerts = set()
    bench.restart()
    assert bench.deliver() == [("battery", "WARN", None)]


def test_a_silence_that_outlasts_a_restart() -> None:
    bench = Bench()
    bench.silences.alerts = {BATTERY}
    bench.change("WARN")
    bench.deliver()
    bench.restart()
    assert bench.deliver() == []
    bench.expire_silences()
    assert bench.deliver() == [("battery", "WARN", None)]


def test_a_silence_also_holds_back_what_already_waits() -> None:
    bench = Bench()
    bench.change("WARN")  # the target is gone, and then the alert is silenced
    bench.silences.alerts = {BATTERY}
    assert bench.deliver() == []


def test_what_may_have_arrived_is_not_sent_again_during_a_silence_but_its_end_is() -> None:
    bench = Bench()
    bench.change("WARN")
    assert bench.take() is not None  # no response
    bench.silences.alerts = {BATTERY}
    assert bench.deliver() == [] and bench.queue.waiting["chat"] == 0
    assert bench.queue.open_at(bench.connection, "chat") == []  # not repeated either
    bench.change("ERROR", "WARN")
    bench.restart()
    assert bench.deliver() == []
    bench.change("OK", "ERROR")
    assert bench.deliver() == [("battery", "resolved", "WARN")]
    bench.expire_silences()
    assert bench.deliver() == []


@pytest.mark.parametrize("restarts", [False, True])
def test_what_may_have_arrived_is_sent_again_after_a_silence(restarts: bool) -> None:
    bench = Bench()
    bench.change("WARN")
    assert bench.take() is not None  # no response
    bench.silences.alerts = {BATTERY}
    assert bench.deliver() == []
    if restarts:
        bench.restart()
    bench.expire_silences()
    assert bench.deliver() == [("battery", "WARN", "WARN")]
    assert bench.deliver() == []
    bench.change("OK", "WARN")
    assert bench.deliver() == [("battery", "resolved", "WARN")]


def test_the_end_of_what_was_sent_is_tried_again_in_spite_of_a_silence() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.silences.alerts = {BATTERY}
    bench.change("OK", "WARN")
    assert bench.take() is not None  # no response
    assert bench.deliver() == [("battery", "resolved", "WARN")]


def test_what_certainly_did_not_arrive_is_held_back_by_a_silence() -> None:
    bench = Bench()
    bench.change("WARN")
    taken = bench.take()
    assert taken is not None
    bench.queue.put_back(bench.connection, taken)
    bench.silences.alerts = {BATTERY}
    assert bench.deliver() == []


def test_a_notification_that_failed_waits_behind_other_alerts_but_before_its_own() -> None:
    bench = Bench()
    bench.change("WARN", signal="poison")
    bench.change("ERROR", "WARN", signal="poison")
    assert bench.take() is not None  # fails
    bench.change("WARN", signal="cpu")
    assert bench.deliver() == [("cpu", "WARN", None), ("poison", "WARN", None), ("poison", "ERROR", "WARN")]


def test_alerts_about_which_something_waits_are_not_repeated() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.change("WARN", signal="cpu")
    bench.deliver()
    bench.change("OK", "WARN")
    open_alerts = bench.queue.open_at(bench.connection, "chat")
    assert [(alert.robot, alert.signal, alert.at_s, alert.text) for alert in open_alerts] == [
        ("r3", "cpu", 1002.0, "r3: cpu WARN")
    ]


def test_a_full_queue_drops_what_later_notifications_supersede_and_counts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notification_queue, "MOST_WAITING", 20)
    monkeypatch.setattr(notification_queue, "_DROPPED_AT_ONCE", 5)
    bench = Bench()
    bench.change("WARN", signal="open")
    bench.change("WARN", signal="attempted")
    assert bench.take() is not None and bench.take() is not None
    bench.change("OK", "WARN", signal="attempted")
    for _ in range(200):
        bench.change("WARN")
        bench.change("OK", "WARN")
    assert bench.queue.waiting["chat"] <= 21
    waiting, dropped = bench.queue.waiting["chat"], bench.queue.dropped["chat"]
    assert waiting + dropped == 403
    sent = bench.deliver()
    # Not those of alerts that are open, and the end of each that was sent.
    assert ("open", "WARN", None) in sent
    assert [state for signal, state, _ in sent if signal == "attempted"] == ["WARN", "resolved"]
    states = [state for signal, state, _ in sent if signal == "battery"]
    assert states == ["WARN", "resolved"] * (len(states) // 2)
    assert bench.queue.dropped["chat"] == 0


def test_a_full_queue_keeps_the_latest_of_every_open_alert(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notification_queue, "MOST_WAITING", 20)
    monkeypatch.setattr(notification_queue, "_DROPPED_AT_ONCE", 5)
    bench = Bench()
    for number in range(60):
        bench.change("WARN", signal=f"s{number}")
    assert bench.queue.waiting["chat"] == 60 and bench.queue.dropped["chat"] == 0
    for number in range(60):
        bench.change("ERROR", "WARN", signal=f"s{number}")
    assert bench.queue.waiting["chat"] <= 80
    last: dict[str, str] = {signal: state for signal, state, _ in bench.deliver()}
    assert last == {f"s{number}": "ERROR" for number in range(60)}


def renamed(bench: Bench, count: int) -> None:
    """A driver that renames itself: each of its names is STALE, and then gone."""
    for number in range(count):
        bench.change("STALE", signal=f"drivers[{number}]")
        bench.change("OK", "STALE", signal=f"drivers[{number}]")


def test_a_driver_that_renames_itself_while_the_target_is_gone_does_not_fill_the_queue() -> None:
    """Issue: the OK of each name was never superseded; 5,072 rows in a queue of 1,000."""
    bench = Bench()
    bench.change("WARN", signal="drivers[0]")
    assert bench.take() is not None  # no response: the target may know of this one
    renamed(bench, 3_000)
    assert bench.queue.waiting["chat"] <= notification_queue.MOST_WAITING + 1
    assert bench.queue.waiting["chat"] + bench.queue.dropped["chat"] == 6_001
    assert bench.connection.execute("SELECT count(*) FROM open_alerts").fetchone() == (0,)
    sent = bench.deliver()
    assert [state for signal, state, _ in sent if signal == "drivers[0]"] == ["WARN", "resolved"]


def test_another_robot_does_not_wait_for_the_rows_of_a_driver_that_renames_itself() -> None:
    bench = Bench()
    renamed(bench, 300)
    for _ in range(3):
        taken = bench.take()
        assert taken is not None
        bench.queue.finish(bench.connection, taken)
    bench.change("ERROR", signal="battery", robot="dora")
    bench.change("OK", "ERROR", signal="battery", robot="dora")
    sent = bench.deliver()
    assert [place for place, (signal, _, _) in enumerate(sent) if signal == "battery"] == [1, 3]


def test_taking_a_row_costs_the_same_however_many_names_wait() -> None:
    bench = Bench()
    renamed(bench, 499)
    plan = bench.connection.execute(
        f"EXPLAIN QUERY PLAN SELECT * FROM notifications {notification_queue._HEAD}", ("chat",)
    ).fetchall()
    steps = [row[-1] for row in plan]
    assert not [step for step in steps if "TEMP B-TREE" in step or step.startswith("SCAN row")]


def test_names_that_a_silence_holds_back_are_forgotten_when_their_alerts_end() -> None:
    bench = Bench()
    bench.silences.alerts = {("r3", f"drivers[{number}]") for number in range(100)}
    for number in range(100):
        bench.change("STALE", signal=f"drivers[{number}]")
        assert bench.take() is None
        bench.change("OK", "STALE", signal=f"drivers[{number}]")
    assert bench.queue._held == set()


GROUPED = TargetSettings("chat", "webhook", group_wait_s=30.0)
LATE = TargetSettings("chat", "webhook", after_s=600.0)


def sent_message(bench: Bench) -> dict[str, Any]:
    """Returns the JSON of the message that is due, and delivers it; empty if there is none."""
    taken = bench.take()
    if taken is None:
        return {}
    bench.queue.finish(bench.connection, taken)
    found: dict[str, Any] = json.loads(taken.notification.as_json())
    return found


def test_the_events_of_a_robot_within_the_wait_are_one_message_the_worst_first() -> None:
    bench = Bench(GROUPED)
    bench.change("WARN", signal="old", hint="no publisher")
    bench.now_s += 29.0
    assert bench.take() is None and bench.queue.wait_s.get("chat", 0.0) == 1.0
    bench.now_s += 1.0
    single = sent_message(bench)
    assert "alerts" not in single  # a single event is the plain message
    assert (single["text"], single["alert_id"]) == ("r3: old WARN [no publisher]", 1)
    for level, signal in (("WARN", "fan"), ("STALE", "scan"), ("ERROR", "battery")):
        bench.change(level, signal=signal)
    bench.change("OK", "WARN", signal="old")
    bench.change("WARN", signal="cpu", robot="r4")  # another robot has a wait of its own
    bench.now_s += 26.0
    message = sent_message(bench)
    assert message["text"] == "r3: 4 alerts: battery ERROR; scan STALE; fan WARN; old OK"
    assert (message["robot"], message["notification"], message["time"]) == ("r3", "firing", "1970-01-01T00:17:15.000Z")
    assert [(alert["text"], alert["notification"]) for alert in message["alerts"]] == [
        ("r3: battery ERROR", "firing"), ("r3: scan STALE", "firing"), ("r3: fan WARN", "firing"),
        ("r3: old OK", "resolved"),
    ]  # fmt: skip
    assert bench.take() is None and bench.queue.wait_s.get("chat", 0.0) == 4.0
    bench.now_s += 4.0
    assert sent_message(bench)["text"] == "r4: cpu WARN"
    assert bench.queue.waiting["chat"] == 0


def test_of_many_alerts_five_are_named() -> None:
    bench = Bench(GROUPED)
    for number in range(7):
        bench.change("WARN", signal=f"s{number}")
    bench.now_s += 30.0
    assert sent_message(bench)["text"] == "r3: 7 alerts: s0 WARN; s1 WARN; s2 WARN; s3 WARN; s4 WARN; and 2 more"


def test_an_alert_that_ended_within_the_wait_is_not_sent_and_of_others_the_latest_level_is() -> None:
    bench = Bench(GROUPED)
    bench.change("WARN", signal="short")
    bench.change("OK", "WARN", signal="short")
    bench.change("WARN")
    bench.change("ERROR", "WARN")
    bench.now_s += 30.0
    assert sent_message(bench)["text"] == "r3: battery ERROR"
    assert bench.queue.waiting["chat"] == 0
    bench.change("WARN", "ERROR")
    bench.change("ERROR", "WARN")
    bench.now_s += 30.0
    assert sent_message(bench) == {}  # as it was sent
    bench.change("OK", "ERROR")
    bench.now_s += 30.0
    assert sent_message(bench)["notification"] == "resolved"


@pytest.mark.parametrize("may_have_arrived", [False, True])
def test_a_message_that_was_not_confirmed_is_sent_again_with_what_came_meanwhile(may_have_arrived: bool) -> None:
    bench = Bench(GROUPED)
    bench.change("WARN")
    bench.change("WARN", signal="fan")
    bench.now_s += 30.0
    taken = bench.take()
    assert taken is not None
    if not may_have_arrived:
        bench.queue.put_back(bench.connection, taken)
    bench.change("OK", "WARN")
    bench.restart(GROUPED)
    text = sent_message(bench)["text"]
    assert text == ("r3: 2 alerts: fan WARN; battery OK" if may_have_arrived else "r3: fan WARN")


def test_a_level_that_may_have_arrived_is_corrected() -> None:
    bench = Bench(GROUPED)
    bench.change("WARN")
    bench.now_s += 30.0
    assert sent_message(bench)["text"] == "r3: battery WARN"
    bench.change("ERROR", "WARN")
    bench.now_s += 30.0
    assert bench.take() is not None  # no response
    bench.change("WARN", "ERROR")
    assert sent_message(bench)["text"] == "r3: battery WARN"


def test_a_restart_does_not_begin_the_wait_for_others_anew() -> None:
    bench = Bench(GROUPED)
    bench.change("WARN")
    bench.now_s += 20.0
    bench.restart(GROUPED)
    assert bench.take() is None and bench.queue.wait_s.get("chat", 0.0) == 5.0  # then it looks again
    bench.now_s += 10.0
    assert sent_message(bench)["text"] == "r3: battery WARN"


def test_a_wall_clock_that_is_set_back_does_not_prolong_the_wait() -> None:
    bench = Bench(GROUPED)
    bench.change("WARN")
    bench.now_s -= 500.0
    assert sent_message(bench)["text"] == "r3: battery WARN"


def test_only_alerts_that_are_open_for_so_long_are_sent_and_then_their_end() -> None:
    bench = Bench(LATE)
    bench.change("WARN")
    begun_s = bench.now_s
    bench.change("WARN", signal="short")
    bench.change("ERROR", "WARN")  # does not begin it anew
    bench.change("OK", "WARN", signal="short")
    for waited_s in (300.0, 599.0):
        bench.now_s = begun_s + waited_s
        bench.restart(LATE)  # nor does a restart
        assert bench.deliver() == []
    bench.now_s = begun_s + 600.0
    assert bench.queue.is_reconciliation_due()
    bench.queue.prepare(bench.connection)
    assert bench.deliver() == [("battery", "ERROR", None)]
    bench.change("WARN", "ERROR")
    bench.change("OK", "WARN")
    assert bench.deliver() == [("battery", "WARN", "ERROR"), ("battery", "resolved", "WARN")]
    bench.change("WARN")
    bench.queue.prepare(bench.connection)
    assert bench.deliver() == []


def test_silenced_time_does_not_count() -> None:
    bench = Bench(LATE)
    bench.change("WARN")
    begun_s = bench.now_s
    for silenced, at_s in ((True, 100.0), (True, 400.0), (False, 700.0), (False, 1199.0)):
        bench.silences.alerts = {BATTERY} if silenced else set()
        bench.now_s = begun_s + at_s
        bench.restart(LATE)
        assert bench.deliver() == []
    bench.now_s = begun_s + 1200.0  # 600 s of them were silenced
    bench.queue.prepare(bench.connection)
    assert bench.deliver() == [("battery", "WARN", None)]


@pytest.mark.parametrize("public_url", ["https://health.example:9090", "https://health.example:9090/"])
def test_every_notification_of_an_alert_links_to_its_page(public_url: str) -> None:
    bench = Bench()
    bench.queue = NotificationQueue((TargetSettings("chat", "webhook"),), FixedSilences(), public_url=public_url)
    bench.change("WARN", signal="other")
    for before, after in (("OK", "WARN"), ("WARN", "ERROR"), ("ERROR", "OK")):
        bench.change(after, before)
    links = [sent_message(bench)["link"] for _ in range(4)]
    assert links == [f"https://health.example:9090/#alerts/{number}" for number in (1, 2, 2, 2)]


def test_what_to_do_comes_with_every_notification_of_an_alert() -> None:
    bench = Bench()
    status = Status("battery", Level.WARN, "", "r3", {}, what_to_do="check the cable")
    bench.change("WARN", status=status)
    bench.change("OK", "WARN", status=status)
    assert [sent_message(bench)["what_to_do"] for _ in range(2)] == ["check the cable"] * 2
    bench.change("WARN", signal="fan")
    assert "what_to_do" not in sent_message(bench)


ODD = ("'text'", "9e999", "x'ff00'", "'{}'", "'[1]'")


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize(
    ("table", "column"),
    [
        *(("open_alerts", name) for name in ("robot", "level", "at_s", "transition_json")),
        *(("notified", name) for name in ("level", "at_s", "transition_json")),
        *(("notifications", name) for name in ("level", "at_s", "transition_json", "attempts", "place")),
    ],
)
def test_an_odd_row_stops_no_other_notification(table: str, column: str, odd: str) -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.change("ERROR", "WARN")
    bench.connection.execute(f"UPDATE {table} SET {column} = {odd}")
    bench.restart()
    bench.change("WARN", signal="temperature")
    bench.deliver()
    assert bench.queue.open_at(bench.connection, "chat")[-1].signal == "temperature"
    assert bench.queue.waiting["chat"] == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("robot", 5), ("text", None), ("to_level", "BAD"), ("to_level", []), ("repeat", 1),
    ],
)  # fmt: skip
def test_an_unexpected_field_makes_it_none(name: str, value: Any) -> None:
    fields = json.loads(json_line(transition()))
    assert is_transition(fields)
    assert not is_transition({**fields, name: value})
    assert not is_transition({})


def test_many_silenced_notifications_are_discarded_a_few_at_a_time() -> None:
    bench = Bench()
    for _ in range(60):
        bench.change("WARN")
        bench.change("OK", "WARN")
    bench.silences.alerts = {BATTERY}
    assert bench.take() is None and 0 < bench.queue.waiting["chat"] < 120
    while bench.queue.waiting["chat"]:
        assert bench.take() is None


def test_alerts_of_robots_that_are_no_longer_watched_end() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.change("WARN", signal="cpu", robot="r4")
    bench.deliver()
    bench.restart()
    bench.queue.end_unwatched(bench.connection, {"r4"}, 5000.0)
    taken = bench.take()
    assert taken is not None and described(taken) == ("battery", "resolved", "WARN")
    assert (taken.notification.text, taken.notification.at_s) == ("r3: battery OK: no longer watched", 5000.0)
    bench.queue.finish(bench.connection, taken)
    bench.restart()
    assert bench.deliver() == []
