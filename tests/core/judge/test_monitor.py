"""Every rule of docs/rules.md, through the calls that a node makes."""

from __future__ import annotations

import hashlib
import math
import random
from typing import Any, Sequence

import pytest

from robot_health_monitor.core import (
    ConfigError,
    Level,
    Monitor,
    MonitorConfig,
    Report,
    Sample,
    Status,
    Transition,
    load_config,
)
from robot_health_monitor.core.judge import wording
from robot_health_monitor.core.values.model import Forecast

OK, WARN, ERROR, STALE = Level.OK, Level.WARN, Level.ERROR, Level.STALE


class Watched:
    """One signal `battery_level` under watch; keeps what was announced as (time, level)."""

    def __init__(self, **settings: Any) -> None:
        self.monitor = Monitor(load_config({"signals": {"battery_level": settings}}), "atlas")
        self.transitions: list[Transition] = []

    def observe(self, value: object, now_s: float) -> Transition | None:
        return self._note(self.monitor.observe(Sample("battery_level", value, now_s)))

    def tick(self, now_s: float) -> Transition | None:
        return self._note(self.monitor.tick(now_s))

    def reset(self) -> Transition | None:
        return self._note(self.monitor.reset())

    def configure(self, **settings: Any) -> Transition | None:
        return self._note(self.monitor.configure(load_config({"signals": {"battery_level": settings}})))

    def each_second(self, *values: object, start_s: float = 0.0) -> list[tuple[float, Level]]:
        """Feeds a value per second (None: a tick instead) and returns what was announced, in these seconds."""
        before = len(self.transitions)
        for second, value in enumerate(values):
            now_s = start_s + second
            if value is None:
                self.tick(now_s)
            else:
                self.observe(value, now_s)
        return [(each.now_s, each.to_level) for each in self.transitions[before:]]

    def status(self, now_s: float = 1e9) -> Status:
        return self.monitor.report(now_s).statuses["battery_level"]

    @property
    def level(self) -> Level:
        return self.status().level

    def _note(self, transitions: Sequence[Transition]) -> Transition | None:
        self.transitions.extend(transitions)
        assert len(transitions) <= 1
        return transitions[0] if transitions else None


# --- the example of the README ---------------------------------------------------------------------------------------


def test_the_library_example_of_the_readme_works() -> None:
    monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0, "for_s": 3.0}}}))
    seen = []
    for now_s, percent in enumerate([25.0, 19.0, 18.0, 18.0, 18.0]):
        seen += monitor.observe(Sample("battery_level", percent, float(now_s)))

    assert [(each.from_level, each.to_level, each.now_s) for each in seen] == [(OK, WARN, 4.0)]
    assert monitor.tick(5.0) == []
    assert monitor.report(5.0).statuses["battery_level"].level is WARN


# --- conditions -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "fine", "alert"),
    [({"warn_below": 20.0}, 20.0, 19.999), ({"warn_above": 80.0}, 80.0, 80.001)],
)
def test_a_value_at_exactly_its_bound_is_not_an_alert(settings: dict[str, float], fine: float, alert: float) -> None:
    watched = Watched(**settings)
    assert watched.each_second(fine, fine, alert) == [(2.0, WARN)]


def test_a_battery_that_stays_low_for_an_hour_is_one_line() -> None:
    watched = Watched(warn_below=20.0)
    assert watched.each_second(*[15.0] * 3600) == [(0.0, WARN)]


def test_hysteresis_clears_below_at_22_and_above_at_75() -> None:
    assert Watched(warn_below=20.0, hysteresis=2.0).each_second(19.0, 21.9, 22.0) == [(0.0, WARN), (2.0, OK)]
    assert Watched(warn_above=80.0, hysteresis=5.0).each_second(81.0, 75.1, 75.0) == [(0.0, WARN), (2.0, OK)]


def test_the_level_is_that_of_the_worst_firing_rule() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0)
    assert watched.each_second(15.0, 5.0, 15.0, 25.0) == [(0.0, WARN), (1.0, ERROR), (2.0, WARN), (3.0, OK)]


def test_an_error_bound_alone_is_enough() -> None:
    assert Watched(error_above=95.0).each_second(95.0, 96.0, 95.0) == [(1.0, ERROR), (2.0, OK)]


# --- durations ------------------------------------------------------------------------------------------------------


def test_for_s_holds_for_warn_and_error() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, for_s=2.0)
    assert watched.each_second(5.0, 5.0, 5.0) == [(2.0, ERROR)]


def test_error_for_s_overrides_for_s_for_error_only() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, for_s=1.0, error_for_s=3.0)
    assert watched.each_second(5.0, 5.0, 5.0, 5.0) == [(1.0, WARN), (3.0, ERROR)]


def test_error_for_s_of_0_fires_at_once_whatever_for_s_says() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, for_s=5.0, error_for_s=0.0)
    assert watched.each_second(5.0) == [(0.0, ERROR)]


def test_keep_firing_for_s_holds_for_both_and_error_keep_firing_for_s_overrides_it() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, keep_firing_for_s=3.0)
    assert watched.each_second(5.0, 50.0, 50.0, 50.0, 50.0) == [(0.0, ERROR), (4.0, OK)]
    watched = Watched(warn_below=20.0, error_below=10.0, keep_firing_for_s=3.0, error_keep_firing_for_s=1.0)
    assert watched.each_second(5.0, 50.0, 50.0, 50.0, 50.0) == [(0.0, ERROR), (2.0, WARN), (4.0, OK)]


def test_a_tick_between_samples_fires_what_is_due() -> None:
    watched = Watched(warn_below=20.0, for_s=2.0)
    assert watched.each_second(19.0, None, None) == [(2.0, WARN)]


def test_voltage_sag_shorter_than_for_s_is_no_alert() -> None:
    watched = Watched(warn_below=20.0, for_s=3.0)
    assert watched.each_second(25.0, 18.0, 18.0, 18.0, 25.0, 18.0, 18.0, 18.0, 25.0) == []


# --- statistics as the judged quantity ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("statistic", "settings", "values", "expected", "judged"),
    [
        ("mean", {"warn_above": 15.0}, [10.0, 20.0, 18.0], [(2.0, WARN)], 16.0),
        ("min", {"warn_below": 15.0}, [20.0, 14.0, 30.0], [(1.0, WARN)], 14.0),
        ("max", {"warn_above": 15.0}, [10.0, 16.0, 1.0], [(1.0, WARN)], 16.0),
        ("stddev", {"warn_above": 4.0}, [10.0, 18.0, 20.0], [(2.0, WARN)], math.sqrt(56 / 3)),
        ("rate", {"warn_below": -4.0}, [50.0, 46.0, 41.0], [(2.0, WARN)], -4.5),
    ],
)
def test_a_bound_applies_to_the_signals_statistic(
    statistic: str, settings: dict[str, float], values: list[float], expected: list[Any], judged: float
) -> None:
    watched = Watched(statistic=statistic, window_min_s=0.0, **settings)
    assert watched.each_second(*values) == expected
    assert watched.transitions[0].statistic == statistic
    assert watched.transitions[0].value == pytest.approx(judged)


def test_a_frequency_rule_is_the_same_rule() -> None:
    watched = Watched(statistic="frequency_hz", warn_below=5.0, window_s=1.0, window_min_s=0.0, unit="%")
    for step in range(11):
        watched.observe(50.0, step * 0.1)
    assert watched.transitions == []
    watched.observe(50.0, 1.5)  # six samples from 0.5 to 1.0 and this one: 6 arrivals in 1 s
    assert watched.transitions == []
    watched.observe(50.0, 2.0)  # from 1.0 on: 2 in 1 s

    (transition,) = watched.transitions
    assert transition.text == "battery_level WARN: rate 2 Hz is below 5 Hz (was OK for 2 s)"


def test_a_rates_unit_is_per_second() -> None:
    watched = Watched(statistic="rate", warn_below=-4.0, window_min_s=0.0, unit="%")
    watched.each_second(50.0, 44.0, 38.0)
    assert watched.transitions[0].text == "battery_level WARN: rate -6 %/s is below -4 %/s (was OK for 2 s)"


def test_an_undefined_statistic_judges_nothing() -> None:
    watched = Watched(statistic="rate", warn_below=1e9, stale_after_s=0.0, window_s=1.0, window_min_s=0.0)
    watched.observe(50.0, 0.0)
    watched.observe(40.0, 0.5)
    assert watched.level is OK
    watched.observe(30.0, 1.0)
    assert watched.level is WARN
    watched.observe(60.0, 10.0)  # alone in the window
    assert watched.level is WARN


def test_a_mean_does_not_alert_before_window_min_s_has_passed() -> None:
    watched = Watched(statistic="mean", warn_above=15.0, window_s=10.0)  # window_min_s: 5
    assert watched.each_second(*[20.0] * 8) == [(5.0, WARN)]
    watched = Watched(statistic="mean", warn_above=15.0, window_s=10.0)
    watched.each_second(20.0, 20.0)
    assert watched.status().message == "mean is undefined until window_min_s (5 s) has passed"
    assert "mean" not in watched.status().values


def test_window_min_s_of_0_judges_the_first_sample() -> None:
    assert Watched(statistic="mean", warn_above=15.0, window_min_s=0.0).each_second(20.0) == [(0.0, WARN)]


def test_last_is_judged_at_once_whatever_window_min_s_says() -> None:
    assert Watched(warn_above=15.0, window_min_s=60.0).each_second(20.0) == [(0.0, WARN)]


