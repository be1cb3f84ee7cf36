"""One signal: its state, and the value that other signals may use."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from harness.seeds import fixed_seed

from robot_health_monitor.core import Level, Status, Transition
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.judge import wording
from robot_health_monitor.core.judge.sample_summary import SampleCollector
from robot_health_monitor.core.judge.signal_monitor import SignalMonitor


def watch(name: str = "battery_level", **settings: Any) -> SignalMonitor:
    return SignalMonitor(read_signal(name, settings), "atlas", 0.0)


def status(signal: SignalMonitor, now_s: float) -> Status:
    return wording.status(signal.judgement(now_s))


def message(signal: SignalMonitor, now_s: float) -> str:
    return status(signal, now_s).message


def state(signal: SignalMonitor, now_s: float) -> str:
    return status(signal, now_s).values["state"]


# --- the state in a word --------------------------------------------------------------------------------------------


def test_the_state_is_that_of_the_rule_behind_the_level() -> None:
    signal = watch(warn_below=20.0, error_below=10.0, error_for_s=5.0, error_keep_firing_for_s=5.0)
    assert state(signal, 0.0) == "waiting"
    signal.observe(50.0, 0.5)
    assert state(signal, 0.5) == "inactive"
    signal.observe(5.0, 1.0)  # WARN fires, ERROR is pending
    assert (signal.level, state(signal, 1.0)) == (Level.WARN, "firing")
    signal.observe(5.0, 6.0)
    assert (signal.level, state(signal, 6.0)) == (Level.ERROR, "firing")
    signal.observe(15.0, 7.0)  # ERROR keeps firing
    assert (signal.level, state(signal, 7.0)) == (Level.ERROR, "keeps firing")
    signal.observe(15.0, 12.0)
    assert (signal.level, state(signal, 12.0)) == (Level.WARN, "firing")


def test_a_pending_rule_is_seen_while_the_level_is_ok() -> None:
    signal = watch(warn_below=20.0, for_s=5.0)
    signal.observe(15.0, 1.0)
    assert (signal.level, state(signal, 1.0)) == (Level.OK, "pending")


def test_a_latched_error_is_latched_also_while_a_warning_fires() -> None:
    signal = watch(warn_below=20.0, error_below=10.0, latch=True)
    signal.observe(5.0, 1.0)
    signal.observe(15.0, 2.0)
    assert (signal.level, state(signal, 2.0)) == (Level.ERROR, "latched")
    assert message(signal, 2.0) == "15 is no longer below 10, latched until reset"


# --- the latest good value ----------------------------------------------------------------------------------


def test_the_latest_good_is_the_latest_good_one_and_none_while_it_cannot_be_trusted() -> None:
    signal = watch(stale_after_s=5.0, valid_max=100.0)
    assert signal.latest_good is None
    signal.observe(50.0, 0.0)
    assert signal.latest_good == 50.0
    signal.observe(101.0, 1.0)
    assert signal.latest_good is None
    signal.observe(60.0, 2.0)
    assert signal.latest_good == 60.0
    signal.tick(8.0)
    assert signal.latest_good is None


def test_the_latest_good_is_the_value_and_not_the_statistic() -> None:
    signal = watch(statistic="max")
    signal.observe(50.0, 0.0)
    signal.observe(10.0, 1.0)
    assert signal.latest_good == 10.0


# --- signals that are settled ---------------------------------------------------------------------------------------


class NeverSettled(SignalMonitor):
    """Judges every sample in every step."""

    def observe(self, value: object, now_s: float) -> Transition | None:
        self._unsettle()
        return super().observe(value, now_s)


KINDS = (SignalMonitor, NeverSettled)
RULES = {"warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0, "valid_max": 100.0}
DETAILS: list[dict[str, Any]] = [
    {"for_s": 2.0, "keep_firing_for_s": 3.0}, {"latch": True}, {"flap_detection": True}, {"repeat_s": 5.0},
    {"only_if": {"signal": "charging", "is": 0.0}}, {"scale": 0.5}, {"stale_after_s": 4.0}, {"invalid_for_s": 2.0},
    {"latch": True, "latch_release_if": {"signal": "charging", "is": 1.0}},
    *({"statistic": name, "window_s": 5.0} for name in ("mean", "min", "stddev", "rate", "largest_gap_s", "count")),
    {"statistic": "forecast", "window_s": 10.0, "forecast_s": 5.0},
]  # fmt: skip


@pytest.mark.newest_python
@pytest.mark.parametrize("details", DETAILS, ids=repr)
def test_a_settled_signal_is_judged_as_if_every_sample_were_judged_in_every_step(details: dict[str, Any]) -> None:
    chance = random.Random(fixed_seed())
    for _ in range(10):
        signals = [each(read_signal("level", {**RULES, **details}), "atlas", 0.0) for each in KINDS]
        for each in signals:
            each.collector = SampleCollector(lambda: 0.0)
        now_s, charging, value = 0.0, 0.0, 50.0
        for _ in range(150):
            now_s += chance.choice((0.0, 0.2, 0.5, 1.0, 1.0, 6.0))
            value = chance.choice((value, value, value, 50.0, 50, 20.0, 21.0, 15.0, 5.0, 0.0, math.nan, 200.0))
            charging = chance.choice((charging, charging, 0.0, 1.0))
            action = chance.choice(("observe",) * 12 + ("tick",) * 3 + ("follow", "link", "reset", "cause"))
            outcomes = [repr(act(each, action, value, charging, now_s)) for each in signals]  # NaN is not equal to NaN
            assert outcomes[0] == outcomes[1]
            assert status(signals[0], now_s) == status(signals[1], now_s)
            assert signals[0].at_rest_since_s == signals[1].at_rest_since_s
        collected = [each.collector and each.collector.take(math.inf) for each in signals]
        assert collected[0] == collected[1]


def act(signal: SignalMonitor, action: str, value: float, charging: float, now_s: float) -> list[Transition | None]:
    if action == "observe":
        return [signal.observe(value, now_s)]
    if action == "tick":
        return [signal.tick(now_s)]
    if action == "follow":
        return [signal.follow(lambda _: charging, now_s)]
    if action == "reset":
        return [signal.reset(now_s)]
    if action == "cause":
        return [signal.note_cause("power" if charging else "", now_s)]
    if signal.staleness.unreachable_since_s is None:
        signal.inhibit(now_s)
        return []
    return [signal.release(now_s)]
