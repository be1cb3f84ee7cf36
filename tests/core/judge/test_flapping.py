"""Which levels are announced, and when again; flapping and storms: Nagios's percentages and docs/rules.md by hand."""

from __future__ import annotations

import json
from typing import Any, Mapping, Sequence

import pytest
from harness.seeds import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.core import Level, Monitor, Sample, Transition, load_config
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.judge.alert import Alert
from robot_health_monitor.core.judge.flapping import FlapDetector
from robot_health_monitor.core.judge.saved_state import Downtime, SavedState
from robot_health_monitor.core.judge.signal_monitor import SignalMonitor

OK, WARN, ERROR, STALE = Level.OK, Level.WARN, Level.ERROR, Level.STALE


def alert(**settings: Any) -> Alert:
    return Alert(read_signal("battery", {"flap_detection": True, **settings}), "atlas", 0.0)


def announce(under_test: Alert, level: Level, now_s: float = 1.0) -> Any:
    judgement = SignalMonitor(read_signal("battery", {}), "atlas", 0.0).judgement(now_s)
    return under_test.announce(judgement._replace(level=level, flapping=under_test.flaps.flapping))


def flapping(announced: Level) -> Alert:
    """An alert that flaps, with `announced` as the transition that reached the limit."""
    under_test = alert()
    for number in range(21):
        under_test.flaps.add(WARN if number % 2 else OK)
    assert under_test.flaps.flapping
    announce(under_test, announced)
    return under_test


def test_nothing_is_withheld_without_flapping() -> None:
    assert not alert().flaps.withholds(OK)
    assert not alert().flaps.withholds(WARN)


@pytest.mark.parametrize(
    ("announced", "level", "is_withheld"),
    [
        (WARN, OK, True),
        (WARN, ERROR, False),
        (WARN, STALE, False),
        (ERROR, STALE, True),
        (STALE, WARN, True),
        (STALE, ERROR, False),
        (OK, WARN, False),
    ],
)
def test_flapping_withholds_what_is_not_worse(announced: Level, level: Level, is_withheld: bool) -> None:
    assert flapping(announced).flaps.withholds(level) is is_withheld


def test_a_worse_level_is_news_only_once() -> None:
    under_test = flapping(WARN)
    announce(under_test, ERROR)
    assert under_test.flaps.withholds(WARN)
    announce(under_test, STALE)
    assert under_test.flaps.withholds(ERROR)


def test_transitions_chain() -> None:
    under_test = alert()
    first, second = announce(under_test, WARN, 3.0), announce(under_test, ERROR, 5.0)
    assert (first.from_level, first.to_level, second.from_level, second.to_level) == (OK, WARN, WARN, ERROR)
    assert (first.since_s, second.since_s) == (3.0, 3.0)  # it was never known to be OK


def test_time_in_which_the_level_was_unknown_does_not_count_as_ok() -> None:
    under_test = alert()  # at 0 s
    under_test.note_known(4.0)
    under_test.inhibit(6.0)
    under_test.inhibit(7.0)
    first = announce(under_test, WARN, 10.0)
    assert (first.since_s, first.text[-16:]) == (8.0, "(was OK for 2 s)")


def test_a_level_that_is_not_ok_is_repeated_every_repeat_s() -> None:
    under_test = alert(repeat_s=10.0)
    assert not under_test.is_repeat_due(100.0)
    announce(under_test, WARN, 100.0)
    assert not under_test.is_repeat_due(109.0)
    assert under_test.is_repeat_due(110.0)
    assert announce(under_test, WARN, 110.0).repeat
    assert not under_test.is_repeat_due(119.0)


OK, WARN, ERROR, STALE = Level
NOISY = (15.0, 50.0)


def fed(*levels: Level, high: float = 50.0, low: float = 25.0) -> FlapDetector:
    detector = FlapDetector(high, low)
    for level in levels:
        detector.add(level)
    return detector


def test_no_change_is_0_percent() -> None:
    assert fed(*[OK] * 30).percent == 0.0


def test_a_change_in_every_sample_is_100_percent() -> None:
    assert fed(*[WARN, OK] * 20).percent == 100.0


def test_the_newest_change_weighs_1_25_of_20() -> None:
    assert fed(WARN).percent == pytest.approx(100 * 1.25 / 20)


def test_the_oldest_change_weighs_0_75_of_20() -> None:
    assert fed(*[WARN] * 20).percent == pytest.approx(100 * 0.75 / 20)


def test_a_change_older_than_21_levels_is_forgotten() -> None:
    assert fed(*[WARN] * 21).percent == 0.0


def test_a_change_between_warn_and_error_counts_as_much_as_one_to_ok() -> None:
    assert fed(WARN, ERROR).percent == fed(WARN, OK).percent