def test_window_min_s_counts_again_after_staleness_and_after_time_went_back() -> None:
    watched = Watched(statistic="max", warn_above=15.0, window_s=10.0, window_min_s=3.0)
    watched.each_second(1.0, 1.0, 1.0, 1.0)
    watched.tick(9.0)
    assert watched.each_second(20.0, 20.0, 20.0, 20.0, start_s=10.0) == [(10.0, OK), (13.0, WARN)]
    watched = Watched(statistic="max", warn_above=15.0, window_s=10.0, window_min_s=3.0)
    watched.each_second(1.0, 1.0, 1.0, 1.0, start_s=100.0)
    assert watched.each_second(20.0, 20.0, 20.0, 20.0) == [(3.0, WARN)]


def test_an_undefined_statistic_neither_fires_nor_clears_a_rule() -> None:
    watched = Watched(statistic="mean", warn_above=15.0, window_s=4.0, window_min_s=2.0, for_s=9.0)
    watched.each_second(20.0, 20.0, 20.0, 20.0)  # pending since 2
    watched.tick(9.0)  # stale since 8, with 6 s of 9 passed
    assert watched.each_second(20.0, None, None, start_s=100.0) == [(100.0, OK)]
    # Defined again at 102; frozen until then.
    assert watched.each_second(20.0, 20.0, 20.0, start_s=102.0) == []
    assert watched.each_second(20.0, start_s=105.0) == [(105.0, WARN)]


# --- quality --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (math.nan, "invalid data: nan"),
        (math.inf, "invalid data: inf % is above valid_max 100"),
        (-math.inf, "invalid data: -inf % is below valid_min 0"),
        (100.5, "invalid data: 100.5 % is above valid_max 100"),
        (-0.5, "invalid data: -0.5 % is below valid_min 0"),
        ("full", "invalid data: 'full'"),
        (None, "invalid data: None"),
        ([50.0], "invalid data: [50.0]"),
        (10**400, "invalid data: 1" + "0" * 36 + "..."),
    ],
)
def test_bad_data_is_an_error_that_says_what_was_seen(value: object, said: str) -> None:
    watched = Watched(valid_min=0.0, valid_max=100.0, unit="%", warn_below=20.0)
    watched.observe(50.0, 0.0)
    transition = watched.observe(value, 1.0)

    assert transition is not None
    assert transition.text == f"battery_level ERROR: {said} (was OK for 1 s)"
    assert (transition.value is value, transition.bound) == (True, None)
    assert watched.status().message == said
    assert (watched.status().values["good_samples"], watched.status().values["bad_samples"]) == ("1", "1")


def test_the_ends_of_the_valid_range_are_valid() -> None:
    watched = Watched(valid_min=0.0, valid_max=100.0)
    assert watched.each_second(0.0, 100.0) == []


def test_a_good_sample_ends_the_error_of_a_bad_one_at_once() -> None:
    watched = Watched(valid_min=0.0, valid_max=100.0)
    assert watched.each_second(50.0, math.nan, 50.0) == [(1.0, ERROR), (2.0, OK)]


def test_bad_data_enters_no_window_and_no_rule() -> None:
    watched = Watched(warn_above=80.0, valid_max=100.0, latch=True, window_min_s=0.0)
    watched.each_second(50.0, 101.0, math.nan, 50.0)
    assert watched.level is OK
    assert watched.status().values["window_samples"] == "2"
    assert watched.status().values["max"] == "50"


def test_invalid_for_s_waits_and_a_good_sample_starts_the_wait_again() -> None:
    watched = Watched(invalid_for_s=2.0)
    nan = math.nan
    assert watched.each_second(50.0, nan, nan, 50.0, nan, nan, nan) == [(6.0, ERROR)]


def test_invalid_for_s_is_up_by_a_tick_too() -> None:
    watched = Watched(invalid_for_s=2.0)
    assert watched.each_second(math.nan, None, None) == [(2.0, ERROR)]


def test_a_bad_sample_proves_that_the_source_is_alive() -> None:
    watched = Watched(stale_after_s=5.0, invalid_for_s=1000.0, startup_grace_s=0.0)
    for now_s in range(0, 30, 5):
        watched.observe(math.nan, float(now_s))
        watched.tick(now_s + 5.0)
    assert watched.transitions == []


def test_the_status_shows_bad_data_even_while_an_error_bound_is_crossed() -> None:
    watched = Watched(error_below=10.0)
    watched.each_second(5.0, math.nan)
    assert watched.level is ERROR
    assert watched.status().message == "invalid data: nan"
    assert [each.to_level for each in watched.transitions] == [ERROR]


def test_after_bad_data_the_level_is_that_of_the_rules_again() -> None:
    watched = Watched(warn_below=20.0)
    assert watched.each_second(15.0, math.nan, 15.0) == [(0.0, WARN), (1.0, ERROR), (2.0, WARN)]
    assert watched.transitions[-1].text == "battery_level WARN: 15 is below 20 (was ERROR for 1 s)"


@pytest.mark.parametrize("value", [True, 1, 1.0])
def test_whole_numbers_and_flags_are_numbers(value: object) -> None:
    watched = Watched(warn_above=0.5)
    assert watched.each_second(value) == [(0.0, WARN)]


def test_a_status_shows_bad_data_before_it_is_an_error_if_there_was_no_good_sample() -> None:
    watched = Watched(invalid_for_s=10.0)
    watched.observe(None, 0.0)
    assert (watched.level, watched.status().message) == (OK, "no valid sample yet: None")


def test_a_statistic_that_needs_more_samples_says_so() -> None:
    watched = Watched(statistic="rate", warn_below=-4.0, window_min_s=0.0)
    watched.observe(50.0, 0.0)
    assert watched.status().message == "rate is undefined: too few samples"


# --- latch ----------------------------------------------------------------------------------------------------------


def test_a_latched_level_stays_until_reset() -> None:
    watched = Watched(warn_below=20.0, latch=True)
    assert watched.each_second(15.0, 50.0, 50.0) == [(0.0, WARN)]
    assert watched.status().message == "50 is no longer below 20, latched until reset"
    assert watched.status().values["state"] == "latched"

    transition = watched.reset()

    assert transition is not None
    assert (transition.from_level, transition.to_level, transition.now_s) == (WARN, OK, 2.0)
    assert watched.level is OK


def test_the_worst_level_that_fired_is_the_one_that_stays() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, latch=True)
    assert watched.each_second(15.0, 5.0, 15.0, 50.0) == [(0.0, WARN), (1.0, ERROR)]


def test_pending_is_not_fired() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, latch=True, error_for_s=5.0)
    assert watched.each_second(5.0, 50.0) == [(0.0, WARN)]
    watched.reset()
    assert watched.level is OK


def test_reset_while_the_condition_is_true_is_no_transition_and_latches_again() -> None:
    watched = Watched(warn_below=20.0, latch=True)
    watched.observe(15.0, 0.0)
    assert watched.reset() is None
    assert watched.level is WARN
    watched.observe(50.0, 1.0)
    assert watched.level is WARN


def test_reset_falls_back_to_the_rule_that_still_fires() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, latch=True)
    watched.each_second(5.0, 15.0)
    transition = watched.reset()
    assert transition is not None and (transition.from_level, transition.to_level) == (ERROR, WARN)
    assert transition.text == "battery_level WARN: 15 is below 20 (was ERROR for 1 s)"


def test_a_latched_warning_stays_under_staleness_and_comes_back_after_it() -> None:
    watched = Watched(warn_below=20.0, latch=True, stale_after_s=5.0)
    watched.each_second(15.0, 50.0)
    watched.tick(7.0)
    assert watched.level is STALE
    watched.observe(50.0, 8.0)
    assert watched.level is WARN


def test_a_latched_error_is_not_hidden_by_silence_or_bad_data() -> None:
    watched = Watched(error_below=10.0, latch=True)
    watched.each_second(5.0, 50.0)
    watched.tick(100.0)
    assert watched.level is ERROR
    watched.observe(math.nan, 101.0)
    watched.observe(50.0, 102.0)
    assert [each.to_level for each in watched.transitions] == [ERROR]


def test_reset_without_a_latch_does_nothing() -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(15.0, 0.0)
    assert watched.reset() is None
    assert watched.level is WARN


def test_reset_before_the_first_call_does_nothing() -> None:
    assert Watched(warn_below=20.0, latch=True).reset() is None


# --- flapping -------------------------------------------------------------------------------------------------------

FLAPPING = {"warn_below": 20.0, "flap_detection": True, "stale_after_s": 0.0}
LOW, FINE = 15.0, 50.0


