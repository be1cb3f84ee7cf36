"""Alerting rules of Prometheus for the thresholds of a configuration, over the metrics that a monitor serves.

The rules repeat what docs/rules.md says, as far as PromQL can express it:

* Prometheus has no hysteresis. A recording rule that reads its own previous result has one: its series exists while
  the value is beyond the bound, and as long as the value is not back by the hysteresis.
* `for` and `keep_firing_for` are Prometheus's own.
* A forecast is the most cautious of three `predict_linear` of the latest value, recorded as a series.
* Staleness, invalid data and the link are the monitor's verdict, which is a metric.
* A signal has one alert per level: an ERROR of a bound and one of invalid data are the same, as in the monitor.

A rule that says more than PromQL can express gets a comment, and a line in `Export.problems`.
"""

from __future__ import annotations

import json
import re
import sys
from typing import List, Mapping, NamedTuple, Sequence

from robot_health_monitor.core.config import MonitorConfig
from robot_health_monitor.core.element_signals import config_of
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.explanation import judged_text, judged_unit
from robot_health_monitor.core.forecast import LEAST_SAMPLES
from robot_health_monitor.core.formatting import bound_text, duration_text, with_unit
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.signal_config import LINK, LINK_CONFIG, Condition, SignalConfig

from ..notifications.alertmanager import ALERT, SEVERITIES

BEYOND = "robot_health:beyond_bound"
"""Recorded series: the value of a signal while it is beyond a bound, with its hysteresis."""
_OPERATORS, _COMPARISONS = {"below": "<", "above": ">"}, {"below": "lt", "above": "gt"}
"""Those of PromQL, and those of templates."""
FORECAST = "robot_health:forecast"
"""Recorded series: the forecast of a signal, as in step 2 of docs/rules.md."""
REPORTED, SCRAPED = "robot_health:reported_at", "robot_health:scraped_at"
"""Recorded series: when a monitor last reported a robot, and when it was last scraped."""
_SINCE = "robot_health:beyond_bound_since"
_REPORTED = "reported"
"""Takes the place of the side of a bound where a driver reports its own level."""
_LARGEST = repr(sys.float_info.max)
"""Values are finite: infinity stands for invalid data. (For VictoriaMetrics, NaN is no result.)"""
_ELEMENT = r"\[.+\]"
_VALUE = "\0"
"""Stands for the value in a text that is escaped."""
_MEMORY = "1h"
"""How long Prometheus may have been stopped and still knows which robots a monitor reported that is down."""
_ROBOT = "{{ $labels.robot }}: "
_ESCAPED = re.compile(r"[^\w\x80-\U0010ffff]", re.ASCII)
_INTERVALS_S = 0.1, 120.0
"""For Prometheus, a series has ended 5 minutes after its last sample: a scrape or two may fail."""

_HEADER = """\
# Alerting rules of Robot Health Monitor for Prometheus, made by `robot-health export prometheus`.
# They need the metrics that a monitor serves at /metrics, scraped every {interval}.
# Unlike the monitor:
# - Durations are rounded up to the interval, and what happens between two scrapes is not seen.
# - WARN also fires while ERROR does. In Alertmanager, inhibit it:
#     inhibit_rules:
#       - source_matchers: [alertname="{alert}", severity="critical"]
#         target_matchers: [alertname="{alert}", severity="warning"]
#         equal: [robot, signal]
# - While a signal is stale or its robot cannot be reached, durations and conditions on other signals go on; its last
#   value counts.
# - While a robot cannot be reached, its STALE alerts resolve.{forecasts}
# A monitor that is down is an alert for each robot that it reported last. A robot that a working monitor no longer
# reports, or whose monitor is no longer a target of Prometheus, is none; alerts of its signals end after their
# keep_firing_for.
"""


class Export(NamedTuple):
    """A file for another system."""

    text: str
    problems: Sequence[str]  # what the other system cannot express, one line each


_FORECASTS = """
# - Forecasts are computed from scraped values, at the time of evaluation, not at that of the newest sample. A scrape
#   repeats the latest value if no sample came since. While there is none, the forecast goes on until half of the window
#   has fewer than {least} values; after that it does not wait for window_min_s again.
# - Prometheus 3 leaves the beginning of a range out: there, a value exactly in the middle of a window is in one half.\
"""


