"""Recorded alerts occur again, over random thresholds, samples and ticks; test_alert_test.py has one case of each."""

from __future__ import annotations

from typing import Dict

import pytest
from harness.random_alerts import random_alerts

from robot_health_monitor.reconstruction import reconstruct
from robot_health_monitor.threshold_tests import ThresholdTest, run_test

LEAST: Dict[str, float] = {
    "last": 0.95, "mean": 0.6, "min": 0.7, "max": 0.7, "stddev": 0.6, "rate": 0.6, "forecast": 0.3,
}  # fmt: skip
"""Share of the random alerts that must occur again: the window of many is too short for what was before."""


@pytest.mark.parametrize("statistic", LEAST)
def test_an_alert_occurs_as_it_came_or_the_reason_is_named(statistic: str) -> None:
    occurred = total = 0
    for seed in range(6 if statistic == "last" else 1):
        for config, recorded, text in random_alerts(seed, statistic):
            found = reconstruct(config, recorded)
            total += 1
            if found.missing:
                assert "these samples give" in found.missing
                continue
            occurred += 1
            alerts = run_test(config, ThresholdTest("", found.interval_s, {recorded.signal: found.series}, ()))
            assert alerts == list(found.alerts)
            assert alerts[-1].level is recorded.to_level
            assert alerts[-1].at_s == pytest.approx(found.at_s, abs=1e-6)
            reason = text.split(" (was")[0]
            if statistic == "last" and not found.remark and "pending" not in reason and "no sample" not in reason:
                assert alerts[-1].text.split(" (was")[0] == reason
    assert total >= 3
    assert occurred >= LEAST[statistic] * total, (occurred, total)
