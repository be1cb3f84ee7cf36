"""The rules of one signal together: its level, its state, the rule that explains it, and what is saved."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core import Level
from robot_health_monitor.core.signal_config import read_signal
from robot_health_monitor.core.signal_rules import SignalRules
from robot_health_monitor.core.state_reader import Saved, UnusableStateError

BOUNDS = {"warn_below": 20.0, "error_below": 10.0}


def rules(**settings: Any) -> SignalRules:
    return SignalRules(read_signal("battery_level", {**BOUNDS, **settings}))


def level(signal: SignalRules) -> Level:
    return signal.level(stale=False)


def test_the_level_is_that_of_the_worst_rule_that_fires() -> None:
    signal = rules()
    found = []
    for now_s, value in enumerate((50.0, 15.0, 5.0, 15.0, 50.0)):
        signal.judge(value, float(now_s))
        found.append(level(signal))
    assert found == [Level.OK, Level.WARN, Level.ERROR, Level.WARN, Level.OK]


def test_invalid_data_are_an_error_and_staleness_is_not_hidden_by_a_warning() -> None:
    signal = rules()
    signal.judge(15.0, 0.0)
    assert signal.level(stale=True) is Level.STALE
    signal.note_quality(good=False, now_s=1.0)
    assert (signal.level(stale=True), signal.state) == (Level.ERROR, "invalid")
    signal.note_quality(good=True, now_s=2.0)
    assert (level(signal), signal.state) == (Level.WARN, "firing")


def test_an_error_that_fires_is_not_hidden_by_staleness() -> None:
    signal = rules()
    signal.judge(5.0, 0.0)
    assert signal.level(stale=True) is Level.ERROR


def test_a_latch_keeps_the_worst_level_until_it_is_released() -> None:
    signal = rules(latch=True)
    signal.judge(5.0, 0.0)
    assert level(signal) is Level.ERROR
    signal.judge(50.0, 1.0)
    assert (level(signal), signal.state) == (Level.ERROR, "latched")
    signal.release_latch()
    assert (level(signal), signal.state) == (Level.OK, "inactive")


def test_without_a_latch_in_the_configuration_nothing_stays_latched() -> None:
    signal = rules(latch=True)
    signal.judge(5.0, 0.0)
    assert level(signal) is Level.ERROR
    signal.judge(50.0, 1.0)
    signal.configure(read_signal("battery_level", BOUNDS))
    assert level(signal) is Level.OK


def test_a_rule_whose_bounds_are_removed_is_inactive() -> None:
    signal = rules()
    signal.judge(5.0, 0.0)
    signal.configure(read_signal("battery_level", {"warn_below": 20.0}))
    assert level(signal) is Level.WARN


def test_a_condition_that_is_removed_no_longer_holds_a_rule_back() -> None:
    condition = {"signal": "charging", "is": 0.0}
    signal = rules(only_if=condition)
    signal.allow(False)
    signal.judge(15.0, 0.0)
    assert level(signal) is Level.OK and signal.explaining(Level.OK, None) is signal.warn
    signal.configure(read_signal("battery_level", BOUNDS))
    signal.advance(1.0)
    assert level(signal) is Level.WARN


def test_ok_is_explained_by_the_rule_that_is_pending_or_has_just_cleared() -> None:
    signal = rules(error_for_s=5.0, for_s=5.0)
    signal.judge(15.0, 0.0)
    assert signal.explaining(Level.OK, None) is signal.warn
    signal.judge(50.0, 1.0)
    assert signal.explaining(Level.OK, None) is None
    assert signal.explaining(Level.OK, signal.warn) is signal.warn


def test_bounds_are_frozen_while_the_statistic_is_undefined_and_invalid_data_are_not() -> None:
    signal = rules(for_s=2.0, invalid_for_s=2.0)
    signal.judge(15.0, 0.0)
    signal.note_quality(good=False, now_s=0.0)
    signal.freeze_or_thaw(0.0, unknown=False, undefined=True)
    signal.advance(2.0)
    assert (signal.warn.fires, signal.invalid.fires) == (False, True)
    signal.freeze_or_thaw(10.0, unknown=False, undefined=False)
    signal.advance(11.9)
    assert not signal.warn.fires
    signal.advance(12.0)
    assert signal.warn.fires


def test_a_state_that_is_saved_is_restored_as_far_as_there_are_bounds() -> None:
    signal = rules(latch=True)
    signal.judge(5.0, 0.0)
    assert level(signal) is Level.ERROR
    saved = signal.snapshot(1.0)
    assert sorted(saved) == ["error", "latched", "warn"] and saved["latched"] == "ERROR"
    again = rules(latch=True)
    again.restore(Saved(saved), 100.0)
    assert (level(again), again.error.fires, again.warn.fires) == (Level.ERROR, True, True)
    without = SignalRules(read_signal("battery_level", {"warn_below": 20.0}))
    without.restore(Saved(saved), 100.0)
    assert (level(without), without.error.fires) == (Level.WARN, False)


def test_a_state_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(UnusableStateError, match="latched: expected a level, got 'HIGH'"):
        rules().restore(Saved({"latched": "HIGH"}), 0.0)