def export_rules(config: MonitorConfig, *, robots: Sequence[str] = (), interval_s: float = 15.0) -> Export:
    """Returns a rule file for Prometheus, in YAML, for robots of these names (empty: all).

    Scrapes and evaluations are `interval_s` apart, in s.
    """
    require_interval(interval_s)
    has_forecasts = any(signal.statistic == "forecast" for signal in config.signals.values())
    forecasts = _FORECASTS.format(least=LEAST_SAMPLES) if has_forecasts else ""
    header = _HEADER.format(interval=duration(interval_s), alert=ALERT, forecasts=forecasts)
    lines: List[str] = header.splitlines()
    problems: List[str] = []
    name = "robot_health" + "".join(f" {name}" for name in robots)
    lines += ["groups:", *rule_groups(name, config, robots, interval_s, problems)]
    lines += _monitor_rules(robots, interval_s)
    return Export("\n".join(lines) + "\n", problems)


def rule_groups(
    name: str, config: MonitorConfig, robots: Sequence[str], interval_s: float, problems: List[str]
) -> List[str]:
    """Returns the lines of a group for each signal, and of one for the link; appends to `problems`.

    Groups are evaluated at the same time, on all cores, and rules in a group one after the other.
    """
    lines: List[str] = []
    for signal in config.signals.values():
        if signal.name != LINK:
            lines += group_head(f"{name} {signal.name}", interval_s)
            lines += [*_Rules(config, signal, robots, interval_s, problems).lines(), ""]
    return [*lines, *group_head(name, interval_s), *_link_rule(robots)]


def group_head(name: str, interval_s: float) -> List[str]:
    """Returns the first lines of a group of rules, which are evaluated every `interval_s`."""
    return [f"  - name: {quoted(name)}", f"    interval: {duration(interval_s)}", "    rules:"]


def signal_matcher(signal: SignalConfig, *, with_template: bool = False) -> str:
    """Returns the matcher of the label `signal`: of one signal, or of the elements of a template."""
    if not signal.is_template:
        return f"signal={quoted(signal.name)}"
    return f"signal=~{quoted(signal.name + (f'({_ELEMENT})?' if with_template else _ELEMENT))}"