def test_flapping_is_announced_once_then_silent_and_the_level_is_brought_up_to_date() -> None:
    watched = Watched(**FLAPPING)
    # A change per sample: after n of them the newest n places weigh sum(1.25 - k * 0.5/19 for k < n) of 20.
    # n = 8 is 46.3 %, n = 9 is 51.5 %: the ninth change reaches 50 %.
    announced = watched.each_second(*[LOW, FINE] * 10)
    assert [now_s for now_s, _ in announced] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]
    percent = 100 * sum(1.25 - k * 0.5 / 19 for k in range(9)) / 20
    assert watched.transitions[-1].to_level is WARN
    assert watched.transitions[-1].text == (
        "battery_level WARN: 15 is below 20 (was OK for 1 s),"
        f" flapping: {percent:.4g} % state change, further changes not announced until below 25 %"
    )
    assert all("flapping" not in each.text for each in watched.transitions[:-1])
    assert watched.status().values["flapping"] == "true"
    assert (watched.level, watched.status().values["state_change_percent"]) == (OK, "100")

    # Quiet now: all 20 places hold changes, and n quiet samples leave the 20 - n oldest weights.
    quiet = watched.each_second(*[FINE] * 20, start_s=20.0)
    left = [100 * sum(0.75 + k * 0.5 / 19 for k in range(20 - n)) / 20 for n in range(21)]
    first_below = next(n for n in range(21) if left[n] < 25.0)
    assert quiet == [(20.0 + first_below - 1, OK)]
    assert watched.transitions[-1].from_level is WARN
    assert watched.status().values["flapping"] == "false"


def test_the_end_of_flapping_is_no_transition_where_the_announced_level_is_the_true_one() -> None:
    watched = Watched(**FLAPPING)
    watched.each_second(*[LOW, FINE] * 10)
    assert watched.each_second(*[LOW] * 20, start_s=20.0) == []
    assert watched.status().values["flapping"] == "false" and watched.level is WARN


def test_after_flapping_changes_are_announced_again() -> None:
    watched = Watched(**FLAPPING)
    watched.each_second(*[LOW, FINE] * 10, *[FINE] * 20)
    assert watched.each_second(LOW, start_s=40.0) == [(40.0, WARN)]


def test_ticks_add_nothing_to_the_flapping_history() -> None:
    watched = Watched(**FLAPPING)
    watched.each_second(LOW, FINE)
    before = watched.status().values["state_change_percent"]
    for now_s in range(2, 40):
        watched.tick(float(now_s))
    assert watched.status().values["state_change_percent"] == before


def test_bad_samples_add_nothing_to_the_flapping_history() -> None:
    watched = Watched(**FLAPPING)
    watched.each_second(*[FINE, math.nan] * 20)
    assert watched.status().values["state_change_percent"] == "0"


def test_flapping_that_no_transition_reached_is_announced_with_the_next_one() -> None:
    """A tick changes the level; the sample after it brings the history to the limit, and announces nothing itself."""
    watched = Watched(**FLAPPING, for_s=1.0, flap_high=6.0, flap_low=5.0)
    watched.observe(LOW, 0.0)
    assert watched.tick(1.0) is not None  # WARN
    assert watched.observe(LOW, 2.0) is None  # one change in the newest place: 6.25 %
    assert watched.status().values["flapping"] == "true"

    announced = watched.observe(FINE, 3.0)

    assert announced is not None and announced.to_level is OK and "flapping" in announced.text
    assert watched.each_second(LOW, LOW, start_s=4.0) == [(5.0, WARN)]  # worse than OK
    assert watched.each_second(FINE, LOW, FINE, start_s=6.0) == []


FLAPS = [LOW, FINE] * 4 + [LOW]  # the ninth change, to WARN, reaches 51.5 %


def test_a_level_worse_than_every_one_announced_since_flapping_began_is_announced_at_once() -> None:
    watched = Watched(**FLAPPING, error_below=10.0)
    watched.each_second(*FLAPS)
    assert watched.each_second(FINE, LOW, FINE, start_s=9.0) == []
    assert watched.each_second(5.0, FINE, 5.0, start_s=12.0) == [(12.0, ERROR)]
    assert "flapping" in watched.transitions[-1].text


def test_flapping_that_begins_with_a_change_to_ok_still_announces_the_next_warning() -> None:
    watched = Watched(**{**FLAPPING, "flap_high": 47.0})
    # Nine changes are 51.5 %, eight 46.3 %; a quiet sample first makes the ninth change one to OK.
    announced = watched.each_second(LOW, FINE, LOW, FINE, LOW, FINE, LOW, FINE, LOW)
    assert announced[-1] == (8.0, WARN)
    watched = Watched(**{**FLAPPING, "flap_high": 46.0})
    announced = watched.each_second(LOW, FINE, LOW, FINE, LOW, FINE, LOW, FINE)
    assert announced[-1] == (7.0, OK) and "flapping" in watched.transitions[-1].text
    assert watched.each_second(LOW, FINE, LOW, start_s=8.0) == [(8.0, WARN)]


def test_a_flapping_signal_that_dies_is_announced_at_once() -> None:
    watched = Watched(**{**FLAPPING, "stale_after_s": 5.0})
    watched.each_second(*FLAPS)
    watched.tick(8.0 + 5.5)
    assert (watched.transitions[-1].to_level, watched.transitions[-1].now_s) == (STALE, 13.5)
    assert watched.each_second(FINE, LOW, start_s=14.0) == []  # flapping, and announced was worse
    assert (watched.level, watched.status().values["flapping"]) == (WARN, "true")


def test_a_flapping_signal_that_becomes_invalid_is_announced_at_once() -> None:
    watched = Watched(**FLAPPING)
    watched.each_second(*FLAPS)
    assert watched.each_second(math.nan, math.nan, start_s=9.0) == [(9.0, ERROR)]
    assert watched.transitions[-1].status.message == "invalid data: nan"
    quiet = watched.each_second(*[FINE] * 20, start_s=11.0)
    assert [level for _, level in quiet] == [OK]  # one transition, when flapping has ended


def test_flap_limits_are_off_by_default() -> None:
    watched = Watched(warn_below=20.0)
    assert len(watched.each_second(*[LOW, FINE] * 20)) == 40


# --- staleness ------------------------------------------------------------------------------------------------------


def test_stale_is_strictly_after_stale_after_s() -> None:
    watched = Watched(stale_after_s=5.0)
    watched.observe(50.0, 0.0)
    assert watched.tick(5.0) is None
    transition = watched.tick(5.5)
    assert transition is not None
    assert transition.text == "battery_level STALE: no sample for 5.5 s (limit 5 s) (was OK for 5.5 s)"
    assert (transition.value, transition.bound) == (50.0, None)


def test_the_first_sample_ends_staleness() -> None:
    watched = Watched(stale_after_s=5.0)
    watched.observe(50.0, 0.0)
    watched.tick(6.0)
    transition = watched.observe(55.0, 7.0)
    assert transition is not None
    assert transition.text == "battery_level OK: 55 (was STALE for 1 s)"


def test_a_signal_that_was_never_known_says_so() -> None:
    watched = Watched(warn_below=20.0)
    watched.tick(0.0)
    watched.observe(15.0, 4.0)
    (low,) = watched.transitions
    assert low.text == "battery_level WARN: 15 is below 20 (was unknown for 4 s)"
    assert (low.from_level, low.since_s) == (OK, 4.0)


def test_time_before_the_first_sample_does_not_count_as_ok() -> None:
    watched = Watched(warn_below=20.0)
    watched.tick(0.0)
    watched.observe(50.0, 4.0)
    watched.observe(15.0, 10.0)
    (low,) = watched.transitions
    assert low.text == "battery_level WARN: 15 is below 20 (was OK for 6 s)"
    assert (low.from_level, low.since_s) == (OK, 4.0)


def test_the_line_that_ends_a_staleness_before_the_statistic_is_defined_says_samples_again() -> None:
    watched = Watched(statistic="frequency_hz", warn_below=5.0, window_s=4.0, window_min_s=2.0, stale_after_s=3.0)
    for now_s in range(20):
        if now_s not in range(6, 12):
            watched.observe(1.0, now_s + 0.0)
            watched.observe(1.0, now_s + 0.1)
        watched.tick(now_s + 0.5)
    assert [each.text for each in watched.transitions if STALE in (each.from_level, each.to_level)] == [
        "battery_level STALE: no sample for 3.4 s (limit 3 s) (was WARN for 6.5 s)",
        "battery_level WARN: samples again (was STALE for 3.5 s)",
    ]


def test_a_bad_sample_after_a_staleness_does_not_bring_the_old_statistic_back() -> None:
    watched = Watched(statistic="mean", warn_below=20.0, window_s=10.0, window_min_s=2.0, invalid_for_s=60.0)
    for now_s in range(4):
        watched.observe(50.0, float(now_s))
    watched.tick(9.0)
    watched.observe(math.nan, 10.0)
    assert watched.transitions[-1].text == "battery_level OK: samples again (was STALE for 1 s)"
    assert watched.monitor.judgements(0.0)["battery_level"].judged is None


def test_before_the_first_sample_only_startup_grace_counts() -> None:
    watched = Watched(stale_after_s=2.0, startup_grace_s=10.0)
    watched.tick(100.0)
    assert watched.tick(110.0) is None
    transition = watched.tick(110.5)
    assert transition is not None
    said = "no sample since the start 10.5 s ago (limit 10 s)"
    assert transition.text == f"battery_level STALE: {said} (was unknown for 10.5 s)"
    assert transition.value is None


def test_after_the_first_sample_startup_grace_counts_no_more() -> None:
    watched = Watched(stale_after_s=2.0, startup_grace_s=10.0)
    watched.observe(50.0, 0.0)
    watched.tick(3.0)
    assert watched.level is STALE


def test_stale_after_s_of_0_never_is_stale() -> None:
    watched = Watched(stale_after_s=0.0, startup_grace_s=0.0)
    assert watched.each_second(*[None] * 100) == []


