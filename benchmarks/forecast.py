"""How often a forecast alerts falsely, and how early it warns, in simulated robots with fixed seeds."""

from __future__ import annotations

import random
import statistics
from typing import Iterator

from harness.forecast_scenes import FORECAST_S, NOISES, SCENES, false_alarms, false_alarms_of_one_line, flat, lead_s

from benchmarks.table import Row

HOURS, ONE_LINE_HOURS, RUNS = 1000, 100, 50
ALLOWED = {(3.0, 200.0): 10}
"""False alarms in 1,000 h, per noise. 3 % over 200 s looks like a trend for longer than `for_s`."""


def rows() -> Iterator[Row]:
    """Yields the figures."""
    for noise in NOISES:
        alarms, most = false_alarms(flat(*noise), HOURS * 3600, warn_below=40.0), ALLOWED.get(noise, 0)
        what = "55 %, noise of {:g} % over {:g} s, bound 40 %".format(*noise)
        yield Row(what, "forecast, for_s 300", f"{alarms} in {HOURS:,} h", alarms, most, "false alarms")
        alarms = false_alarms_of_one_line(flat(*noise), ONE_LINE_HOURS * 3600)
        yield Row("the same", "one line, for_s 300", f"{alarms} in {ONE_LINE_HOURS:,} h", remark="false alarms")
    for what, scene in SCENES.items():
        alarms = sum(scene.false_alarms(random.Random(f"{what} {number}")) for number in range(RUNS))
        figure = f"{alarms} in {RUNS * scene.seconds / 3600.0:,.0f} h"
        yield Row(what, "forecast, for_s 300", figure, alarms, 0.0, "false alarms")
    leads_s = sorted(lead_s(random.Random(number)) for number in range(RUNS))
    median_s = statistics.median(leads_s)
    figure = f"{median_s:.0f} s, the worst of {RUNS} {leads_s[0]:.0f} s"
    remark = f"80 % of the horizon of {FORECAST_S:g} s, to the median"
    what = "1 % less per minute, noise of 0.5 %, bound 20 %: lead"
    yield Row(what, "forecast, for_s 60", figure, 0.8 * FORECAST_S / median_s, 1.0, remark)