class _Rules:
    """The rules of one signal."""

    def __init__(
        self,
        config: MonitorConfig,
        signal: SignalConfig,
        robots: Sequence[str],
        interval_s: float,
        problems: List[str],
    ) -> None:
        self._config = config
        self._signal = signal
        self._robots = robots
        self._problems = problems
        # `promtool check rules` reports rules with the same labels as written. Those of elements are in their series.
        self._label = f"{{{{/* {signal.name} */}}}}{{{{ $labels.signal }}}}" if signal.is_template else signal.name
        self._recorded = f"{'template' if signal.is_template else 'signal'}: {quoted(signal.name)}"
        self._unit = _escaped(judged_unit(signal))
        is_forecast = signal.statistic == "forecast" and bool(signal.bounds)
        self._has_scrapes = signal.window_s / 2.0 >= LEAST_SAMPLES * interval_s
        """Whether each half of the window has enough scrapes to forecast from."""
        self._forecasts = is_forecast and self._has_scrapes

    def lines(self) -> List[str]:
        signal = self._signal
        lines = ["", f"      # {signal.name}"]
        if self._forecasts:
            lines += self._forecast_rule()
        for level in ("ERROR", "WARN"):
            found = {side: getattr(signal, f"{level.lower()}_{side}") for side in _OPERATORS}
            bounds = {side: bound for side, bound in found.items() if bound is not None}
            if signal.is_status:
                bounds = {_REPORTED: float(Level[level])}
            for side, bound in bounds.items():
                lines += self._beyond_rule(level, side, bound)
            if bounds:
                lines += self._comments(level)
            if level == "ERROR":
                lines += self._error(bounds)
            elif bounds:
                times = signal.for_s, signal.keep_firing_for_s
                lines += alert(self._label, level, self._crossed(level, bounds), self._reason(bounds), *times)
        return lines + (self._stale() if signal.stale_after_s > 0.0 or signal.is_status else [])

    def _metric(
        self, metric: str, aggregation: str = "max", signal: str = "", over: str = "", condition: str = ""
    ) -> str:
        """Returns a metric of a signal, one series per robot: several monitors may watch one robot."""
        own = signal_matcher(self._signal, with_template=metric not in ("value", "latest"))
        selected = f"robot_health_{metric}" + selector(self._robots, f"signal={quoted(signal)}" if signal else own)
        return (
            f"{aggregation} by (robot, signal) ({f'max_over_time({selected}{over})' if over else selected}{condition})"
        )

    def _beyond_rule(self, level: str, side: str, bound: float) -> List[str]:
        if side == _REPORTED:  # WARN also while a worse level is reported, as for bounds
            value = self._metric("value", condition=" == 2" if level == "ERROR" else " >= 1")
            return record(BEYOND, value, f"{self._recorded}, level: {level}, side: {side}")
        operator = _OPERATORS[side]
        expression = self._judged(side, f" {operator} {_number(bound)}")
        if self._signal.hysteresis:
            clears_at = _number(self._clears_at(side, bound))
            before = self._beyond(level, f', side="{side}"')
            held = self._judged(side, f" {operator} {clears_at}")
            expression += f"\nor ({held} and on (robot, signal) {before})"
        return record(BEYOND, expression, f"{self._recorded}, level: {level}, side: {side}")

    def _judged(self, side: str, condition: str) -> str:
        """Returns where the statistic that the bounds of a side apply to fulfils a condition.

        Of several monitors, the worst counts. What does not fulfil it is dropped first, which is cheaper.
        """
        if self._forecasts:
            return FORECAST + selector(self._robots, signal_matcher(self._signal)) + condition
        return self._metric("value", "min" if side == "below" else "max", condition=condition)

    def _forecast_rule(self) -> List[str]:
        """Returns the rule that records the forecast. Prometheus predicts from the evaluation, also with `offset`."""
        signal = self._signal
        latest = "robot_health_latest" + selector(self._robots, signal_matcher(self._signal))
        half, horizon = duration(signal.window_s / 2.0), _number(signal.forecast_s or 0.0)
        newer, older = f"{latest}[{half}]", f"{latest}[{half}] offset {half}"
        ranges = {"window": f"{latest}[{duration(signal.window_s)}]", "older half": older, "newer half": newer}
        lines = "\n    or ".join(
            f'label_replace(predict_linear({found}, {horizon}), "line", "{name}", "", "")'
            for name, found in ranges.items()
        )
        is_below = any(name.endswith("below") for name in signal.bounds)
        worst, most_cautious = ("min", "max") if is_below else ("max", "min")
        expression = f"{worst} by (robot, signal) (\n  {most_cautious} without (line) (\n    {lines}\n  )"
        expression += "".join(f"\n  and count_over_time({found}) >= {LEAST_SAMPLES}" for found in (older, newer))
        if signal.window_min_s:
            expression += f"\n  and {latest} offset {duration(signal.window_min_s)}"
        return record(FORECAST, expression + "\n)", self._recorded)

    def _beyond(self, level: str, further: str = "") -> str:
        return BEYOND + selector(self._robots, f'{signal_matcher(self._signal)}, level="{level}"{further}')

    def _comments(self, level: str) -> List[str]:
        """Reports what the rule of a level cannot express."""
        signal = self._signal
        lost = []
        if signal.latch:
            lost.append("latch: the alert ends when the rule no longer fires")
        if signal.flap_detection:
            lost.append("flap_detection: every change is an alert")
        if signal.repeat_s > 0.0:
            lost.append("repeat_s: set repeat_interval in Alertmanager")
        if signal.statistic != "last":
            lost.append(f"an undefined {signal.statistic}: the alert ends when the window has too few samples")
        if signal.is_status:
            lost.append("the driver's message, which is no metric")
        if signal.statistic == "forecast" and not self._has_scrapes:
            lost.append(f"a forecast from fewer than {LEAST_SAMPLES} scrapes in half of window_s: the monitor's counts")
        self._problems += [f"{signal.name} {level}: not expressed: {each}" for each in lost]
        return [f"      # Not expressed: {each}." for each in lost]

    def _crossed(self, level: str, bounds: Mapping[str, float]) -> str:
        """Returns an expression for: a bound of a level is crossed, and the condition holds."""
        condition = self._signal.only_if
        aggregation = "min" if [*bounds] == ["below"] else "max"
        expression = f"{aggregation} by (robot, signal) ({self._beyond(level)})"
        if condition is not None:
            expression += f"\nunless on (robot) ({self._contradiction(condition)})"
        return expression

    def _error(self, bounds: Mapping[str, float]) -> List[str]:
        """Returns the rule of ERROR: a bound is crossed, or data are invalid (NaN). `for` is the shorter duration."""
        signal = self._signal
        for_s, keep_s = (signal.error_for_s, signal.error_keep_firing_for_s) if bounds else (signal.invalid_for_s, 0.0)
        shorter_s = min(for_s, signal.invalid_for_s)
        valid, further_s = self._metric("data_valid"), signal.invalid_for_s - shorter_s
        invalid = f"{valid} == 0"
        if further_s:
            lately = self._metric("data_valid", over=f"[{duration(further_s)}]")
            invalid = f"{lately} == 0 and {valid[:-1]} offset {duration(further_s)}) == 0"
        if not bounds:
            return alert(self._label, "ERROR", invalid, "invalid data", shorter_s, keep_s)
        crossed, lines = self._crossed("ERROR", bounds), []
        if for_s > shorter_s:
            since = _SINCE + selector(self._robots, signal_matcher(self._signal))
            began = f"{since} or on (robot, signal) time() + 0 * (\n{crossed}\n)"
            expression = f"(\n{began}\n)\nand on (robot, signal) (\n{crossed}\n)"
            lines = record(_SINCE, expression, self._recorded)
            firing = f'{signal_matcher(self._signal)}, level="ERROR", alertname="{ALERT}", alertstate="firing"'
            lasted = f"time() - {since} >= {_number(for_s - shorter_s)} or ALERTS{selector(self._robots, firing)}"
            crossed = f"({crossed})\nand on (robot, signal) ({lasted})"
        expression = f"({invalid}) + Inf\nor on (robot, signal) ({crossed})"
        reason = f"{{{{ if gt $value {_LARGEST} }}}}invalid data{{{{ else }}}}{self._reason(bounds)}{{{{ end }}}}"
        return [*lines, *alert(self._label, "ERROR", expression, reason, shorter_s, keep_s)]

    def _contradiction(self, condition: Condition) -> str:
        """Returns an expression for: the other signal is known, and the condition on it does not hold."""
        other, number = condition.signal, _number(condition.number)
        followed = config_of(other, self._config.signals)
        value = self._metric("value" if followed is None or followed.statistic == "last" else "latest", signal=other)
        if condition.comparison in _OPERATORS:
            fails = f"{value} {'>=' if condition.comparison == 'below' else '<='} {number}"
        elif condition.comparison == "between":
            low, high = (
                _number(end - side * abs(end) * 1e-6) for end, side in ((condition.number, 1), (condition.upper, -1))
            )
            fails = f"({value} < {low} or {value} > {high})"
        else:
            close = _number(abs(condition.number) * 1e-6)
            fails = f"abs({value} - {number}) {'>' if condition.comparison == 'is' else '<='} {close}"
        known = f"{self._metric('level', signal=other)} != 3 and {self._metric('data_valid', signal=other)} == 1"
        return f"{fails} and {known}"

    def _reason(self, bounds: Mapping[str, float]) -> str:
        """Returns the template of the reason, worded as in the line of the monitor's alert."""
        signal = self._signal
        if _REPORTED in bounds:
            return "reported as {{ if eq $value 2.0 }}error{{ else if eq $value 3.0 }}stale{{ else }}warn{{ end }}"
        value = _escaped(judged_text(signal, _VALUE)).replace(_VALUE, '{{ $value | printf "%.4g" }}')
        named = {side: f"{side} {with_unit(bound_text(bound), self._unit)}" for side, bound in bounds.items()}
        if len(bounds) == 1 and not signal.hysteresis:
            return f"{value} is {''.join(named.values())}"
        # A template compares a floating-point number only with another one, so 20 is written as 20.0.
        cases = "else ".join(
            f"if {_COMPARISONS[side]} $value {float(bound)!r} }}}}is {named[side]}{{{{ "
            for side, bound in bounds.items()
        )
        clearing = (bound_text(self._clears_at(side, bound)) for side, bound in bounds.items())
        clears = " or ".join(with_unit(bound, self._unit) for bound in clearing)
        return f"{value} {{{{ {cases}else }}}}was {' or '.join(named.values())}, clears at {clears}{{{{ end }}}}"

    def _clears_at(self, side: str, bound: float) -> float:
        return bound + self._signal.hysteresis if side == "below" else bound - self._signal.hysteresis

    def _stale(self) -> List[str]:
        signal = self._signal
        own = selector(self._robots, signal_matcher(signal, with_template=True))
        level, longer_than_grace = f"robot_health_level{own}", duration(signal.startup_grace_s + 0.001)
        expression = (
            "max by (robot, signal) (\n"
            f"  {level} == 3\n"
            f"  and on (robot, signal) (\n"
            f"    robot_health_samples_total{own} > 0\n"
            f"    or on (robot, signal) {level} offset {longer_than_grace} == 3\n"
            "  )\n"
            f"  unless on (robot) robot_health_link_up{selector(self._robots)} == 0\n"
            ")"
        )
        reason = f"no sample (limit {duration_text(signal.stale_after_s)})" if signal.stale_after_s > 0.0 else ""
        reported = "reported as stale" if signal.is_status else ""
        return alert(self._label, "STALE", expression, " or ".join(filter(None, (reported, reason))))


