"""Recorded alerts occur again, over random thresholds, samples and ticks; test_past_alert.py has one case of each."""

from __future__ import annotations

import random
from typing import Dict, List, Tuple

import pytest
from harness.random_alerts import random_alerts

from robot_health_monitor.alert_attempts import RecordedAlert
from robot_health_monitor.core import Level, load_config
from robot_health_monitor.reconstruction import reconstruct
from robot_health_monitor.threshold_tests import ThresholdTest, run_test

MISSING: Dict[str, Tuple[int, int]] = {
    "last": (6, 0), "mean": (3, 0), "min": (2, 0), "max": (2, 1), "stddev": (1, 0), "rate": (2, 0),
    "frequency_hz": (6, 0), "largest_gap_s": (6, 0), "forecast": (2, 1),
}  # fmt: skip
"""Number of random robots, and how many of their alerts may not occur again: what came before is not stored."""


@pytest.mark.parametrize("statistic", MISSING)
def test_an_alert_occurs_as_it_came_or_the_reason_is_named(statistic: str) -> None:
    seeds, allowed = MISSING[statistic]
    missing = total = 0
    for seed in range(seeds):
        for config, recorded, text in random_alerts(seed, statistic):
            found = reconstruct(config, recorded, {})
            total += 1
            if found.missing:
                assert "these samples give" in found.missing
                missing += 1
                continue
            alerts = run_test(config, ThresholdTest("", found.interval_s, found.series, ()))
            assert alerts == list(found.alerts)
            levels = [Level.OK, *(alert.level for alert in alerts)]
            assert levels[-2:] == [recorded.from_level, recorded.to_level]
            assert alerts[-1].at_s == pytest.approx(found.at_s, abs=1e-6)
            reason = text.split(" (was")[0]
            if statistic == "last" and not found.remark and "pending" not in reason and "no sample" not in reason:
                assert alerts[-1].text.split(" (was")[0] == reason
    assert total >= 5
    assert missing <= allowed, (missing, total)


def recorded_alert(samples: List[Tuple[float, float]], since_s: float) -> RecordedAlert:
    return RecordedAlert("b", Level.OK, Level.WARN, 110.0, 15.0, 20.0, samples, recorded_since_s=since_s)


SIGNALS = {
    "b": {"warn_below": 20.0, "only_if": {"signal": "driving", "above": 0.5}, "stale_after_s": 4.0},
    "driving": {"stale_after_s": 2.0},
}


def test_the_series_of_a_condition_is_that_of_its_samples() -> None:
    """Below 20 from 105 s on, driving from 110 s on."""
    samples = [(100.0 + number, 25.0 if number < 5 else 15.0) for number in range(11)]
    driving = [(100.0 + number, 0.0 if number < 10 else 1.0) for number in range(11)]
    found = reconstruct(load_config({"signals": SIGNALS}), recorded_alert(samples, 100.0), {"driving": driving})
    assert (found.missing, found.remark) == ("", "")
    assert found.series == {"b": [25.0] * 5 + [15.0] * 6, "driving": [0.0] * 10 + [1.0]}


def test_a_condition_without_samples_is_assumed_to_be_met() -> None:
    samples = [(100.0 + number, 25.0 if number < 10 else 15.0) for number in range(11)]
    found = reconstruct(load_config({"signals": SIGNALS}), recorded_alert(samples, 100.0), {})
    assert found.remark == "samples of driving are not stored; values that meet the condition are assumed"
    assert found.series["driving"] == [1.5] * 11
    assert [(alert.at_s, alert.signal, alert.level) for alert in found.alerts] == [(10.0, "b", Level.WARN)]


def test_stored_values_of_a_condition_are_held_until_the_next_one() -> None:
    """A history has one value per 10 s; the monitor calls that stale after 2 s."""
    samples = [(100.0 + number, 15.0) for number in range(11)]
    recorded = recorded_alert(samples, 100.0)._replace(recorded_since_s=None)
    config = load_config({"signals": SIGNALS})
    found = reconstruct(config, recorded, {"driving": [(90.0, 0.0), (100.0, 0.0), (110.0, 1.0)]})
    assert found.series["driving"] == [0.0] * 10 + [1.0]
    assert found.remark == "the condition is judged by stored values, 10 s apart"
    assert [(alert.at_s, alert.signal, alert.level) for alert in found.alerts] == [(10.0, "b", Level.WARN)]


@pytest.mark.parametrize("seed", range(5))
def test_samples_of_any_times_give_a_series_that_a_test_can_have(seed: int) -> None:
    chance = random.Random(seed)
    times = sorted(110.0 - chance.uniform(0.0, 20.0) for _ in range(chance.choice([1, 3, 200])))
    found = reconstruct(load_config({"signals": SIGNALS}), recorded_alert([(each, 15.0) for each in times], 80.0), {})
    assert found.interval_s >= 0.001
    assert len({len(series) for series in found.series.values()}) == 1
