"""Simulated robots whose signals a forecast watches, for the tests of false alarms and `make bench ARGS=forecast`."""

from __future__ import annotations

import math
import random
from functools import partial
from itertools import chain, count, product, repeat
from typing import Any, Callable, Iterator, Mapping, NamedTuple

from robot_health_monitor.core import Level, Monitor, Sample, Transition, load_config
from robot_health_monitor.core.judge.forecast import ForecastWindow

WINDOW_S, FORECAST_S = 600.0, 1800.0
NOISES = tuple(product((0.5, 1.0, 3.0), (20.0, 60.0, 200.0)))
"""Standard deviation in %, and correlation time in s."""

_Values = Iterator[float]
"""One value per second."""


def false_alarms(values: _Values, seconds: int, **settings: Any) -> int:
    """Returns how often a forecast warns; the settings are keys of the signal."""
    signal = {"statistic": "forecast", "window_s": WINDOW_S, "forecast_s": FORECAST_S, "for_s": 300.0, **settings}
    return sum(each.to_level is Level.WARN for each in transitions(values, seconds, signal))


def false_alarms_of_one_line(values: _Values, seconds: int) -> int:
    """Returns how often the line through the whole window crosses the bound for `for_s`, as `predict_linear` does."""
    window = ForecastWindow(WINDOW_S, 100_000, WINDOW_S, FORECAST_S, {})

    def predictions() -> _Values:
        for second, value in enumerate(values):
            window.add(value, float(second))
            found = window.outlook()
            yield 55.0 if found is None else found.value

    signal = {"warn_below": 40.0, "for_s": 300.0}
    return sum(each.to_level is Level.WARN for each in transitions(predictions(), seconds, signal))


def lead_s(chance: random.Random) -> float:
    """Returns how long before the bound is crossed the forecast warns, in s."""
    values = add(ramp(100.0, -1.0 / 60.0), correlated(0.5, 1.0, chance))
    crossed_s = (100.0 - 20.0) * 60.0
    signal = {"statistic": "forecast", "window_s": WINDOW_S, "forecast_s": FORECAST_S, "for_s": 60.0}
    found = transitions(values, int(crossed_s), {**signal, "warn_below": 20.0})
    first_s = next((each.now_s for each in found if each.to_level is Level.WARN), crossed_s)
    return crossed_s - first_s


def transitions(values: _Values, seconds: int, signal: Mapping[str, Any]) -> Iterator[Transition]:
    """Yields the transitions of a signal with one sample per second."""
    monitor = Monitor(load_config({"signals": {"value": dict(signal)}}))
    for second, value in zip(range(seconds), values):
        yield from monitor.observe(Sample("value", value, float(second)))


class Scene(NamedTuple):
    """Something that robots do, after which no alert is due."""

    values: Callable[[], _Values]
    """Noise of 0.5, correlated over 20 s, is added."""
    settings: dict[str, float]
    """Keys of the signal."""
    seconds: int

    def false_alarms(self, chance: random.Random) -> int:
        """Returns how often a forecast warns."""
        return false_alarms(add(self.values(), correlated(0.5, 20.0, chance)), self.seconds, **self.settings)


def flat(deviation: float, correlation_s: float) -> _Values:
    """Yields 55 % with noise."""
    return add(repeat(55.0), correlated(deviation, correlation_s, random.Random(f"{deviation} {correlation_s}")))


def ramp(start: float, per_s: float, end: float = math.inf) -> _Values:
    """Yields a straight line, which stays at `end` once it is above."""
    return (min(start + per_s * second, end) for second in count())


def correlated(deviation: float, correlation_s: float, chance: random.Random) -> _Values:
    """Yields AR(1) noise."""
    kept = math.exp(-1.0 / correlation_s)
    new = deviation * math.sqrt(1.0 - kept * kept)
    value = chance.gauss(0.0, deviation)
    while True:
        yield value
        value = kept * value + chance.gauss(0.0, new)


def add(*parts: _Values) -> _Values:
    """Yields the sums of the values of each second."""
    return map(sum, zip(*parts))


def after(seconds: int, before: float, then: Callable[[], _Values]) -> _Values:
    """Yields a constant for some seconds, then others."""
    return chain(repeat(before, seconds), then())


def approach(start: float, end: float, time_s: float) -> _Values:
    """Yields an exponential approach."""
    return (end + (start - end) * math.exp(-second / time_s) for second in count())


def shift(high: float, low: float) -> _Values:
    """Yields the charge of a robot that works for 2 h and charges for 1 h."""
    return (
        high - (high - low) * (second / 7200.0 if second < 7200 else (10_800 - second) / 3600.0)
        for second in chain.from_iterable(repeat(range(10_800)))
    )


_BATTERY = {"warn_below": 20.0}
_ALMOST_EMPTY = {"warn_below": 5.0}
SCENES: dict[str, Scene] = {
    **{
        f"70 degrees approached in {time_s:g} s, bound 80, horizon {forecast_s:g} s": Scene(
            partial(after, 1800, 25.0, partial(approach, 25.0, 70.0, time_s)),
            {"warn_above": 80.0, "forecast_s": forecast_s, "window_s": max(WINDOW_S, forecast_s / 3.0)},
            1800 + 4 * int(time_s),
        )
        for time_s, forecast_s in (
            (600.0, 600.0),
            (1800.0, 900.0),
            (1800.0, 1800.0),
            (3600.0, 1800.0),
            (3600.0, 3600.0),
        )
    },
    "charging from 21 to 100 %, bound 20 %": Scene(partial(ramp, 21.0, 1.0 / 60.0, 100.0), _BATTERY, 7_200),
    "battery swapped, 10 to 100 %, bound 5 %": Scene(
        partial(after, 3600, 10.0, partial(repeat, 100.0)), _ALMOST_EMPTY, 7_200
    ),
    "battery swapped, 100 to 10 %, bound 5 %": Scene(
        partial(after, 3600, 100.0, partial(repeat, 10.0)), _ALMOST_EMPTY, 7_200
    ),
    "2 h from 95 to 55 %, 1 h on the charger, bound 20 %": Scene(partial(shift, 95.0, 55.0), _BATTERY, 43_200),
    "parked at 60 %, bound 20 %": Scene(partial(repeat, 60.0), _BATTERY, 14_400),
    "a night from 30 %, 0.2 % less per hour, bound 20 %": Scene(partial(ramp, 30.0, -0.2 / 3600.0), _BATTERY, 43_200),
}
"""What happens, and its values."""