def _link_rule(robots: Sequence[str]) -> List[str]:
    # Not `keep_firing_for`: a robot that is no longer watched has no link, so its alert ends at once.
    link = f"robot_health_link_up{selector(robots)}"
    lately = f"min_over_time({link}[{duration(LINK_CONFIG.keep_firing_for_s)}])"
    expression = f"max by (robot) ({link}) == 0\nor (max by (robot) ({lately}) == 0 and on (robot) {link})"
    comment = "      # The link to a robot; while it is down, its other alerts stay as they are."
    return ["", comment, *alert(LINK, "ERROR", expression, "down")]


def _monitor_rules(robots: Sequence[str], interval_s: float) -> List[str]:
    """Returns the rules for a monitor that is down or does not work: an alert for each robot that it reported last."""
    matchers = selector(robots)
    ticked = "robot_health_last_tick_timestamp_seconds"
    limit_s = max(30.0, 4.0 * interval_s)
    reported = (
        f"max by (job, instance, robot) (time() + 0 * robot_health_level{matchers})\n"
        "or (\n"
        f"last_over_time({REPORTED}{matchers}[{_MEMORY}])\n"
        f"> on (job, instance) group_left last_over_time({SCRAPED}[{_MEMORY}]) - {_number(interval_s)}\n"
        "and on (job, instance) up == 0\n"
        ")"
    )
    expression = (
        f"max by (robot) ({REPORTED}{matchers})\n"
        f"unless max by (robot) (\n"
        f"  robot_health_level{matchers} and on (job, instance) (time() - {ticked} <= {_number(limit_s)})\n"
        ")"
    )
    return [
        "", "      # The monitor of a robot does not work, or cannot be scraped.",
        *record(SCRAPED, f"max by (job, instance) (time() + 0 * {ticked})"),
        *record(REPORTED, reported),
        *alert("monitor", "ERROR", expression, "does not run", for_s=2.0 * interval_s),
    ]  # fmt: skip