def test_a_stale_signals_pending_rule_stands_still() -> None:
    watched = Watched(warn_below=20.0, for_s=8.0, stale_after_s=5.0)
    watched.observe(15.0, 0.0)
    for now_s in range(1, 100):
        watched.tick(float(now_s))
    assert watched.level is STALE
    watched.observe(15.0, 100.0)  # 5 s of the wait had passed
    assert watched.level is OK
    watched.observe(15.0, 102.0)
    assert watched.level is OK
    watched.observe(15.0, 103.0)
    assert watched.level is WARN


def test_a_stale_signals_firing_rule_does_not_clear() -> None:
    watched = Watched(warn_below=20.0, keep_firing_for_s=8.0, stale_after_s=5.0)
    watched.each_second(15.0, 50.0)  # keeps firing from 1 on
    for now_s in range(2, 100):
        watched.tick(float(now_s))
    watched.observe(50.0, 100.0)  # 5 s of it had passed
    assert watched.level is WARN
    watched.observe(50.0, 103.0)
    assert watched.level is OK


def test_an_error_that_was_firing_stays_an_error_when_the_signal_falls_silent() -> None:
    watched = Watched(error_below=10.0, stale_after_s=5.0, unit="%")
    watched.observe(5.0, 0.0)
    assert watched.tick(60.0) is None
    assert watched.level is ERROR
    assert watched.status(60.0).message == "5 % is below 10 %, no sample for 60 s"
    assert watched.status(60.0).values["state"] == "stale"


def test_a_warning_becomes_stale_and_then_a_warning_again() -> None:
    watched = Watched(warn_below=20.0, stale_after_s=5.0)
    watched.observe(15.0, 0.0)
    watched.tick(6.0)
    watched.observe(15.0, 7.0)
    assert [each.to_level for each in watched.transitions] == [WARN, STALE, WARN]


def test_a_warning_that_came_due_before_the_silence_was_too_long_fired() -> None:
    watched = Watched(warn_below=20.0, for_s=3.0, stale_after_s=5.0, latch=True)
    watched.observe(15.0, 0.0)
    watched.tick(60.0)  # the first look since; the rule was due at 3, the silence at 5
    assert watched.level is STALE
    watched.observe(50.0, 61.0)
    assert watched.level is WARN


def test_silence_that_no_tick_noticed_freezes_durations_all_the_same() -> None:
    watched = Watched(warn_below=20.0, for_s=8.0, stale_after_s=5.0)
    watched.observe(15.0, 0.0)
    assert watched.each_second(15.0, 15.0, 15.0, start_s=100.0) == []  # 5 s of 8 had passed
    assert watched.each_second(15.0, start_s=103.0) == [(103.0, WARN)]


# --- unknown is never OK --------------------------------------------------------------------------------------------


def test_a_signal_waits_until_its_first_sample_and_that_is_no_transition() -> None:
    watched = Watched(warn_below=20.0)
    assert watched.tick(0.0) is None
    assert watched.tick(9.0) is None
    assert (watched.level, watched.status().values["state"]) == (STALE, "waiting")
    assert watched.monitor.report(9.0).overall is STALE
    assert watched.observe(50.0, 9.5) is None
    assert (watched.level, watched.monitor.report(9.5).overall) == (OK, OK)


def test_a_signal_whose_robot_cannot_be_reached_is_unknown_and_that_is_no_transition() -> None:
    monitor = fleet()
    monitor.observe(Sample("battery_level", 15.0, 0.0))
    monitor.observe(Sample("link", 0.0, 2.0))
    report = monitor.report(12.0)
    status = report.statuses["battery_level"]
    assert (status.level, status.values["state"]) == (STALE, "unreachable")
    assert status.message == "link down, last value 15 12 s ago"
    assert (status.values["value"], status.values["age_s"]) == ("15", "12")
    assert report.statuses["temperature"].message == "link down, no sample yet"
    assert report.overall is ERROR  # of the link
    assert monitor.observe(Sample("link", 1.0, 13.0)) == []
    assert monitor.report(13.0).statuses["battery_level"].level is WARN  # as announced before


def test_a_latch_that_is_reset_while_the_link_is_down_is_announced_when_it_is_up() -> None:
    monitor = fleet(latch=True)
    monitor.observe(Sample("battery_level", 15.0, 0.0))
    monitor.observe(Sample("battery_level", 50.0, 1.0))
    monitor.observe(Sample("link", 0.0, 2.0))
    assert monitor.reset() == []
    (cleared,) = monitor.observe(Sample("link", 1.0, 3.0))
    assert (cleared.signal, cleared.from_level, cleared.to_level) == ("battery_level", WARN, OK)


# --- the link -------------------------------------------------------------------------------------------------------


def fleet(**settings: Any) -> Monitor:
    signals = {"battery_level": {"warn_below": 20.0, **settings}, "temperature": {"warn_above": 80.0}}
    return Monitor(load_config({"signals": signals}), "atlas")


def test_a_link_that_is_down_is_one_alert_and_not_one_per_signal() -> None:
    monitor = fleet()
    monitor.observe(Sample("battery_level", 50.0, 0.0))
    monitor.observe(Sample("temperature", 50.0, 0.0))
    announced = monitor.observe(Sample("link", 0.0, 1.0))
    for now_s in range(2, 100):
        announced += monitor.tick(float(now_s))

    assert [each.text for each in announced] == ["link ERROR: down (was never up)"]
    assert monitor.report(100.0).overall is ERROR

    announced = monitor.observe(Sample("link", 1.0, 100.0))
    announced += monitor.tick(109.9)  # the startup grace of 10 s counts again
    assert announced == []
    assert [each.text for each in monitor.tick(110.5)] == [
        "battery_level STALE: no sample for 110 s, 99 s of them without link (limit 10 s) (was OK for 11.5 s)",
        "temperature STALE: no sample for 110 s, 99 s of them without link (limit 10 s) (was OK for 11.5 s)",
        "link OK: up (was ERROR for 110 s)",
    ]


def test_rules_stand_still_while_the_link_is_down() -> None:
    monitor = fleet(for_s=5.0)
    monitor.observe(Sample("battery_level", 15.0, 0.0))
    monitor.observe(Sample("link", 0, 2.0))
    monitor.tick(50.0)
    monitor.observe(Sample("link", 1, 100.0))
    assert monitor.tick(102.0) == []
    assert [(each.signal, each.to_level) for each in monitor.tick(103.0)] == [("battery_level", WARN)]


def test_a_sample_that_was_still_on_its_way_does_not_wake_its_signal_up() -> None:
    monitor = fleet(for_s=5.0)
    monitor.observe(Sample("battery_level", 50.0, 0.0))
    monitor.observe(Sample("link", 0.0, 1.0))
    monitor.observe(Sample("battery_level", 15.0, 1.5))
    monitor.tick(50.0)
    monitor.observe(Sample("link", 1.0, 100.0))
    assert monitor.tick(104.0) == []
    assert [(each.signal, each.to_level) for each in monitor.tick(105.0)] == [("battery_level", WARN)]


def test_a_signal_that_was_stale_before_the_link_broke_stays_stale() -> None:
    monitor = fleet()
    monitor.observe(Sample("battery_level", 50.0, 0.0))
    monitor.tick(6.0)
    monitor.observe(Sample("link", 0.0, 7.0))
    monitor.observe(Sample("link", 1.0, 8.0))
    monitor.tick(9.0)
    assert monitor.report(9.0).statuses["battery_level"].level is STALE


@pytest.mark.parametrize("value", [math.nan, None, "down", 0.5, [1.0, 2.0]])
def test_a_link_that_does_not_say_that_it_is_up_is_down(value: object) -> None:
    monitor = fleet()
    monitor.tick(0.0)
    announced = monitor.observe(Sample("link", value, 1.0)) + monitor.tick(100.0)
    assert [(each.signal, each.to_level) for each in announced] == [("link", ERROR)]


def test_a_signal_configured_while_the_link_is_down_waits_for_it_too() -> None:
    monitor = fleet()
    monitor.observe(Sample("link", 0.0, 0.0))
    monitor.configure(load_config({"signals": {"battery_level": {}, "voltage": {"startup_grace_s": 5.0}}}))
    monitor.observe(Sample("link", 1.0, 100.0))
    assert monitor.tick(104.0) == []
    assert [each.signal for each in monitor.tick(106.0)] == ["voltage"]


def test_time_that_goes_back_while_the_link_is_down_wakes_nothing_up() -> None:
    monitor = fleet()
    monitor.observe(Sample("battery_level", 50.0, 1000.0))
    monitor.tick(1006.0)  # stale
    monitor.observe(Sample("link", 0.0, 1007.0))
    monitor.tick(0.0)
    monitor.observe(Sample("link", 1.0, 100.0))
    status = monitor.report(101.0).statuses["battery_level"]
    assert (status.level, status.values["state"]) == (STALE, "waiting")


def test_a_link_that_drops_for_a_moment_again_and_again_does_not_hide_a_dead_sensor() -> None:
    monitor = fleet()
    monitor.observe(Sample("battery_level", 50.0, 0.0))
    stale = []
    for round_s in range(0, 40, 4):
        stale += monitor.observe(Sample("link", 1.0, float(round_s)))
        for second in range(1, 4):
            stale += monitor.tick(float(round_s + second))
        stale += monitor.observe(Sample("link", 0.0, round_s + 3.8))
    found = [each for each in stale if each.signal == "battery_level"]
    # 3.8 s of silence until the first drop, 1.2 s more from 4.0 on: the tick at 6.0 is the first after 5.2.
    assert [(each.to_level, each.now_s) for each in found] == [(STALE, 6.0)]


