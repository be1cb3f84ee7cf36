"""`statistic: count` against brute force over random timelines with downtime of the link and pauses; restarts."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from harness.seeds import examples

from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.values.model import Level

COUNT: dict[str, Any] = {"statistic": "count", "window_s": 60.0, "warn_above": 5, "error_above": 11, "hysteresis": 2}


def monitor_of(**changes: Any) -> Monitor:
    signal = {key: value for key, value in {**COUNT, **changes}.items() if value is not None}
    return Monitor(load_config({"signals": {"errors": signal}}))


def lines_of(calls: Any) -> list[str]:
    return [transition.text for changes in calls for transition in changes]


class Referee:
    """Counts all good samples again at each call, on a clock that stands still while the robot is not watched."""

    def __init__(self) -> None:
        self.left_out_s = 0.0
        self.samples: list[float] = []
        self.beyond = {Level.WARN: False, Level.ERROR: False}

    def count(self, now_s: float) -> int:
        clock_s = now_s - self.left_out_s
        return sum(1 for sample_s in self.samples if clock_s - sample_s < 60.0 - 1e-6)

    def level(self, now_s: float) -> Level:
        for level, bound in ((Level.WARN, 5), (Level.ERROR, 11)):
            number = self.count(now_s)
            self.beyond[level] = number > (bound - 2 if self.beyond[level] else bound)
        return max((level for level, beyond in self.beyond.items() if beyond), default=Level.OK)


@pytest.mark.newest_python
@pytest.mark.parametrize("seed", range(examples(20)))
def test_the_count_and_its_alerts_are_those_of_brute_force(seed: int) -> None:
    rng = random.Random(seed)
    monitor, referee = monitor_of(), Referee()
    now_s = 0.0
    monitor.tick(now_s)
    down_s: float | None = None
    for _ in range(400):
        # Quarters, so that samples are exactly a window old at some ticks.
        now_s += rng.choice([0.0, 0.25, 0.25, 1.0, 1.0, 2.5, 20.0])
        event = rng.choice("sssssttttdus" if down_s is None else "ttuu")
        if event == "s":
            monitor.observe(Sample("errors", 1.0, now_s))
            referee.samples.append(now_s - referee.left_out_s)
        elif event == "d" and down_s is None:
            monitor.set_link(False, "", now_s)
            down_s = now_s
        elif event == "u" and down_s is not None:
            monitor.set_link(True, "", now_s)
            referee.left_out_s += now_s - down_s
            down_s = None
        elif event == "u":
            paused_s = rng.choice([0.25, 30.0, 90.0])
            monitor.tick(now_s)
            monitor.skip(now_s, now_s + paused_s)
            referee.level(now_s)
            now_s += paused_s
            referee.left_out_s += paused_s
        else:
            monitor.tick(now_s)
        if down_s is None:
            monitor.tick(now_s)
            expected = referee.level(now_s)
            assert monitor.judgements(0.0)["errors"].judged == float(referee.count(now_s))
            assert monitor.report(now_s).statuses["errors"].level is expected


def test_an_alert_falls_with_the_time() -> None:
    monitor = monitor_of(error_above=None, hysteresis=0.0)
    calls = [monitor.tick(0.0)]
    for second in range(1, 13):
        calls += [monitor.observe(Sample("errors", 1.0, 10_800.0 + second)), monitor.tick(10_800.5 + second)]
    calls += [monitor.tick(10_800.5 + second) for second in range(13, 100)]
    assert lines_of(calls) == [
        "errors WARN: 6 in 60 s is above 5 (was OK for 3 h)",
        "errors OK: 5 in 60 s is no longer above 5 (was WARN for 61.5 s)",
    ]


def test_a_count_is_known_from_the_start_and_never_stale() -> None:
    monitor = monitor_of()
    assert lines_of(monitor.tick(float(now_s)) for now_s in range(600)) == []
    status = monitor.report(600.0).statuses["errors"]
    assert (status.level, status.state, status.message, status.values["count"]) == (
        Level.OK, "inactive", "0 in 60 s", "0"
    )  # fmt: skip


def test_a_sample_that_is_a_window_old_does_not_count() -> None:
    monitor = monitor_of()
    monitor.observe(Sample("errors", 1.0, 0.1))
    monitor.tick(60.0)
    assert monitor.judgements(0.0)["errors"].judged == 1.0
    monitor.tick(60.1)
    assert monitor.judgements(0.0)["errors"].judged == 0.0


def test_more_than_the_window_holds_are_at_least_so_many() -> None:
    monitor = monitor_of(window_samples=10, warn_above=5, error_above=None)
    said = lines_of(monitor.observe(Sample("errors", 1.0, 1.0)) for _ in range(10))
    assert said == ["errors WARN: 6 in 60 s is above 5 (was OK for 0 s)"]
    assert monitor.report(1.0).statuses["errors"].message == "10 in 60 s is above 5"
    monitor.observe(Sample("errors", 1.0, 1.0))
    assert monitor.report(1.0).statuses["errors"].message == "at least 10 in 60 s is above 5"
    monitor.tick(61.0)
    assert monitor.report(61.0).statuses["errors"].message == "0 in 60 s"


def test_bad_samples_do_not_count() -> None:
    monitor = monitor_of()
    for value in (1.0, math.nan, 1.0):
        monitor.observe(Sample("errors", value, 1.0))
    assert monitor.judgements(0.0)["errors"].judged == 2.0


def restarted(monitor: Monitor, now_s: float, **changes: Any) -> tuple[Monitor, list[str]]:
    after = monitor_of(**changes)
    state = monitor.snapshot("errors", now_s, 1000.0 + now_s)
    return after, lines_of([after.restore({"errors": state}, now_s, 1000.0 + now_s)])


def test_an_alert_that_holds_after_a_restart_is_not_announced_again() -> None:
    monitor = monitor_of(error_above=None)
    for now_s in range(10):
        monitor.observe(Sample("errors", 1.0, float(now_s)))
    after, said = restarted(monitor, 10.0, error_above=None)
    for now_s in range(10, 69):
        said += lines_of([after.tick(now_s + 0.5), after.observe(Sample("errors", 1.0, now_s + 0.5))])
    assert said == []
    assert after.report(69.0).statuses["errors"].level is Level.WARN
    assert after.report(69.0).statuses["errors"].message == "count is undefined until window_s (60 s) has passed"
    for now_s in range(69, 200):
        said += lines_of([after.tick(now_s + 0.5)])
    assert said == ["errors OK: 3 in 60 s is no longer above 5 (was WARN for 120 s)"]


def test_a_count_that_was_ok_before_a_restart_begins_at_0() -> None:
    monitor = monitor_of()
    monitor.tick(0.0)
    after, said = restarted(monitor, 10.0)
    said += lines_of(after.observe(Sample("errors", 1.0, 11.0)) for _ in range(6))
    assert said == ["errors WARN: 6 in 60 s is above 5 (was OK for 11 s)"]


def test_time_that_goes_back_leaves_an_alert_open_until_the_window_has_passed() -> None:
    monitor = monitor_of(error_above=None)
    said = lines_of(monitor.observe(Sample("errors", 1.0, 1000.0)) for _ in range(6))
    said += lines_of(monitor.tick(float(now_s)) for now_s in range(62))
    assert said == [
        "errors WARN: 6 in 60 s is above 5 (was OK for 0 s)",
        "errors OK: 0 in 60 s is no longer above 5 (was WARN for 60 s)",
    ]


def test_a_new_window_counts_what_is_in_it_now() -> None:
    monitor = monitor_of(warn_above=50, error_above=None)
    for now_s in range(6):
        monitor.observe(Sample("errors", 1.0, float(now_s)))
    monitor.tick(40.0)
    changes = load_config({"signals": {"errors": {**COUNT, "window_s": 20.0}}})
    assert lines_of([monitor.configure(changes)]) == []
    assert monitor.judgements(0.0)["errors"].judged == 0.0


def test_for_s_and_latch_apply_to_a_count() -> None:
    monitor = monitor_of(error_above=None, for_s=30.0, latch=True)
    said = []
    for now_s in range(10):
        said += lines_of([monitor.observe(Sample("errors", 1.0, float(now_s)))])
    said += lines_of(monitor.tick(float(now_s)) for now_s in range(10, 100))
    assert said == ["errors WARN: 10 in 60 s is above 5 (was OK for 35 s)"]
    assert monitor.report(100.0).statuses["errors"].state == "latched"