def record(name: str, expression: str, labels: str = "") -> List[str]:
    """Returns the lines of a rule that records a series."""
    return ["", f"      - record: {name}", *([f"        labels: {{{labels}}}"] if labels else []), *_expr(expression)]


def alert(
    signal: str, level: str, expression: str, reason: str, for_s: float = 0.0, keep_firing_for_s: float = 0.0
) -> List[str]:
    """Returns the lines of a rule that raises an alert."""
    times = {"for": for_s, "keep_firing_for": keep_firing_for_s}
    summary = quoted(f"{_ROBOT}{signal} {level}: {reason}")
    return [
        "", f"      - alert: {ALERT}", *_expr(expression),
        *(f"        {key}: {duration(time_s)}" for key, time_s in times.items() if time_s > 0.0),
        f"        labels: {{signal: {quoted(signal)}, level: {level}, severity: {SEVERITIES[Level[level]]}}}",
        f"        annotations: {{summary: {summary}}}",
    ]  # fmt: skip


def _escaped(text: str) -> str:
    return text.replace("{{", '{{ "{{" }}')  # a template reads `{{` as an action


def _expr(expression: str) -> List[str]:
    return ["        expr: |-", *(f"          {line}" for line in expression.splitlines())]


def selector(robots: Sequence[str], further: str = "") -> str:
    """Returns the matchers of these robots, in braces; without any, nothing."""
    matchers = [further] if further else []
    if len(robots) == 1:
        matchers.insert(0, f"robot={quoted(robots[0])}")
    elif robots:
        # Names match as they are. RE2 lets ASCII be escaped, and no other character.
        pattern = "|".join(_ESCAPED.sub(r"\\\g<0>", name) for name in robots)
        matchers.insert(0, f"robot=~{quoted(pattern)}")
    return f"{{{', '.join(matchers)}}}" if matchers else ""


def quoted(text: str) -> str:
    """Returns a string of PromQL, which is one of YAML too: unquoted, `on` and `null` are no texts there."""
    return json.dumps(text, ensure_ascii=False)


def require_interval(interval_s: float) -> None:
    """ConfigError: Prometheus cannot evaluate the rules at this interval."""
    least_s, most_s = _INTERVALS_S
    if not least_s <= interval_s <= most_s:
        raise ConfigError(f"expected an interval from {least_s:g} to {most_s:g} s, got {interval_s:g} s")


def duration(seconds: float) -> str:
    """Returns a duration as Prometheus reads it; it resolves milliseconds."""
    whole, milliseconds = divmod(round(seconds * 1000.0), 1000)
    return f"{f'{whole}s' if whole or not milliseconds else ''}{f'{milliseconds}ms' if milliseconds else ''}"


def _number(value: float) -> str:
    """Returns a number that PromQL reads without loss."""
    return repr(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)