def test_flapping_begins_exactly_at_the_high_limit() -> None:
    # Changes at places 0..4 (oldest) and 15..19 (newest) pair up to 2.0 each: 10 of 20, exactly 50 %.
    paired = [WARN, OK, WARN, OK, WARN] + [WARN] * 10 + [OK, WARN, OK, WARN, OK]
    assert fed(*paired).percent == 50.0
    assert fed(*paired, high=50.0).flapping
    assert not fed(*paired, high=50.01).flapping


def test_flapping_ends_only_below_the_low_limit() -> None:
    paired = [WARN, OK, WARN, OK, WARN] + [WARN] * 10 + [OK, WARN, OK, WARN, OK]
    detector = fed(*paired, low=50.0)
    assert detector.flapping  # 50 is not below 50
    detector.add(OK)
    assert not detector.flapping


def test_new_limits_decide_from_the_next_sample_on() -> None:
    detector = fed(WARN, OK, WARN, OK)
    assert not detector.flapping
    detector.high, detector.low = 10.0, 5.0
    assert not detector.flapping
    detector.add(OK)
    assert detector.flapping


def monitor(**signal: Any) -> Monitor:
    return Monitor(load_config({"signals": {"a": {"warn_below": 20.0, "error_below": 10.0, **signal}}}))


def observed(
    under_test: Monitor, values: Sequence[object], begin_s: float = 0.0, step_s: float = 0.0025
) -> list[Transition]:
    """Observes values at a fixed distance, and ticks every second."""
    found: list[Transition] = []
    tick_s = begin_s + 1.0
    for number, value in enumerate(values):
        now_s = begin_s + number * step_s
        while tick_s <= now_s:
            found += under_test.tick(tick_s)
            tick_s += 1.0
        found += under_test.observe(Sample("a", value, now_s))
    return found


def test_noise_at_400_hz_is_61_transitions_and_the_last_says_that_it_flaps() -> None:
    under_test = monitor()
    found = observed(under_test, NOISY * 2000)  # 10 s
    assert len(found) == 61
    assert all("flapping" not in each.text for each in found[:-1])
    assert found[-1].text == (
        "a WARN: 15 is below 20 (was OK for 0.0025 s), "
        "flapping: more than 60 transitions in 60 s, further changes not announced until it settles"
    )
    values = under_test.report(10.0).statuses["a"].values
    assert (values["flapping"], values["state_change_percent"]) == ("true", "100")


@pytest.mark.newest_python
def test_it_lasts_as_long_as_the_noise_and_ends_with_the_level_that_is_true_then() -> None:
    under_test = monitor()
    observed(under_test, NOISY * 20_000)  # 100 s
    assert observed(under_test, [50.0] * 13, 100.0) == []  # the oldest 7 of 20 changes are left: 29 %
    (end,) = observed(under_test, [50.0], 100.04)  # 24.5 %
    assert (end.from_level, end.to_level) == (WARN, OK)
    assert "flapping" not in end.text
    assert under_test.report(101.0).statuses["a"].values["flapping"] == "false"


def test_it_does_not_end_before_at_most_60_transitions_lie_within_the_last_60_s() -> None:
    under_test = monitor(stale_after_s=0.0)
    first, *_, last = observed(under_test, NOISY * 50)  # 61 transitions from 0.0 to 0.15 s
    assert (first.now_s, last.now_s) == pytest.approx((0.0, 0.15))
    assert observed(under_test, [50.0] * 118, 1.0, 0.5) == []  # calm until 59.5 s
    assert under_test.observe(Sample("a", 50.0, 60.0)) == []  # with the one that ends it, 61 lie within 60 s
    (end,) = under_test.observe(Sample("a", 50.0, 60.0025))
    assert (end.to_level, end.text) == (OK, "a OK: 50 is no longer below 20 (was WARN for 59.9 s)")


def test_stale_invalid_and_worse_are_still_announced() -> None:
    under_test = monitor()
    observed(under_test, NOISY * 200)
    (stale,) = under_test.tick(7.0)
    (worse,) = observed(under_test, [5.0], 8.0)
    assert observed(under_test, [*NOISY, 5.0], 8.1) == []
    (stale_again,) = observed(under_test, [50.0], 9.0) + under_test.tick(15.0)
    (invalid,) = observed(under_test, [float("nan")], 16.0)
    assert [each.to_level for each in (stale, worse, stale_again, invalid)] == [STALE, ERROR, STALE, ERROR]


@pytest.mark.newest_python
@pytest.mark.parametrize("offset_s", [0.0, 0.1, 1e9 + 0.3])
def test_once_per_second_is_no_storm(offset_s: float) -> None:
    found = observed(monitor(), NOISY * 300, offset_s, 1.0)
    assert len(found) == 600
    assert not any("flapping" in each.text for each in found)


def test_repetitions_are_no_transitions() -> None:
    found = observed(monitor(repeat_s=0.1), [15.0] * 1000, step_s=0.1)
    assert len(found) > 90
    assert not any("flapping" in each.text for each in found)