def test_durations_continue_after_each_drop_of_the_link() -> None:
    monitor = fleet(for_s=5.0, stale_after_s=60.0)
    monitor.observe(Sample("battery_level", 15.0, 0.0))
    monitor.observe(Sample("link", 0.0, 2.0))
    monitor.observe(Sample("link", 1.0, 10.0))
    monitor.observe(Sample("link", 0.0, 12.0))
    monitor.observe(Sample("link", 1.0, 20.0))
    assert [each for each in monitor.tick(20.9) if each.signal == "battery_level"] == []
    assert [each.to_level for each in monitor.tick(21.0) if each.signal == "battery_level"] == [WARN]


def test_a_server_that_accepts_and_closes_again_and_again_is_one_alert() -> None:
    monitor = fleet()
    announced = []
    for step in range(200):
        announced += monitor.observe(Sample("link", float(step % 2), step * 0.1))
        announced += monitor.tick(step * 0.1)
    assert [each.to_level for each in announced] == [ERROR]


def test_what_came_while_the_link_was_down_is_judged_when_it_is_up() -> None:
    monitor = fleet()
    monitor.observe(Sample("battery_level", 50.0, 0.0))
    monitor.observe(Sample("link", 0.0, 1.0))
    assert monitor.observe(Sample("battery_level", 15.0, 1.1)) == []
    assert [each.text for each in monitor.observe(Sample("link", 1.0, 5.0))] == [
        "battery_level WARN: 15 is below 20 (was OK for 1 s)"
    ]


def test_a_mean_is_not_judged_on_its_first_sample_after_a_long_downtime_of_the_link() -> None:
    monitor = fleet(statistic="mean", window_s=10.0, stale_after_s=60.0)
    for now_s in range(6):
        monitor.observe(Sample("battery_level", 50.0, float(now_s)))
    monitor.observe(Sample("link", 0.0, 6.0))
    monitor.observe(Sample("link", 1.0, 100.0))
    assert monitor.observe(Sample("battery_level", 15.0, 101.0)) == []
    assert [each.to_level for each in monitor.observe(Sample("battery_level", 15.0, 106.0))][-1:] == [WARN]


def test_a_downtime_as_long_as_the_window_leaves_its_last_sample_and_is_not_waited_for_again() -> None:
    """A sample exactly `window_s` old stays in the window."""
    config = load_config({"signals": {"load": {"statistic": "mean", "window_s": 60.0, "warn_above": 80.0}}})
    for downtime_s, announced in ((60.0, [WARN]), (61.0, [])):
        monitor = Monitor(config)
        monitor.set_link(True, "", 0.0)
        for second in range(31):
            monitor.observe(Sample("load", 50.0, float(second)))
        monitor.set_link(False, "no route", 30.0)
        monitor.set_link(True, "", 30.0 + downtime_s)
        changes = monitor.observe(Sample("load", 200.0, 30.0 + downtime_s))
        assert [each.to_level for each in changes] == announced


def test_a_link_that_is_down_says_why() -> None:
    monitor = fleet()
    (down,) = monitor.set_link(False, "connection refused", 4.0)
    assert down.text == "link ERROR: down: connection refused (was never up)"
    assert down.status.message == "down: connection refused"
    assert monitor.set_link(False, "wrong\x1b[2J token", 5.0) == []
    assert monitor.report(5.0).statuses["link"].message == "down: wrong?[2J token"
    monitor.set_link(True, "", 6.0)
    monitor.tick(16.0)
    assert monitor.report(16.0).statuses["link"].message == "up"


def test_a_link_that_breaks_again_within_10_s_is_one_alert() -> None:
    monitor = Monitor(load_config({"signals": {"battery_level": {"stale_after_s": 0.0, "startup_grace_s": 1000.0}}}))
    announced = monitor.set_link(True, "", 0.0) + monitor.set_link(False, "refused", 20.0)
    for now_s in range(21, 100):  # up for 9 s, down for 1 s
        announced += monitor.set_link(now_s % 10 != 0, "refused", float(now_s)) + monitor.tick(float(now_s))
    assert [each.text for each in announced] == ["link ERROR: down: refused (was OK for 20 s)"]
    announced = monitor.tick(100.9) + monitor.tick(101.0)
    assert [each.text for each in announced] == ["link OK: up (was ERROR for 81 s)"]


def test_a_link_needs_no_configuration_and_never_is_stale() -> None:
    monitor = fleet()
    monitor.observe(Sample("link", 1.0, 0.0))
    assert "link" in monitor.report(0.0).statuses
    assert "link" not in {each.signal for each in monitor.tick(1e6)}


# --- time that goes back --------------------------------------------------------------------------------------------


def test_time_that_goes_back_is_one_notice_that_says_by_how_much() -> None:
    monitor = Watched(warn_below=20.0).monitor
    notices = [
        monitor.observe(Sample("battery_level", 50.0, 100.0)).notices,
        monitor.observe(Sample("battery_level", 50.0, 97.5)).notices,
        monitor.tick(98.0).notices,
        monitor.tick(90.0).notices,
    ]
    assert notices == [
        (),
        ("time went back by 2.500 s: windows, pending timers and staleness restart",),
        (),
        ("time went back by 8.000 s: windows, pending timers and staleness restart",),
    ]


def test_windows_start_again_when_time_goes_back() -> None:
    watched = Watched(window_min_s=0.0)
    watched.each_second(10.0, 20.0, start_s=100.0)
    watched.observe(40.0, 0.0)
    values = watched.status(0.0).values
    assert (values["window_samples"], values["mean"]) == ("1", "40")


def test_pending_timers_start_again_when_time_goes_back() -> None:
    watched = Watched(warn_below=20.0, for_s=5.0)
    watched.each_second(15.0, 15.0, 15.0, 15.0, start_s=100.0)
    assert watched.each_second(15.0, 15.0, 15.0, 15.0, 15.0) == []
    assert watched.each_second(15.0, start_s=5.0) == [(5.0, WARN)]


def test_staleness_starts_again_when_time_goes_back() -> None:
    watched = Watched(stale_after_s=5.0)
    watched.observe(50.0, 100.0)
    watched.tick(106.0)
    assert watched.level is STALE
    assert watched.tick(0.0) is None
    # Nothing is known of the new time, and unknown is never OK. The level announced last stays.
    assert (watched.level, watched.status().values["state"]) == (STALE, "waiting")
    watched.tick(5.0)
    assert watched.status().values["state"] == "waiting"
    assert watched.tick(5.5) is None
    assert (watched.level, watched.status().values["state"]) == (STALE, "stale")
    assert watched.each_second(50.0, start_s=6.0) == [(6.0, OK)]


def test_a_fresh_signal_gets_its_whole_stale_after_s_again_when_time_goes_back() -> None:
    watched = Watched(stale_after_s=5.0)
    watched.observe(50.0, 100.0)
    watched.tick(104.0)
    assert watched.tick(0.0) is watched.tick(5.0) is None
    assert watched.level is OK
    watched.tick(5.5)
    assert watched.level is STALE


def test_latched_alerts_stay_when_time_goes_back() -> None:
    watched = Watched(warn_below=20.0, latch=True)
    watched.each_second(15.0, 50.0, start_s=100.0)
    watched.observe(50.0, 0.0)
    assert watched.level is WARN


def test_a_firing_rule_keeps_firing_when_time_goes_back() -> None:
    watched = Watched(warn_below=20.0, for_s=5.0)
    watched.each_second(*[15.0] * 7, start_s=100.0)
    assert watched.each_second(15.0, 15.0) == []
    assert watched.level is WARN


def test_durations_in_texts_are_never_negative() -> None:
    watched = Watched(warn_below=20.0)
    watched.each_second(50.0, 15.0, start_s=1000.0)
    transition = watched.observe(50.0, 3.0)
    assert transition is not None
    assert transition.text == "battery_level OK: 50 is no longer below 20 (was WARN for 0 s)"


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf])
def test_a_time_that_is_none_counts_as_the_time_of_the_last_call(odd: float) -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(50.0, 10.0)
    transition = watched.observe(15.0, odd)
    assert transition is not None and transition.now_s == 10.0
    assert watched.monitor.tick(odd).notices == ()


# --- repeating ------------------------------------------------------------------------------------------------------


def test_repeat_s_announces_a_lasting_level_again() -> None:
    watched = Watched(warn_below=20.0, unit="%", repeat_s=10.0, stale_after_s=0.0)
    watched.observe(15.0, 0.0)
    for now_s in range(1, 25):
        watched.tick(float(now_s))

    assert [(each.now_s, each.from_level, each.to_level, each.repeat) for each in watched.transitions] == [
        (0.0, OK, WARN, False),
        (10.0, WARN, WARN, True),
        (20.0, WARN, WARN, True),
    ]
    assert watched.transitions[1].text == "battery_level WARN: 15 % is below 20 % (for 10 s)"
    assert watched.transitions[2].text == "battery_level WARN: 15 % is below 20 % (for 20 s)"
    assert watched.observe(50.0, 25.0).since_s == 0.0  # type: ignore[union-attr]


def test_ok_is_not_repeated() -> None:
    watched = Watched(repeat_s=1.0, stale_after_s=0.0)
    assert watched.each_second(50.0, *[None] * 10) == []


