"""How often a forecast alerts falsely, how early it warns, and how well it knows when a cell will be empty.

Simulated robots with fixed seeds, and discharges of ProgPy's model of a Li-ion cell: M. Daigle and C. Kulkarni,
"Electrochemistry-based battery modeling for prognostics" (PHM 2013), fitted to cells of NASA's laboratory.
"""

from __future__ import annotations

import random
import statistics
import warnings
from typing import Iterator, Sequence

from harness import forecast_scenes as scenes
from harness.forecast_scenes import FORECAST_S, NOISES, SCENES, WINDOW_S

from benchmarks.table import Row
from robot_health_monitor.core import Level, Monitor, Sample, load_config

HOURS, ONE_LINE_HOURS, RUNS = 1000, 100, 50
ALLOWED = {(3.0, 200.0): 10}
"""False alarms in 1,000 h, per noise. 3 % over 200 s looks like a trend for longer than `for_s`."""
CELLS = 20
"""Discharges at each kind of load."""
CURRENTS_A, LOAD_LASTS_S = (0.8, 3.0), (30.0, 300.0)
"""Of a cell of 2 Ah."""
EVERY_S, LEAST_S = 30, 120
"""Time between two looks at `time_to_bound_s`; shortest remaining time whose relative error counts."""


def alarms() -> Iterator[Row]:
    """Yields the false alarms in simulated robots, and the lead before a bound that will be crossed."""
    for noise in NOISES:
        count, most = scenes.false_alarms(scenes.flat(*noise), HOURS * 3600, warn_below=40.0), ALLOWED.get(noise, 0)
        what = "55 %, noise of {:g} % over {:g} s, bound 40 %".format(*noise)
        yield Row(what, "forecast, for_s 300", f"{count} in {HOURS:,} h", count, most, "false alarms")
        count = scenes.false_alarms_of_one_line(scenes.flat(*noise), ONE_LINE_HOURS * 3600)
        yield Row("the same", "one line, for_s 300", f"{count} in {ONE_LINE_HOURS:,} h", remark="false alarms")
    for what, scene in SCENES.items():
        count = sum(scene.false_alarms(random.Random(f"{what} {number}")) for number in range(RUNS))
        figure = f"{count} in {RUNS * scene.seconds / 3600.0:,.0f} h"
        yield Row(what, "forecast, for_s 300", figure, count, 0.0, "false alarms")
    leads_s = sorted(scenes.lead_s(random.Random(number)) for number in range(RUNS))
    median_s = statistics.median(leads_s)
    figure = f"{median_s:.0f} s, the worst of {RUNS} {leads_s[0]:.0f} s"
    remark = f"80 % of the horizon of {FORECAST_S:g} s, to the median"
    what = "1 % less per minute, noise of 0.5 %, bound 20 %: lead"
    yield Row(what, "forecast, for_s 60", figure, 0.8 * FORECAST_S / median_s, 1.0, remark)


def cells() -> Iterator[Row]:
    """Yields how well the time until a battery is empty is known."""
    for load in ("constant", "random"):
        chance = random.Random(load)
        charges, voltages = zip(*(_discharge(chance, load == "constant") for _ in range(CELLS)))
        whole = [[float(round(value)) for value in each] for each in charges]
        for what, values, bound, window_s in (
            ("20 % charge", charges, 20.0, WINDOW_S),
            ("20 % charge in whole %", whole, 20.0, WINDOW_S),
            ("20 % charge, window 1800 s", charges, 20.0, 3.0 * WINDOW_S),
            ("3.4 V", voltages, 3.4, WINDOW_S),
        ):
            yield from _rows_of(f"{load} load, {what}", [judge(each, bound, window_s) for each in values])


def _rows_of(what: str, judged: Sequence[tuple[list[float], int, float]]) -> Iterator[Row]:
    """Yields quartiles of the errors, and of the time that is left at the alert."""
    errors = [error for errors, _, _ in judged for error in errors]
    unstated = sum(count for _, count, _ in judged)
    twentieths = statistics.quantiles(errors, n=20)
    remark = f"nine of ten {_percent(twentieths[0])} to {_percent(twentieths[-1])} %"
    if unstated:
        remark += f"; {100.0 * unstated / (unstated + len(errors)):.0f} % without a time"
    quartiles = ", ".join(map(_percent, statistics.quantiles(errors, n=4)))
    yield Row(what, "error of time_to_bound_s", f"{quartiles} %", remark=remark)
    left_min = [left_s / 60.0 for _, _, left_s in judged]
    quartiles = ", ".join(f"{each:.0f}" for each in statistics.quantiles(left_min, n=4))
    remark = f"the shortest of {CELLS}: {min(left_min):.0f} min"
    yield Row(what, "time left at the alert", f"{quartiles} min", remark=remark)


def _percent(share: float) -> str:
    """Returns a share in %, without the unit; never `-0`."""
    return f"{round(100.0 * share) or 0:+d}"


def judge(values: Sequence[float], bound: float, window_s: float) -> tuple[list[float], int, float]:
    """Returns what a forecast says until the first value below the bound.

    These are the relative errors of `time_to_bound_s`, how often there was none, and the time from the alert to the
    bound in s, which is 0 without an alert.
    """
    signal = {"statistic": "forecast", "window_s": window_s, "forecast_s": FORECAST_S, "for_s": 60.0}
    monitor = Monitor(load_config({"signals": {"cell": {**signal, "warn_below": bound}}}))
    reached_s = next(second for second, value in enumerate(values) if value < bound)
    errors: list[float] = []
    unstated, left_s = 0, 0.0
    for second, value in enumerate(values[:reached_s]):
        for transition in monitor.observe(Sample("cell", value, float(second))):
            if transition.to_level is Level.WARN and not left_s:
                left_s = float(reached_s - second)
        status = monitor.status("cell", float(second)) if second % EVERY_S == 0 else None
        if status is None or status.forecast is None or reached_s - second < LEAST_S:
            continue
        if status.forecast.time_to_bound_s is None:
            unstated += 1
        else:
            errors.append(status.forecast.time_to_bound_s / (reached_s - second) - 1.0)
    return errors, unstated, left_s


def _discharge(chance: random.Random, constant: bool) -> tuple[list[float], list[float]]:
    """Returns charge in % and voltage of a cell from full to empty, one value per second.

    The current stays, or changes every 30 to 300 s, as that of a robot that drives and waits.
    """
    until_s, current_a = 1e9 if constant else 0.0, chance.uniform(*CURRENTS_A)

    def load(now_s: float, state: object = None) -> object:
        nonlocal until_s, current_a
        while now_s >= until_s:
            until_s += chance.uniform(*LOAD_LASTS_S)
            current_a = chance.uniform(*CURRENTS_A)
        return cell.InputContainer({"i": current_a})

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ProgPy, about its own defaults
        from progpy.models import BatteryElectroChemEOD

        cell = BatteryElectroChemEOD()
        run = cell.simulate_to_threshold(load, dt=1.0, save_freq=1.0, horizon=1e5)
    return [100.0 * float(each["EOD"]) for each in run.event_states], [float(each["v"]) for each in run.outputs]
