"""The rules of a signal: condition with hysteresis, the states of a Prometheus alert, the level, and what is saved."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core import Level
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.judge.rule import Rule, SignalRules, State
from robot_health_monitor.core.judge.saved_state import Downtime, SavedState, UnusableStateError


def rule(
    below: float | None = None,
    above: float | None = None,
    hysteresis: float = 0.0,
    for_s: float = 0.0,
    keep_firing_for_s: float = 0.0,
) -> Rule:
    rule = Rule()
    rule.configure(below, above, for_s, keep_firing_for_s, hysteresis)
    return rule


def fires_after(rule: Rule, *values: float) -> list[bool]:
    """Judges one value per second and returns whether the rule fired after each."""
    result = []
    for second, value in enumerate(values):
        rule.judge(value, float(second))
        result.append(rule.fires)
    return result


@pytest.mark.parametrize(
    ("bound", "value", "crossed"),
    [
        ({"below": 20.0}, 20.0, False),
        ({"below": 20.0}, 19.999999, True),
        ({"above": 80.0}, 80.0, False),
        ({"above": 80.0}, 80.000001, True),
    ],
)
def test_bounds_are_strict(bound: dict, value: float, crossed: bool) -> None:
    assert fires_after(rule(**bound), value) == [crossed]


def test_below_clears_at_bound_plus_hysteresis_and_not_before() -> None:
    assert fires_after(rule(below=20.0, hysteresis=2.0), 19.0, 20.0, 21.999, 22.0) == [True, True, True, False]


def test_above_clears_at_bound_minus_hysteresis_and_not_before() -> None:
    assert fires_after(rule(above=80.0, hysteresis=5.0), 81.0, 80.0, 75.001, 75.0) == [True, True, True, False]


def test_hysteresis_does_not_make_a_condition_true() -> None:
    assert fires_after(rule(below=20.0, hysteresis=2.0), 21.0, 20.0) == [False, False]


def test_without_hysteresis_the_bound_itself_clears() -> None:
    assert fires_after(rule(below=20.0), 19.0, 20.0) == [True, False]


def test_a_value_that_jumps_from_one_bound_past_the_other_fires_without_a_break() -> None:
    both = rule(below=20.0, above=80.0, keep_firing_for_s=0.0)
    assert fires_after(both, 10.0, 90.0, 50.0) == [True, True, False]


def test_the_bound_is_the_one_crossed_last() -> None:
    both = rule(below=20.0, above=80.0)
    both.judge(10.0, 0.0)
    assert (both.bound, both.is_below) == (20.0, True)
    both.judge(90.0, 1.0)
    assert (both.bound, both.is_below) == (80.0, False)


def test_equal_bounds_on_both_sides_still_know_which_side_was_crossed() -> None:
    both = rule(below=50.0, above=50.0)
    both.judge(51.0, 0.0)
    assert (both.bound, both.is_below) == (50.0, False)
    both.judge(49.0, 1.0)
    assert (both.bound, both.is_below) == (50.0, True)


def test_for_s_fires_when_the_time_is_up_and_not_before() -> None:
    waiting = rule(below=20.0, for_s=3.0)
    assert fires_after(waiting, 19.0, 19.0, 19.0, 19.0) == [False, False, False, True]


def test_a_break_while_pending_starts_the_time_again() -> None:
    waiting = rule(below=20.0, for_s=2.0)
    assert fires_after(waiting, 19.0, 19.0, 25.0, 19.0, 19.0, 19.0) == [False, False, False, False, False, True]


def test_keep_firing_for_s_holds_on_until_it_has_been_false_without_a_break() -> None:
    keeping = rule(below=20.0, keep_firing_for_s=2.0)
    values = [19.0, 25.0, 25.0, 19.0, 25.0, 25.0, 25.0]
    assert fires_after(keeping, *values) == [True, True, True, True, True, True, False]


def test_time_alone_fires_a_pending_rule_and_clears_a_keeping_one() -> None:
    both = rule(below=20.0, for_s=3.0, keep_firing_for_s=2.0)
    both.judge(19.0, 0.0)
    both.advance(2.9)
    assert both.state is State.PENDING
    both.advance(3.0)
    assert both.state is State.FIRING
    both.judge(25.0, 4.0)
    assert both.state is State.KEEPING and both.fires
    both.advance(5.9)
    assert both.state is State.KEEPING
    both.advance(6.0)
    assert both.state is State.INACTIVE and not both.fires


def test_decimal_seconds_add_up_to_for_s() -> None:
    """4.1 - 1.1 is 3 s for people and 2.9999999999999996 for a computer; so are seconds since 1970."""
    waiting = rule(below=20.0, for_s=3.0)
    waiting.judge(19.0, 1.1)
    waiting.judge(19.0, 4.09)
    assert waiting.state is State.PENDING
    waiting.judge(19.0, 4.1)
    assert waiting.state is State.FIRING

    waiting = rule(below=20.0, for_s=0.1)
    waiting.judge(19.0, 1700000000.1)
    waiting.judge(19.0, 1700000000.2)
    assert waiting.state is State.FIRING


TABLE: list[tuple[State, bool, State]] = [
    (State.INACTIVE, True, State.PENDING),
    (State.INACTIVE, False, State.INACTIVE),
    (State.PENDING, True, State.PENDING),
    (State.PENDING, False, State.INACTIVE),
    (State.FIRING, True, State.FIRING),
    (State.FIRING, False, State.KEEPING),
    (State.KEEPING, True, State.FIRING),
    (State.KEEPING, False, State.KEEPING),
]


@pytest.mark.parametrize(("state", "condition", "then"), TABLE)
def test_each_state_takes_the_row_of_the_table(state: State, condition: bool, then: State) -> None:
    under_test = rule(below=20.0, for_s=10.0, keep_firing_for_s=10.0)
    if state is not State.INACTIVE:
        under_test.judge(19.0, 0.0)
    if state in (State.FIRING, State.KEEPING):
        under_test.advance(10.0)
    if state is State.KEEPING:
        under_test.judge(25.0, 11.0)
    assert under_test.state is state

    under_test.judge(19.0 if condition else 25.0, 12.0 if state in (State.FIRING, State.KEEPING) else 1.0)

    assert under_test.state is then


def test_a_rule_without_bounds_never_fires() -> None:
    assert fires_after(rule(), -1e308, 1e308, 0.0) == [False, False, False]


def test_infinite_waits_of_huge_times_raise_nothing() -> None:
    waiting = rule(below=20.0, for_s=1e308)
    waiting.judge(1.0, -1.7e308)
    waiting.judge(1.0, 1.7e308)
    assert waiting.fires


def test_new_bounds_apply_to_the_next_value_and_a_firing_rule_keeps_firing() -> None:
    under_test = rule(below=20.0, for_s=5.0)
    under_test.judge(19.0, 0.0)
    under_test.judge(19.0, 5.0)
    under_test.configure(25.0, None, 5.0)
    under_test.judge(24.0, 6.0)
    assert under_test.state is State.FIRING and under_test.bound == 25.0


def test_an_old_bounds_hysteresis_does_not_hold_under_a_new_bound() -> None:
    under_test = rule(below=20.0, hysteresis=5.0)
    under_test.judge(19.0, 0.0)
    under_test.configure(10.0, None, hysteresis=5.0)
    under_test.judge(14.0, 1.0)
    assert not under_test.fires


def test_a_rule_that_keeps_firing_under_a_new_bound_still_knows_the_side_it_crossed() -> None:
    under_test = rule(below=20.0, keep_firing_for_s=10.0)
    under_test.judge(19.0, 0.0)
    under_test.judge(30.0, 1.0)
    under_test.configure(25.0, None, 0.0, 10.0)
    assert (under_test.bound, under_test.is_below) == (20.0, True)


def test_a_saved_state_that_is_unknown_is_refused() -> None:
    rule = Rule()
    rule.configure(below=20.0)
    with pytest.raises(UnusableStateError) as error:
        rule.exchange(SavedState(0.0, {"fires": "asleep"}, Downtime(0.0, 0.0)))
    assert str(error.value) == "fires: expected a bool, got 'asleep'"


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
    assert level(signal) is Level.OK and signal.explaining(Level.OK, None) is signal.rules[Level.WARN]
    signal.configure(read_signal("battery_level", BOUNDS))
    signal.advance(1.0)
    assert level(signal) is Level.WARN


def test_ok_is_explained_by_the_rule_that_is_pending_or_has_just_cleared() -> None:
    signal = rules(error_for_s=5.0, for_s=5.0)
    signal.judge(15.0, 0.0)
    assert signal.explaining(Level.OK, None) is signal.rules[Level.WARN]
    signal.judge(50.0, 1.0)
    assert signal.explaining(Level.OK, None) is None
    assert signal.explaining(Level.OK, signal.rules[Level.WARN]) is signal.rules[Level.WARN]


def test_bounds_are_frozen_while_the_statistic_is_undefined_and_invalid_data_are_not() -> None:
    signal = rules(for_s=2.0, invalid_for_s=2.0)
    signal.judge(15.0, 0.0)
    signal.note_quality(good=False, now_s=0.0)
    signal.freeze_or_thaw(0.0, unknown=False, undefined=True)
    signal.advance(2.0)
    assert (signal.rules[Level.WARN].fires, signal.invalid.fires) == (False, True)
    signal.freeze_or_thaw(10.0, unknown=False, undefined=False)
    signal.advance(11.9)
    assert not signal.rules[Level.WARN].fires
    signal.advance(12.0)
    assert signal.rules[Level.WARN].fires


def test_a_state_that_is_saved_is_restored_as_far_as_there_are_bounds() -> None:
    signal = rules(latch=True)
    signal.judge(5.0, 0.0)
    assert level(signal) is Level.ERROR
    saved: dict[str, Any] = {}
    signal.exchange(SavedState(1.0, saved))
    assert sorted(filter(saved.get, saved)) == ["error", "latched", "warn"] and saved["latched"] == "ERROR"
    again = rules(latch=True)
    again.exchange(SavedState(100.0, saved, Downtime(0.0, 0.0)))
    assert (level(again), again.rules[Level.ERROR].fires, again.rules[Level.WARN].fires) == (Level.ERROR, True, True)
    without = SignalRules(read_signal("battery_level", {"warn_below": 20.0}))
    without.exchange(SavedState(100.0, saved, Downtime(0.0, 0.0)))
    assert (level(without), without.rules[Level.ERROR].fires) == (Level.WARN, False)


def test_a_state_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(UnusableStateError, match="latched: expected a level, got 'HIGH'"):
        rules().exchange(SavedState(0.0, {"latched": "HIGH"}, Downtime(0.0, 0.0)))
