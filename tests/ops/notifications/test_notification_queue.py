"""What each target is sent, and what it is not: levels, silences, restarts and outages."""

from __future__ import annotations

import json
import sqlite3
from typing import Any, Dict, List, Optional, Set, Tuple

import pytest
from harness.transitions import transition

from robot_health_monitor.core import Level
from robot_health_monitor.ops.configuration import TargetSettings
from robot_health_monitor.ops.history import schema
from robot_health_monitor.ops.notifications import notification_queue
from robot_health_monitor.ops.notifications.notification_queue import NotificationQueue, Taken

Sent = Tuple[str, str, Optional[str]]
"""Signal and level (or `resolved`), and the level that was open at the target before."""


class Bench:
    """A queue on a real database, with targets that work when asked to."""

    def __init__(self, *targets: TargetSettings) -> None:
        self.connection = sqlite3.connect(":memory:", isolation_level=None)
        schema.prepare(self.connection)
        self.silenced: Set[Tuple[str, str]] = set()
        self.simulated: Set[Tuple[str, str]] = set()
        self.now_s = 1000.0
        self.restart(*targets)

    def restart(self, *targets: TargetSettings) -> None:
        """Starts again with the same database."""
        targets = targets or (TargetSettings("chat", "webhook"),)
        self.queue = NotificationQueue(
            targets, lambda *alert: alert in self.silenced, lambda: None, lambda *alert: alert in self.simulated
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
        self.queue.note(self.connection, event, self.now_s)
        self.queue.distribute(self.connection)

    def take(self, target: str = "chat") -> Optional[Taken]:
        return self.queue.take(self.connection, target)

    def deliver(self, target: str = "chat") -> List[Sent]:
        """Delivers all that waits."""
        sent: List[Sent] = []
        while True:
            taken = self.take(target)
            if taken is None:
                return sent
            self.queue.finish(self.connection, taken)
            sent.append(described(taken))

    def expire_silences(self) -> None:
        self.silenced.clear()
        if self.queue.has_expired_silence():
            self.queue.reconcile(self.connection)


def described(taken: Taken) -> Sent:
    notification = taken.notification
    state = "resolved" if notification.is_resolved else notification.level.name
    return notification.signal, state, notification.before.level.name if notification.before else None


BATTERY = ("r3", "battery")


def test_an_alert_is_sent_when_it_begins_changes_and_ends() -> None:
    bench = Bench()
    bench.change("WARN")
    assert bench.queue.waiting("chat") == 1
    assert bench.deliver() == [("battery", "WARN", None)]
    bench.change("ERROR", "WARN")
    bench.change("OK", "ERROR")
    assert bench.deliver() == [("battery", "ERROR", "WARN"), ("battery", "resolved", "ERROR")]
    assert bench.queue.waiting("chat") == 0


@pytest.mark.parametrize(
    ("min_level", "sent"),
    [
        ("WARN", ["WARN", "STALE", "ERROR", "STALE", "WARN", "resolved"]),
        ("STALE", ["STALE", "ERROR", "STALE", "resolved"]),
        ("ERROR", ["ERROR", "resolved"]),
    ],
)
def test_below_min_level_nothing_is_sent_except_the_end_of_what_was_sent(min_level: str, sent: List[str]) -> None:
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
    assert [alert.since_s for alert in bench.queue.open_at(bench.connection, "chat")] == [begin_s]


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


def test_a_transition_that_was_only_noted_when_the_monitor_was_killed_is_sent() -> None:
    bench = Bench()
    for number in range(45):
        event = transition(robot="r3", signal=f"s{number}", fingerprint=f"fp-{number}")
        bench.queue.note(bench.connection, event, 1.0)
    assert bench.take() is None
    bench.restart()
    assert [signal for signal, _, _ in bench.deliver()] == [f"s{number}" for number in range(45)]


def test_transitions_are_distributed_a_bounded_number_at_a_time() -> None:
    bench = Bench()
    for number in range(45):
        bench.queue.note(bench.connection, transition(fingerprint=f"fp-{number}"), 1.0)
    assert [bench.queue.distribute(bench.connection) for _ in range(3)] == [True, True, False]
    assert bench.queue.waiting("chat") == 45


def test_a_silenced_alert_is_sent_once_when_the_silence_expires() -> None:
    bench = Bench()
    bench.silenced = {BATTERY}
    bench.change("WARN")
    assert bench.deliver() == [] and not bench.queue.has_expired_silence()
    bench.expire_silences()
    assert bench.deliver() == [("battery", "WARN", None)]
    bench.expire_silences()
    assert bench.deliver() == []


def test_a_silenced_alert_that_ends_during_the_silence_is_never_sent() -> None:
    bench = Bench()
    bench.silenced = {BATTERY}
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
    bench.silenced = {BATTERY}
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
    bench.silenced = {BATTERY}
    bench.change("ERROR", "WARN")
    bench.change("WARN", "ERROR")
    assert bench.deliver() == []
    bench.expire_silences()
    assert bench.deliver() == []


def test_a_level_that_changed_during_the_silence_is_sent_after_it() -> None:
    bench = Bench()
    bench.change("WARN")
    bench.deliver()
    bench.silenced = {BATTERY}
    bench.change("ERROR", "WARN")
    assert bench.deliver() == []
    open_alerts = bench.queue.open_at(bench.connection, "chat")
    assert [alert.level for alert in open_alerts] == [Level.WARN]  # repeated meanwhile: the target would end it
    bench.expire_silences()
    assert bench.deliver() == [("battery", "ERROR", "WARN")]


def test_a_silence_that_expired_while_the_monitor_was_down() -> None:
    bench = Bench()
    bench.silenced = {BATTERY}
    bench.change("WARN")
    bench.deliver()
    bench.silenced = set()
    bench.restart()
    assert bench.deliver() == [("battery", "WARN", None)]


def test_a_silence_that_outlasts_a_restart() -> None:
    bench = Bench()
    bench.silenced = {BATTERY}
    bench.change("WARN")
    bench.deliver()
    bench.restart()
    assert bench.deliver() == []
    bench.expire_silences()
    assert bench.deliver() == [("battery", "WARN", None)]


def test_a_silence_also_holds_back_what_already_waits() -> None:
    bench = Bench()
    bench.change("WARN")  # the target is gone, and then the alert is silenced
    bench.silenced = {BATTERY}
    assert bench.deliver() == []


def test_what_may_have_arrived_is_not_sent_again_during_a_silence_but_its_end_is() -> None:
    bench = Bench()
    bench.change("WARN")
    assert bench.take() is not None  # no response
    bench.silenced = {BATTERY}
    assert bench.deliver() == [] and bench.queue.waiting("chat") == 0
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
    bench.silenced = {BATTERY}
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
    bench.silenced = {BATTERY}
    bench.change("OK", "WARN")
    assert bench.take() is not None  # no response
    assert bench.deliver() == [("battery", "resolved", "WARN")]


def test_what_certainly_did_not_arrive_is_held_back_by_a_silence() -> None:
    bench = Bench()
    bench.change("WARN")
    taken = bench.take()
    assert taken is not None
    bench.queue.put_back(bench.connection, taken)
    bench.silenced = {BATTERY}
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
    assert [(alert.robot, alert.signal, alert.since_s, alert.text) for alert in open_alerts] == [
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
    assert bench.queue.waiting("chat") <= 21
    waiting, dropped = bench.queue.waiting("chat"), bench.queue.dropped("chat")
    assert waiting + dropped == 403
    sent = bench.deliver()
    # Not those of alerts that are open, and the end of each that was sent.
    assert ("open", "WARN", None) in sent
    assert [state for signal, state, _ in sent if signal == "attempted"] == ["WARN", "resolved"]
    states = [state for signal, state, _ in sent if signal == "battery"]
    assert states == ["WARN", "resolved"] * (len(states) // 2)
    assert bench.queue.dropped("chat") == 0


def test_a_full_queue_keeps_the_latest_of_every_open_alert(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notification_queue, "MOST_WAITING", 20)
    monkeypatch.setattr(notification_queue, "_DROPPED_AT_ONCE", 5)
    bench = Bench()
    for number in range(60):
        bench.change("WARN", signal=f"s{number}")
    assert bench.queue.waiting("chat") == 60 and bench.queue.dropped("chat") == 0
    for number in range(60):
        bench.change("ERROR", "WARN", signal=f"s{number}")
    assert bench.queue.waiting("chat") <= 80
    last: Dict[str, str] = {signal: state for signal, state, _ in bench.deliver()}
    assert last == {f"s{number}": "ERROR" for number in range(60)}


def test_many_silenced_notifications_are_discarded_a_few_at_a_time() -> None:
    bench = Bench()
    for _ in range(60):
        bench.change("WARN")
        bench.change("OK", "WARN")
    bench.silenced = {BATTERY}
    assert bench.take() is None and 0 < bench.queue.waiting("chat") < 120
    while bench.queue.waiting("chat"):
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