def test_time_that_goes_back_does_not_end_it() -> None:
    under_test = monitor()
    found: list[Transition] = []
    for _ in range(200):  # a loop of 0.1 s
        found += observed(under_test, NOISY * 20)
    assert len(found) == 61


def test_a_restart_does_not_begin_a_new_minute() -> None:
    under_test = monitor()
    now_s, found = 0.0, []
    for _ in range(10):
        found += observed(under_test, NOISY * 15, now_s)
        now_s += 0.1
        saved = json.loads(json.dumps({"a": under_test.snapshot("a", now_s, 1e9 + now_s)}))
        assert len(json.dumps(saved)) < 2000
        under_test = monitor()
        under_test.restore(saved, now_s, 1e9 + now_s)
    assert len(found) == 61
    saved = {"a": under_test.snapshot("a", now_s, 1e9)}
    later = monitor()
    later.restore(saved, 0.0, 1e9 + 60.0)
    assert len(observed(later, [50.0] * 20)) == 1  # the storm is over


def test_the_configuration_changes_nothing_about_a_storm() -> None:
    under_test = monitor()
    observed(under_test, NOISY * 200)
    for signal in ({"flap_detection": True}, {"flap_detection": False}):
        assert under_test.configure(monitor(**signal).config) == []
    assert observed(under_test, NOISY * 200, 1.0) == []


def test_turning_flap_detection_off_ends_flapping_without_a_storm() -> None:
    under_test = monitor(flap_detection=True)
    observed(under_test, NOISY * 20, step_s=1.0)
    (change,) = under_test.configure(monitor().config)
    assert change.to_level is OK


@pytest.mark.newest_python
def test_the_memory_is_bounded() -> None:
    under_test = alert()
    for number in range(1_000):
        announce(under_test, WARN if number % 2 == 0 else OK, number * 0.001)
    saved: dict[str, Any] = {}
    under_test.exchange(SavedState(10.0, saved))
    times = saved["storm"]
    assert (len(times), times[0], times[-1]) == (61, pytest.approx(0.939), 0.999)
    under_test.exchange(SavedState(10.0, {"storm": [1.0] * 10_000}, Downtime(10.0, 10.0)))
    under_test.exchange(SavedState(10.0, saved))
    assert saved["storm"] == [1.0] * 61


steps = st.lists(
    st.tuples(
        st.sampled_from((0.0025, 0.0025, 0.1, 0.9, 1.0, 7.0)),
        st.sampled_from((15.0, 50.0, 15.0, 50.0, 5.0, float("nan"))),
        st.integers(1, 40),
    ),
    max_size=12,
)
settings_of_signal = st.fixed_dictionaries(
    {},
    optional={
        "flap_detection": st.booleans(),
        "stale_after_s": st.sampled_from((0.0, 0.5, 5.0)),
        "for_s": st.sampled_from((0.0, 0.01)),
        "hysteresis": st.sampled_from((0.0, 2.0)),
        "latch": st.booleans(),
        "statistic": st.sampled_from(("last", "mean")),
    },
)


@pytest.mark.newest_python
@settings(max_examples=examples(75), deadline=None)
@given(settings_of_signal, steps)
def test_beyond_61_in_a_minute_only_what_flapping_never_hides_is_announced(
    signal: Mapping[str, Any], sequence: list[tuple[float, float, int]]
) -> None:
    under_test = monitor(**signal)
    now_s = 0.0
    worst: list[Level] = []
    times: list[float] = []
    for step_s, value, number in sequence:
        for place in range(number):
            now_s += step_s
            found = under_test.observe(Sample("a", value if place % 2 else 50.0, now_s)) + under_test.tick(now_s)
            for each in found:
                recent = [time_s for time_s in times if now_s - time_s < 60.0 - 1e-6]
                if len(recent) > 60:
                    is_news = each.bound is None and each.to_level is ERROR
                    is_worse = all(each.to_level.severity > level.severity for level in worst)
                    assert is_news or is_worse or each.to_level is STALE
                    assert "flapping" in each.text
                worst = [*worst, each.to_level] if len(recent) >= 60 else []
                times.append(now_s)


@pytest.mark.newest_python
@settings(max_examples=examples(50), deadline=None)
@given(settings_of_signal, st.lists(st.sampled_from((5.0, 15.0, 50.0)), min_size=65, max_size=200))
def test_data_that_come_once_per_second_are_judged_as_before(signal: Mapping[str, Any], values: list[float]) -> None:
    signal = {**signal, "stale_after_s": 5.0}
    limited = [str(each) for each in observed(monitor(**signal), values, step_s=1.0)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Alert, "is_storm", lambda self, now_s, more=0: False)
        unlimited = [str(each) for each in observed(monitor(**signal), values, step_s=1.0)]
    assert limited == unlimited