def test_a_change_starts_the_time_to_the_next_repetition() -> None:
    watched = Watched(warn_below=20.0, error_below=10.0, repeat_s=10.0, stale_after_s=0.0)
    watched.observe(15.0, 0.0)
    watched.observe(5.0, 7.0)
    assert watched.tick(16.0) is None
    assert watched.tick(17.0) is not None


def test_a_flapping_signal_is_not_repeated() -> None:
    watched = Watched(**FLAPPING, repeat_s=1.0)
    watched.each_second(*[LOW, FINE] * 10, LOW)
    assert (watched.level, watched.status().values["flapping"]) == (WARN, "true")
    assert watched.tick(100.0) is None


# --- what comes out -------------------------------------------------------------------------------------------------


def test_the_line_reads_as_the_document_has_it() -> None:
    watched = Watched(warn_below=20.0, unit="%", stale_after_s=0.0)
    watched.observe(50.0, 0.0)
    watched.observe(19.5, 312.0)
    assert watched.transitions[0].text == "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)"


def test_a_transition_carries_everything() -> None:
    watched = Watched(warn_below=20.0, unit="%", stale_after_s=0.0, window_min_s=0.0)
    watched.observe(50.0, 100.0)
    watched.observe(19.5, 110.0)
    (transition,) = watched.transitions

    assert transition == Transition(
        signal="battery_level",
        from_level=OK,
        to_level=WARN,
        value=19.5,
        statistic="last",
        bound=20.0,
        now_s=110.0,
        since_s=100.0,
        robot="atlas",
        # printf 'atlas\0battery_level' | sha256sum
        fingerprint="bedd9ef1decf2f49",
        text="battery_level WARN: 19.5 % is below 20 % (was OK for 10 s)",
        status=watched.status(110.0),
        statistics={
            "last": 19.5,
            "mean": 34.75,
            "min": 19.5,
            "max": 50.0,
            "stddev": 15.25,
            "frequency_hz": 0.1,
        },
        repeat=False,
    )


def test_fingerprints_differ_by_robot_and_by_signal_and_by_nothing_else() -> None:
    def fingerprint(robot: str, signal: str, **settings: Any) -> str:
        monitor = Monitor(load_config({"signals": {signal: settings}}), robot)
        return monitor.report(0.0).statuses[signal].values["fingerprint"]

    assert fingerprint("atlas", "a") == fingerprint("atlas", "a", warn_below=3.0) == sixteen_digits(b"atlas\0a")
    assert len({fingerprint("atlas", "a"), fingerprint("atlas", "b"), fingerprint("talos", "a")}) == 3


def sixteen_digits(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def test_the_robots_name_comes_from_the_configuration_where_none_is_given() -> None:
    config = load_config({"signals": {"a": {}}, "robot_name": "talos"})
    assert Monitor(config).report(0.0).robot == "talos"
    assert Monitor(config, "atlas").report(0.0).statuses["a"].hardware_id == "atlas"


def test_a_report_is_the_whole_state() -> None:
    monitor = Monitor(
        load_config({"signals": {"a": {"warn_below": 20.0}, "b": {}, "c": {"error_above": 1.0}}}), "atlas"
    )
    monitor.observe(Sample("a", 15.0, 5.0))
    monitor.observe(Sample("c", 2.0, 5.0))
    report = monitor.report(7.0)

    assert isinstance(report, Report)
    assert (report.overall, report.now_s, report.robot) == (ERROR, 7.0, "atlas")
    assert list(report.statuses) == ["a", "b", "c"]
    assert [status.level for status in report.statuses.values()] == [WARN, STALE, ERROR]
    assert report.statuses["b"].message == "waiting for the first sample"


def test_overall_goes_by_severity_stale_above_warn_and_below_error() -> None:
    monitor = Monitor(load_config({"signals": {"a": {"warn_below": 20.0, "stale_after_s": 0.0}, "b": {}}}))
    monitor.observe(Sample("a", 15.0, 0.0))
    monitor.observe(Sample("b", 1.0, 0.0))
    monitor.tick(6.0)
    assert monitor.report(6.0).overall is STALE
    monitor.observe(Sample("a", math.nan, 6.0))
    assert monitor.report(6.0).overall is ERROR


def test_a_report_before_the_first_call_says_that_nothing_has_come() -> None:
    report = Watched(warn_below=20.0).monitor.report(1234.5)
    assert report.now_s == 1234.5
    assert (report.overall, report.statuses["battery_level"].level) == (STALE, STALE)
    assert report.statuses["battery_level"].values["state"] == "waiting"
    assert report.statuses["battery_level"].message == "waiting for the first sample"


def test_a_report_changes_nothing() -> None:
    watched = Watched(stale_after_s=5.0)
    watched.observe(50.0, 0.0)
    assert watched.status(100.0).level is OK
    assert watched.status(100.0).values["age_s"] == "100"
    assert watched.tick(3.0) is None


@pytest.mark.newest_python
@pytest.mark.parametrize("statistic", ["last", "mean", "stddev", "min", "rate"])
def test_reports_between_the_calls_change_nothing_to_the_last_bit(statistic: str) -> None:
    chance = random.Random(1)
    settings = {"statistic": statistic, "window_s": 5.0, "window_min_s": 0.0, "warn_above": 1e9, "flap_detection": True}
    read, unread = Watched(**settings), Watched(**settings)
    for step in range(3000):
        value = 1e9 + chance.gauss(0.0, 1.0) if step % 500 else 1e140
        for watched in (read, unread):
            watched.observe(value, step * 0.1)
        read.monitor.report(step * 0.1)
        read.monitor.status("battery_level", step * 0.1 + 3.0)
    assert read.transitions == unread.transitions and len(read.transitions) > 1
    assert read.status() == unread.status()


def test_samples_of_a_signal_that_is_not_configured_are_ignored() -> None:
    watched = Watched(warn_below=20.0)
    assert watched.monitor.observe(Sample("voltage", 1.0, 0.0)) == []
    assert list(watched.monitor.report(0.0).statuses) == ["battery_level"]


# --- live change ----------------------------------------------------------------------------------------------------


def test_a_new_bound_is_judged_at_once() -> None:
    watched = Watched(warn_below=20.0, unit="%")
    watched.observe(25.0, 1.0)
    transition = watched.configure(warn_below=30.0, unit="%")
    assert transition is not None
    assert transition.text == "battery_level WARN: 25 % is below 30 % (was OK for 0 s)"


def test_a_lowered_bound_clears_without_naming_the_old_one_as_crossed() -> None:
    watched = Watched(warn_below=20.0, unit="%")
    watched.observe(15.0, 1.0)
    transition = watched.configure(warn_below=10.0, unit="%")
    assert transition is not None
    assert (transition.text, transition.bound) == ("battery_level OK: 15 % (was WARN for 0 s)", None)


def test_a_rule_whose_bound_is_taken_away_ends_at_once() -> None:
    watched = Watched(warn_below=20.0, keep_firing_for_s=60.0)
    watched.observe(15.0, 1.0)
    transition = watched.configure(keep_firing_for_s=60.0)
    assert transition is not None and transition.to_level is OK


def test_a_rule_whose_bound_is_taken_away_while_stale_does_not_come_back() -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(15.0, 1.0)
    watched.tick(10.0)
    watched.configure()
    transition = watched.observe(15.0, 11.0)
    assert transition is not None and (transition.from_level, transition.to_level) == (STALE, OK)


def test_a_longer_stale_after_s_ends_staleness_at_once() -> None:
    watched = Watched(stale_after_s=5.0)
    watched.observe(50.0, 0.0)
    watched.tick(10.0)
    transition = watched.configure(stale_after_s=60.0)
    assert transition is not None and (transition.from_level, transition.to_level) == (STALE, OK)
    assert watched.tick(60.0) is None
    assert watched.tick(61.0) is not None


def test_a_changed_signal_keeps_its_window_counts_and_pending_time() -> None:
    watched = Watched(warn_below=20.0, for_s=5.0)
    watched.each_second(15.0, 15.0, 15.0)
    watched.configure(warn_below=25.0, for_s=5.0)
    assert watched.status(2.0).values["window_samples"] == "3"
    assert watched.each_second(15.0, 15.0, 15.0, start_s=3.0) == [(5.0, WARN)]


def test_untouched_signals_are_not_disturbed() -> None:
    both = {"a": {"warn_below": 20.0, "for_s": 5.0}, "b": {"warn_above": 1.0}}
    monitor = Monitor(load_config({"signals": both}))
    for now_s in range(4):
        monitor.observe(Sample("a", 15.0, float(now_s)))
    before = monitor.report(3.0).statuses["a"]
    monitor.configure(load_config({"signals": {**both, "b": {"warn_above": 2.0}}}))
    assert monitor.report(3.0).statuses["a"] == before
    assert [each.now_s for each in monitor.observe(Sample("a", 15.0, 5.0))] == [5.0]


def test_turning_latch_off_releases_it() -> None:
    watched = Watched(warn_below=20.0, latch=True)
    watched.each_second(15.0, 50.0)
    transition = watched.configure(warn_below=20.0)
    assert transition is not None and (transition.from_level, transition.to_level) == (WARN, OK)


def test_turning_flap_detection_off_brings_the_announced_level_up_to_date() -> None:
    watched = Watched(**FLAPPING)
    watched.each_second(*[LOW, FINE] * 10)
    transition = watched.configure(**{**FLAPPING, "flap_detection": False})
    assert transition is not None and (transition.from_level, transition.to_level) == (WARN, OK)


def test_a_new_statistic_is_judged_on_the_window_that_is_there() -> None:
    watched = Watched(warn_below=20.0)
    watched.each_second(10.0, 50.0)
    watched.configure(statistic="min", warn_below=20.0, window_min_s=0.0)
    assert watched.level is WARN


def test_signals_come_and_go() -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(15.0, 0.0)
    watched.monitor.configure(load_config({"signals": {"voltage": {"warn_below": 24.0}}}))
    assert list(watched.monitor.report(0.0).statuses) == ["voltage"]
    assert [each.text for each in watched.monitor.observe(Sample("voltage", 23.0, 1.0))] == [
        "voltage WARN: 23 is below 24 (was unknown for 1 s)"
    ]


def test_a_signal_that_is_removed_while_it_is_not_ok_ends() -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(15.0, 0.0)
    watched.tick(5.0)
    (ended,) = watched.monitor.configure(load_config({"signals": {"voltage": {}}}))
    assert (ended.signal, ended.from_level, ended.to_level) == ("battery_level", WARN, OK)
    assert ended.text == "battery_level OK: no longer watched (was WARN for 5 s)"
    assert (ended.status.level, ended.status.message) == (OK, "no longer watched")


def test_a_signal_that_is_removed_while_it_is_ok_or_waiting_just_goes() -> None:
    watched = Watched(warn_below=20.0)
    watched.tick(5.0)
    assert watched.monitor.configure(load_config({"signals": {"voltage": {}}})) == []


def test_the_name_link_is_reserved() -> None:
    with pytest.raises(ConfigError, match=r"^signals\.link: .*reserved for the link to the robot"):
        load_config({"signals": {"link": {"warn_below": 1.0}}})


def test_a_configuration_before_the_first_call_is_simply_the_configuration() -> None:
    watched = Watched(warn_below=20.0)
    assert watched.configure(warn_below=30.0) is None
    assert watched.each_second(25.0) == [(0.0, WARN)]


def test_a_monitor_without_signals_can_be_given_some_later() -> None:
    monitor = Monitor(load_config({"signals": {"wheel": {"warn_above": 1.0}}}))
    full, empty = monitor.config, MonitorConfig({})
    monitor.tick(1.0)
    monitor.configure(empty)
    monitor.tick(2.0)
    monitor.configure(full)
    assert [change.to_level for change in monitor.observe(Sample("wheel", 2.0, 3.0))] == [Level.WARN]


def test_the_judged_value_is_that_of_the_statistic() -> None:
    monitor = Monitor(load_config({"signals": {"battery": {"statistic": "mean", "window_s": 2.0}}}))
    assert monitor.judgements(0.0)["battery"].judged is None
    monitor.observe(Sample("battery", 2.0, 0.0))
    assert monitor.judgements(0.0)["battery"].judged is None  # undefined for window_s / 2
    monitor.observe(Sample("battery", 4.0, 1.0))
    assert monitor.judgements(0.0)["battery"].judged == 3.0


def test_skipped_time_counts_neither_as_silence_nor_towards_durations() -> None:
    settings = {"warn_below": 20.0, "for_s": 10.0, "stale_after_s": 5.0}
    monitor = Monitor(load_config({"signals": {"battery_level": settings}}))
    assert monitor.observe(Sample("battery_level", 10.0, 0.0)) == []  # pending since 0
    assert monitor.tick(4.0) == []
    assert monitor.skip(4.0, 1000.0) == []
    assert monitor.tick(1000.5) == []  # silent for 4.5 s
    assert monitor.observe(Sample("battery_level", 10.0, 1001.0)) == []
    assert monitor.tick(1005.5) == []  # pending for 9.5 s
    (fired,) = monitor.tick(1006.0)
    assert (fired.signal, fired.to_level) == ("battery_level", Level.WARN)


def test_skipping_before_the_first_call_or_backwards_does_nothing() -> None:
    monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0}}}))
    assert monitor.skip(0.0, 100.0) == []
    monitor.observe(Sample("battery_level", 50.0, 10.0))
    assert monitor.skip(0.0, 5.0) == []
    assert monitor.skip(math.nan, math.nan) == []
    assert monitor.skip(30.0, 20.0) == []
    assert monitor.tick(10.0) == []


