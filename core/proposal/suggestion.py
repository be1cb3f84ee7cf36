"""Settings of a signal from what was measured of it on a healthy robot, each with its evidence.

docs/statistics.md explains the rules. Whether the settings would have raised alerts is not computed here: recordings
are replayed with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from typing import Any, Mapping, NamedTuple

from ..config import BOUNDS, SignalConfig
from ..values import bound_text, count_text, duration_text
from .measured import Measured
from .quantiles import Quantiles

LEAST_RANGE_S = 600.0  # time of samples, in s, below which a range is no bound: it is shown as a comment
RATE_MARGIN, SHORT_RATE_MARGIN = 0.2, 0.3
"""Margin of a rate, as a fraction; the second one if it was seen for less than `SHORT_S`."""
SHORT_S = 300.0
MOST_IRREGULAR = 0.07  # largest `Measured.irregularity` of a topic that is periodic
LEAST_MESSAGES = 20  # messages below which no rate is suggested
LEAST_GAPS = 10  # gaps between samples below which no `stale_after_s` is suggested
TAIL = 0.001  # fraction of the samples beyond the quantile from which a bound is derived
MARGIN = 0.1  # distance of a bound from its quantile, as a fraction of the spread between both quantiles
LEAST_MARGIN = 0.01
"""Smallest margin, as a fraction of the quantiles: other robots of the type differ by more than the noise of one."""
LONGEST_EXCURSION_S = 60.0
"""Values beyond a bound for longer than this, in s, are no short excursion: the bound is set from the extreme."""

_TINY, _HUGE = 1e-200, 1e200  # nothing is computed from margins and noise outside of this range: doubles would overflow

_LOWEST = {"%": 0.0, "K": 0.0, "Hz": 0.0, "degC": -273.15}
_HIGHEST = {"%": 100.0}


class Rules(NamedTuple):
    """Settings of a signal that do not depend on what was seen."""

    why: str
    """Where they come from."""
    settings: Mapping[str, float]


class Setting(NamedTuple):
    """One proposed key of a signal."""

    value: Any  # a number; of `depends_on` names
    evidence: str  # why, in one line


@dataclass
class Signal:
    """One signal, from the topic that can have it to the settings that are proposed: filled in step by step."""

    name: str
    topic: str
    """The absolute name of its topic; of the graph such as `node /lidar`."""
    kind: str
    """What it is measured by: `rate`, `age`, `statuses`, `action`, `log`, `frames`, `elements`, `number`,
    `node`; `given` was configured before, and stays."""
    given: dict[str, Any]
    """Settings that say what it is; all settings of one that was configured before."""
    rules: Rules | None = None
    measured: Measured = field(default_factory=Measured)
    proposed: dict[str, Setting] = field(default_factory=dict)
    """The proposed keys of thresholds.yaml."""
    seen: dict[str, Setting] = field(default_factory=dict)
    """Keys that are comments, such as those of a range that was not seen for long enough."""
    left_out: list[str] = field(default_factory=list)
    """One line for each key that the data cannot justify."""
    note: str = ""
    alerts: Mapping[str, str] = field(default_factory=dict)
    """How often keys alerted in a replay: `0 alerts`; empty for one that raises none."""

    @property
    def settings(self) -> dict[str, Any]:
        """All settings."""
        return {**self.given, **{key: setting.value for key, setting in self.proposed.items()}}

    @property
    def has_bounds(self) -> bool:
        """Whether a bound is proposed."""
        return any(key in self.proposed for key in BOUNDS)

    @property
    def is_shown_only(self) -> bool:
        """Whether it is no more than a comment: its range was not seen for long enough."""
        return bool(self.seen) and not self.has_bounds and self.kind not in ("given", "action")

    def copy(self, **changes: Any) -> Signal:
        """Returns it as it was before anything was proposed."""
        fresh: dict[str, Any] = {"given": dict(self.given), "proposed": {}, "seen": {}, "left_out": []}
        return replace(self, **{**fresh, **changes})


def suggest(signal: Signal, longest_excursion_s: float = 0.0) -> None:
    """Derives the settings of a signal.

    `longest_excursion_s` is the longest time for which a healthy value was beyond a bound that this function suggested
    before; 0 if there was none, or that is not known yet. Rules replace bounds that follow from what was seen.
    """
    if signal.measured.config.statistic == "frequency_hz":
        _add_rate_bounds(signal)
    elif signal.rules is not None:
        _add_rules(signal, signal.rules)
    else:
        _add_range(signal, longest_excursion_s)
    is_known = signal.measured.config.statistic == "count"  # without samples
    if not is_known and (signal.rules is None or signal.measured.values.count):
        signal.proposed["stale_after_s"] = staleness(signal.measured.gaps)


def _add_range(signal: Signal, longest_excursion_s: float) -> None:
    measured = signal.measured
    reason = measured.unsuitable()
    if reason:
        signal.left_out.append(f"no bounds: {reason}")
        return
    from_extreme = longest_excursion_s > LONGEST_EXCURSION_S
    _add_bounds(signal, from_extreme)
    if measured.config.statistic == "count":
        signal.proposed.pop("warn_below", None)  # it is measured where it rises: how far it falls is not seen
    if not signal.proposed:
        return
    _add_hysteresis(signal)
    if longest_excursion_s and not from_extreme:
        for_s = rounded(1.5 * max(longest_excursion_s, 0.001), ROUND_CEILING)
        evidence = f"longest healthy excursion beyond a bound {duration_text(longest_excursion_s)}"
        signal.proposed["for_s"] = Setting(for_s, evidence)
    if measured.duration_s < LEAST_RANGE_S * 0.999:
        signal.seen, signal.proposed = signal.proposed, {}
        expected = f"expected at least {duration_text(LEAST_RANGE_S)}"
        signal.left_out.append(f"the range was seen for {duration_text(measured.duration_s)} only, {expected}")


def _add_rate_bounds(signal: Signal) -> None:
    measured = signal.measured
    lasted = duration_text(measured.duration_s)
    if measured.samples < LEAST_MESSAGES or not measured.mean_rate_hz > 0.0:
        seen = f"only {count_text(measured.samples, 'message')} in {lasted}"
        signal.left_out.append(f"no bounds: {seen}: a rate needs {LEAST_MESSAGES}")
        return
    if not measured.irregularity < MOST_IRREGULAR:
        gaps = f"{duration_text(measured.gaps.min)} to {duration_text(measured.gaps.max)}"
        signal.left_out.append(f"not periodic: {measured.samples:,} messages in {lasted}, {gaps} apart")
        return
    values = measured.values
    known = values.count > 0 and values.min > 0.0
    lowest, highest = (values.min, values.max) if known else (measured.mean_rate_hz, measured.mean_rate_hz)
    is_short = measured.duration_s < SHORT_S * 0.999
    margin = SHORT_RATE_MARGIN if is_short else RATE_MARGIN
    seen = f", seen for {lasted} only" if is_short else ""
    why = f"margin {margin * 100.0:.0f} %{seen}"
    low = rounded(lowest * (1.0 - margin), ROUND_FLOOR)
    high = rounded(highest * (1.0 + margin), ROUND_CEILING)
    signal.proposed["warn_below"] = Setting(low, f"lowest {measured.text(lowest)}; {why}")
    signal.proposed["warn_above"] = Setting(high, f"highest {measured.text(highest)}; {why}")


def _add_rules(signal: Signal, rules: Rules) -> None:
    """Adds the settings that are rules; bounds that a healthy robot was beyond are only shown."""
    measured, values = signal.measured, signal.measured.values
    if not values.count:
        signal.left_out.append(f"not measured: {count_text(measured.samples, 'sample')}, none valid")
        return
    spread = f"seen {measured.text(values.min)} to {measured.text(values.max)}"
    for key, value in rules.settings.items():
        beyond = values.min <= value if key.endswith("below") else values.max >= value
        chosen = signal.seen if beyond and key in BOUNDS else signal.proposed
        chosen[key] = Setting(value, f"rule: {rules.why}" + (f"; {spread}" if key in BOUNDS else ""))
    if not signal.has_bounds:
        signal.proposed = {}
        signal.left_out.append(f"no bounds: {spread}")


def _add_bounds(signal: Signal, from_extreme: bool) -> None:
    """Adds bounds from the quantiles, or the extremes; neither is a single value, which may be an error of a sensor."""
    measured = signal.measured
    values, config = measured.values, measured.config
    one = 1.0 / values.count
    tail = max(TAIL, one)
    low, high = values.quantile(tail + one / 2.0), values.quantile(1.0 - tail - one / 2.0)
    noise = measured.steps.quantile(0.95) if measured.steps.count else 0.0
    margin = max(MARGIN * (high - low), noise, LEAST_MARGIN * max(abs(low), abs(high)))
    if from_extreme:
        tail = one
        low, high = values.quantile(1.5 * one), values.quantile(1.0 - 1.5 * one)
    if not _TINY < margin < _HUGE:
        spread = f"from {measured.text(values.min)} to {measured.text(values.max)}"
        signal.left_out.append(f"no bounds: the values are {spread}, nearly all of them about {measured.text(low)}")
        return
    step = Decimal(1).scaleb(Decimal(margin).adjusted())
    lowest, highest = _limits(config, values.min)
    for key, quantile, to_bound, rounding, extreme, most, within in (
        ("warn_below", low, -margin, ROUND_FLOOR, "lowest", values.min, f"above {bound_text(lowest)}"),
        ("warn_above", high, margin, ROUND_CEILING, "highest", values.max, f"below {bound_text(highest)}"),
    ):
        bound = float(Decimal(quantile + to_bound).quantize(step, rounding))
        if not lowest < bound < highest:
            signal.left_out.append(f"no {key}: {bound_text(bound)} is not {within}, the limit of its values")
            continue
        evidence = f"{extreme} {measured.text(most)}"
        if quantile != most:
            side = key.partition("_")[2]
            evidence = f"{tail * 100.0:.2g} % of the samples are {side} {measured.text(quantile)}, {evidence}"
        signal.proposed[key] = Setting(bound, f"{evidence}; margin {measured.text(margin)}")


def _limits(config: SignalConfig, lowest_value: float) -> tuple[float, float]:
    """Returns what no value of a signal can be beyond; those of one that was never negative stay so."""
    low = (-math.inf, config.valid_min, _LOWEST.get(config.unit), 0.0 if lowest_value >= 0.0 else None)
    high = (math.inf, config.valid_max, _HIGHEST.get(config.unit))
    return max(each for each in low if each is not None), min(each for each in high if each is not None)


def _add_hysteresis(signal: Signal) -> None:
    """Adds the hysteresis, if the signal has noise; an alert must be able to clear at a healthy value."""
    measured = signal.measured
    noise = measured.steps.quantile(0.95)
    median = measured.values.quantile(0.5)
    room = min(abs(bound.value - median) for bound in signal.proposed.values())
    evidence = f"95 % of the steps between samples are at most {measured.text(noise)}"
    hysteresis = rounded(noise, ROUND_CEILING)
    if hysteresis > room / 2.0:
        hysteresis = rounded(room / 2.0, ROUND_FLOOR)
        evidence += "; at most half of the distance from a bound to the median"
    if hysteresis > 0.0:
        signal.proposed["hysteresis"] = Setting(hysteresis, evidence)


def staleness(gaps: Quantiles, least_s: float = 1.0) -> Setting:
    """Returns the `stale_after_s` of a signal from the times between its samples, at least `least_s`."""
    if gaps.count < LEAST_GAPS:
        few = f"{count_text(gaps.count, 'gap')} between samples, expected at least {LEAST_GAPS}"
        return Setting(0.0, f"0: never; {few}")
    median = gaps.quantile(0.5)
    stale_s = max(least_s, rounded(max(2.0 * gaps.max, 5.0 * median), ROUND_CEILING))
    return Setting(stale_s, f"longest gap {duration_text(gaps.max)}, median {duration_text(median)}")


def rounded(value: float, rounding: str) -> float:
    """Rounds to two digits, by `ROUND_CEILING` 0.123 to 0.13; what is too small or too large is 0."""
    if not _TINY < value < _HUGE:
        return 0.0
    return float(Context(prec=2, rounding=rounding).create_decimal(f"{value:.5g}"))
