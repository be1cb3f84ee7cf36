"""How well a forecast knows when a cell will be empty, on discharges of ProgPy's model of a Li-ion cell.

The model: M. Daigle and C. Kulkarni, "Electrochemistry-based battery modeling for prognostics" (PHM 2013), fitted to
cells of NASA's laboratory.
"""

from __future__ import annotations

import random
import statistics
import warnings
from itertools import chain
from typing import Callable, Dict, Iterator, List, NamedTuple, Sequence

from benchmarks.table import Row
from robot_health_monitor.core import Level, Monitor, Sample, load_config

CELLS = 20
"""Discharges at each kind of load."""

CURRENTS_A = (0.8, 3.0)
"""Of a cell of 2 Ah."""

LOAD_LASTS_S = (30.0, 300.0)
WINDOW_S, FORECAST_S = 600.0, 1800.0
EVERY_S = 30
"""Time between two looks at `time_to_bound_s`."""

LEAST_S = 120
"""Shortest remaining time whose relative error counts."""

_Load = Callable[[float], float]
"""Current in A at a time in s."""


class Discharge(NamedTuple):
    """A cell from full to empty, one value per second."""

    charge: List[float]
    """In %."""
    voltage: List[float]
    """In V."""


class Judged(NamedTuple):
    """What a forecast said during one discharge."""

    errors: List[float]
    """Relative errors of `time_to_bound_s`."""
    unstated: int
    """Looks at which there was no `time_to_bound_s`."""
    left_s: float
    """Time from the alert to the bound; 0: no alert before it."""


def rows() -> Iterator[Row]:
    """Yields the figures."""
    for load, make in (("constant", constant_load), ("random", random_load)):
        chance = random.Random(load)
        cells = [discharge(make(chance)) for _ in range(CELLS)]
        charges, voltages = [cell.charge for cell in cells], [cell.voltage for cell in cells]
        whole = [[float(round(value)) for value in each] for each in charges]
        for what, values, bound, window_s in (
            ("20 % charge", charges, 20.0, WINDOW_S),
            ("20 % charge in whole %", whole, 20.0, WINDOW_S),
            ("20 % charge, window 1800 s", charges, 20.0, 3.0 * WINDOW_S),
            ("3.4 V", voltages, 3.4, WINDOW_S),
        ):
            yield from rows_of(f"{load} load, {what}", [judge(each, bound, window_s) for each in values])


def rows_of(what: str, judged: Sequence[Judged]) -> Iterator[Row]:
    """Yields quartiles of the errors, and of the time that is left at the alert."""
    errors = list(chain.from_iterable(each.errors for each in judged))
    unstated = sum(each.unstated for each in judged)
    twentieths = statistics.quantiles(errors, n=20)
    remark = f"nine of ten {_percent(twentieths[0])} to {_percent(twentieths[-1])} %"
    if unstated:
        remark += f"; {100.0 * unstated / (unstated + len(errors)):.0f} % without a time"
    quartiles = ", ".join(map(_percent, statistics.quantiles(errors, n=4)))
    yield Row(what, "error of time_to_bound_s", f"{quartiles} %", remark=remark)
    left_min = [each.left_s / 60.0 for each in judged]
    quartiles = ", ".join(f"{each:.0f}" for each in statistics.quantiles(left_min, n=4))
    yield Row(
        what, "time left at the alert", f"{quartiles} min", remark=f"the shortest of {CELLS}: {min(left_min):.0f} min"
    )


def _percent(share: float) -> str:
    """Returns a share in %, without the unit; never `-0`."""
    return f"{round(100.0 * share) or 0:+d}"


def judge(values: Sequence[float], bound: float, window_s: float) -> Judged:
    """Returns what a forecast says until the first value below the bound."""
    signal = {"statistic": "forecast", "window_s": window_s, "forecast_s": FORECAST_S, "for_s": 60.0}
    monitor = Monitor(load_config({"signals": {"cell": {**signal, "warn_below": bound}}}))
    reached_s = next(second for second, value in enumerate(values) if value < bound)
    errors: List[float] = []
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
    return Judged(errors, unstated, left_s)


def discharge(load: _Load) -> Discharge:
    """Returns the discharge of a full cell."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of ProgPy, about its own defaults
        from progpy.models import BatteryElectroChemEOD

        cell = BatteryElectroChemEOD()
        found = cell.simulate_to_threshold(
            lambda now_s, state=None: cell.InputContainer({"i": load(now_s)}), dt=1.0, save_freq=1.0, horizon=1e5
        )
    return Discharge(
        [100.0 * float(each["EOD"]) for each in found.event_states], [float(each["v"]) for each in found.outputs]
    )


def constant_load(chance: random.Random) -> _Load:
    """Returns a current that stays."""
    current_a = chance.uniform(*CURRENTS_A)
    return lambda now_s: current_a


def random_load(chance: random.Random) -> _Load:
    """Returns a current that changes every 30 to 300 s, as that of a robot that drives and waits."""
    changes: Dict[str, float] = {"until_s": 0.0, "current_a": 0.0}

    def current(now_s: float) -> float:
        while now_s >= changes["until_s"]:
            changes["until_s"] += chance.uniform(*LOAD_LASTS_S)
            changes["current_a"] = chance.uniform(*CURRENTS_A)
        return changes["current_a"]

    return current