def test_judgements_are_those_of_the_report() -> None:
    monitor = Monitor(load_config({"signals": {"battery_level": {"unit": "%", "warn_below": 20.0}}}))
    assert monitor.judgements(0.0)["battery_level"].state == "waiting"
    monitor.observe(Sample("battery_level", 10.0, 1.0))
    monitor.observe(Sample("link", 1.0, 1.0))
    judgements = monitor.judgements(5.0)
    assert list(judgements) == ["battery_level", "link"]
    battery = judgements["battery_level"]
    assert (battery.level, battery.state, battery.judged, battery.since_s, battery.now_s) == (
        WARN,
        "firing",
        10.0,
        1.0,
        5.0,
    )


@pytest.mark.parametrize("now_s", [math.nan, math.inf, -math.inf, 0.0])
def test_the_state_is_never_shown_as_of_a_time_before_the_last_call(now_s: float) -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(50.0, 5.0)
    assert watched.monitor.judgements(now_s)["battery_level"].now_s == 5.0
    assert watched.status(now_s).values["age_s"] == "0"


def test_a_state_without_a_link_is_restored_without_one() -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(50.0, 0.0)
    saved = watched.monitor.snapshot("battery_level", 0.0, 1e9)
    restarted = Watched(warn_below=20.0)
    restarted.monitor.restore({"battery_level": saved}, 0.0, 1e9)
    for now_s in range(0, 100, 2):
        assert restarted.observe(50.0, float(now_s)) is None
        assert restarted.tick(float(now_s)) is None
    assert list(restarted.monitor.signals()) == ["battery_level"]


def test_the_link_is_up_down_or_not_watched() -> None:
    monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0}}}))
    assert monitor.link_up is None
    monitor.set_link(True, "", 1.0)
    assert monitor.link_up is True
    monitor.set_link(False, "refused", 2.0)
    assert monitor.link_up is False


def test_levels_are_those_of_the_report() -> None:
    monitor = Monitor(load_config({"signals": {"a": {"warn_below": 20.0}, "b": {"warn_below": 20.0}}}))
    assert monitor.levels() == {"a": (Level.STALE, "waiting"), "b": (Level.STALE, "waiting")}
    monitor.observe(Sample("a", 15.0, 1.0))
    monitor.set_link(True, "", 1.0)
    report = monitor.report(1.0)
    assert monitor.levels() == {
        name: (status.level, status.values["state"]) for name, status in report.statuses.items()
    }
    assert monitor.levels()["a"] == (Level.WARN, "firing")


def test_the_end_resolves_every_open_alert_the_link_included() -> None:
    monitor = Monitor(load_config({"signals": {"a": {"warn_below": 20.0}, "b": {"warn_below": 20.0}}}))
    monitor.observe(Sample("a", 15.0, 1.0))
    monitor.observe(Sample("b", 50.0, 1.0))
    monitor.set_link(False, "connection refused", 2.0)
    ended = monitor.end()
    assert [(end.signal, end.from_level, end.to_level) for end in ended] == [
        ("a", Level.WARN, Level.OK),
        ("link", Level.ERROR, Level.OK),
    ]
    assert all("no longer watched" in end.text for end in ended)
    assert monitor.end() == []


def test_a_signal_leads_with_its_statistic() -> None:
    config = load_config({"signals": {"imu": {"statistic": "frequency_hz", "window_s": 10.0, "window_min_s": 5.0}}})
    monitor = Monitor(config)
    for number in range(200):
        monitor.observe(Sample("imu", 1.0, number * 0.125))
        if number % 8 == 7:
            monitor.tick(number * 0.125)
    judgement = monitor.judgements(25.0)["imu"]
    assert wording.shown_text(judgement) == wording.reason(judgement) == "8 Hz"
    status = monitor.report(25.0).statuses["imu"]
    assert (status.values["value"], status.message) == ("1", "8 Hz")
    samples = monitor.shown_samples("imu")
    assert [time_s for time_s, _ in samples] == [14.875 + number for number in range(11)]
    assert [value for _, value in samples] == [8.0] * 11
    monitor.tick(35.0)
    assert len(monitor.shown_samples("imu")) == 11


def discharge(seconds: int, *, per_s: float = 0.5, start: float = 100.0) -> list[Sample]:
    return [Sample("battery_soon", start - per_s * second, float(second)) for second in range(seconds)]


FORECAST = {"statistic": "forecast", "unit": "%", "window_s": 40.0, "forecast_s": 60.0, "warn_below": 20.0}


def test_a_forecast_warns_before_the_bound_is_reached() -> None:
    """100 % at 0 s, 0.5 % per s less: the window is full at 40 s; below 50 % now means below 20 % in 60 s."""
    monitor = Monitor(load_config({"signals": {"battery_soon": FORECAST}}))
    found = [transition for sample in discharge(105) for transition in monitor.observe(sample)]
    assert [str(transition) for transition in found] == [
        "101.000 battery_soon WARN: forecast 19.5 % in 60 s is below 20 % (was OK for 101 s)"
    ]
    assert (found[0].value, found[0].statistic, found[0].bound) == (pytest.approx(19.5), "forecast", 20.0)
    assert found[0].statistics["trend_per_min"] == pytest.approx(-30.0)  # with the value, the line that gave the alert
    status = monitor.report(104.0).statuses["battery_soon"]
    assert status.message == "forecast 18 % in 60 s is below 20 %"
    assert (status.values["forecast"], status.values["trend_per_min"]) == ("18", "-30")
    assert status.values["value"] == "48"
    assert status.values["time_to_bound_s"] == "56"  # 28 % at 0.5 % per s
    assert status.forecast == Forecast(pytest.approx(18.0), pytest.approx(-0.5), 60.0, pytest.approx(56.0), 20.0)


def test_a_forecast_is_undefined_until_the_window_is_full() -> None:
    monitor = Monitor(load_config({"signals": {"battery_soon": FORECAST}}))
    for sample in discharge(40, per_s=2.0):
        assert monitor.observe(sample) == []
    status = monitor.report(39.0).statuses["battery_soon"]
    assert status.message == "forecast is undefined until window_min_s (40 s) has passed"
    assert status.forecast is None
    (transition,) = monitor.observe(discharge(41, per_s=2.0)[-1])
    assert transition.text == "battery_soon WARN: forecast -100 % in 60 s is below 20 % (was OK for 40 s)"


def test_a_jump_makes_the_halves_disagree_so_that_nothing_is_forecast_from_it() -> None:
    """A battery that is swapped at 60 s, from 100 to 60 %, both constant: no line through one half falls."""
    monitor = Monitor(load_config({"signals": {"battery_soon": FORECAST}}))
    for second in range(200):
        value = 100.0 if second < 60 else 60.0
        assert monitor.observe(Sample("battery_soon", value, float(second))) == []


def test_after_staleness_a_forecast_is_undefined_until_the_window_is_full_again() -> None:
    monitor = Monitor(load_config({"signals": {"battery_soon": {**FORECAST, "stale_after_s": 5.0}}}))
    for sample in discharge(60, per_s=0.1):
        monitor.observe(sample)
    (stale,) = monitor.tick(65.0)
    assert stale.to_level is Level.STALE
    (again,) = monitor.observe(Sample("battery_soon", 60.0, 70.0))
    assert again.text == "battery_soon OK: samples again (was STALE for 5 s)"
    for second in range(71, 110):
        assert monitor.observe(Sample("battery_soon", 130.0 - second, float(second))) == []
    (transition,) = monitor.observe(Sample("battery_soon", 20.0, 110.0))
    assert transition.text == "battery_soon WARN: forecast -40 % in 60 s is below 20 % (was OK for 40 s)"


def test_a_change_of_the_horizon_applies_at_once_to_the_samples_that_are_there() -> None:
    config = load_config({"signals": {"battery_soon": FORECAST}})
    monitor = Monitor(config)
    for sample in discharge(60):
        monitor.observe(sample)
    changed = load_config({"signals": {"battery_soon": {**FORECAST, "forecast_s": 120.0}}})
    (transition,) = monitor.configure(changed)
    assert transition.text == "battery_soon WARN: forecast 10.5 % in 120 s is below 20 % (was OK for 59 s)"


GAPS = {"statistic": "largest_gap_s", "warn_above": 1.0, "window_s": 10.0, "window_min_s": 0.0, "unit": "m"}


def test_the_largest_gap_of_the_window_is_judged() -> None:
    monitor = Monitor(load_config({"signals": {"scan_gap": GAPS}}))
    times = [0.0, 0.5, 2.9, 3.4, 12.8, 13.0]
    found = [transition.text for at_s in times for transition in monitor.observe(Sample("scan_gap", 7.0, at_s))]
    assert found == ["scan_gap WARN: largest gap 2.4 s is above 1 s (was OK for 2.9 s)"]
    status = monitor.report(13.0).statuses["scan_gap"]
    assert (status.values["largest_gap_s"], status.values["value"]) == ("9.4", "7")  # the arrival before it has left


def test_bad_samples_are_arrivals_and_one_arrival_makes_no_gap() -> None:
    monitor = Monitor(load_config({"signals": {"scan_gap": {**GAPS, "invalid_for_s": 60.0}}}))
    monitor.observe(Sample("scan_gap", 1.0, 0.0))
    assert monitor.report(0.0).statuses["scan_gap"].message == "largest_gap_s is undefined: too few samples"
    for second in (1.0, 2.0, 3.0):
        monitor.observe(Sample("scan_gap", float("nan"), second))
    assert monitor.observe(Sample("scan_gap", 1.0, 4.0)) == []
    assert monitor.report(4.0).statuses["scan_gap"].values["largest_gap_s"] == "1"


def test_the_downtime_of_the_link_is_no_gap() -> None:
    monitor = Monitor(load_config({"signals": {"scan_gap": GAPS}}))
    for second in (0.0, 1.0):
        monitor.observe(Sample("scan_gap", 1.0, second))
    monitor.set_link(False, "", 1.5)
    monitor.set_link(True, "", 9.0)
    monitor.observe(Sample("scan_gap", 1.0, 9.25))
    assert monitor.report(9.25).statuses["scan_gap"].values["largest_gap_s"] == "1"


def gap_after(monitor: Monitor, now_s: float) -> str:
    monitor.observe(Sample("scan_gap", 1.0, now_s))
    return monitor.report(now_s).statuses["scan_gap"].values["largest_gap_s"]


def test_a_sample_that_was_on_its_way_while_the_link_was_down_ends_no_false_gap() -> None:
    monitor = Monitor(load_config({"signals": {"scan_gap": {**GAPS, "stale_after_s": 0.0}}}))
    for second in (0.0, 1.0):
        monitor.observe(Sample("scan_gap", 1.0, second))
    monitor.set_link(False, "", 1.5)
    assert gap_after(monitor, 6.0) == "1"
    monitor.set_link(True, "", 8.0)
    assert gap_after(monitor, 9.75) == "1.75"  # nothing came while the link was up again


def test_a_pause_of_the_monitor_and_time_that_goes_back_are_no_gaps() -> None:
    monitor = Monitor(load_config({"signals": {"scan_gap": GAPS}}))
    for second in (0.0, 1.0):
        monitor.observe(Sample("scan_gap", 1.0, second))
    assert monitor.skip(1.25, 7.25) == []
    assert gap_after(monitor, 8.0) == "1"
    assert monitor.skip(8.0, 300.0) == []
    assert gap_after(monitor, 300.5) == "0.5"
    monitor.observe(Sample("scan_gap", 1.0, 100.0))
    assert monitor.report(100.0).statuses["scan_gap"].message == "largest_gap_s is undefined: too few samples"
    assert gap_after(monitor, 100.25) == "0.25"


def test_gaps_are_kept_when_the_window_changes_and_begin_anew_when_they_were_not_measured() -> None:
    monitor = Monitor(load_config({"signals": {"scan_gap": GAPS}}))
    for at_s in (0.0, 3.0, 4.0):
        monitor.observe(Sample("scan_gap", math.nan if at_s == 3.0 else 1.0, at_s))
    monitor.configure(load_config({"signals": {"scan_gap": {**GAPS, "window_s": 20.0}}}))
    assert gap_after(monitor, 4.5) == "3"
    monitor.configure(load_config({"signals": {"scan_gap": {"statistic": "mean", "window_min_s": 0.0}}}))
    monitor.configure(load_config({"signals": {"scan_gap": {**GAPS, "window_s": 20.0}}}))
    assert monitor.report(4.5).statuses["scan_gap"].message == "largest_gap_s is undefined: too few samples"
    monitor.observe(Sample("scan_gap", 1.0, 5.0))
    assert gap_after(monitor, 5.5) == "0.5"


@pytest.mark.parametrize("pause_s", [5.0, 15.0, 60.0])
def test_a_pause_an_outage_and_time_that_goes_back_give_no_false_forecast(pause_s: float) -> None:
    """While nothing was known, the charge fell from 95 to 60 %; before and after, it is constant."""
    back = Monitor(load_config({"signals": {"battery_soon": FORECAST}}))
    paused = Monitor(load_config({"signals": {"battery_soon": FORECAST}}))
    unreachable = Monitor(load_config({"signals": {"battery_soon": FORECAST}}))
    for second in range(100):
        for monitor in (back, paused, unreachable):
            assert monitor.observe(Sample("battery_soon", 95.0, 100.0 + second)) == []
    begins_s = 199.0 + pause_s
    assert paused.skip(199.0, begins_s) == []
    unreachable.set_link(False, "", 199.0)
    unreachable.set_link(True, "", begins_s)
    for second in range(100):
        sample = Sample("battery_soon", 60.0, begins_s + second)
        assert (paused.observe(sample), unreachable.observe(sample)) == ([], [])
        assert back.observe(sample._replace(now_s=199.0 - pause_s + second)) == []


def test_the_values_of_a_statistic_to_show_are_at_most_300_and_begin_anew_with_time() -> None:
    monitor = Monitor(load_config({"signals": {"a": {"statistic": "mean", "window_s": 60.0, "window_min_s": 0.0}}}))
    for number in range(2000):
        monitor.observe(Sample("a", 1.0, number * 0.05))
        monitor.tick(number * 0.05)
    assert 200 < len(monitor.shown_samples("a")) <= 300
    monitor.tick(5.0)
    assert monitor.shown_samples("a") == []


def test_the_values_of_a_signal_without_a_statistic_to_show_are_its_samples() -> None:
    watched = Watched(warn_below=20.0)
    watched.observe(50.0, 0.0)
    assert watched.monitor.shown_samples("battery_level") == watched.monitor.window_samples("battery_level")
