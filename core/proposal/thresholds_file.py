"""The text of a proposed thresholds.yaml: settings, their evidence, and what is not watched."""

from __future__ import annotations

import math
import re
from itertools import chain, groupby
from typing import Any, Iterable

from ..values import JsonObject, count_text, duration_text, list_text, number_text, printable
from .proposal import ORDER, Proposed
from .suggestion import Signal

MOST_NOT_WATCHED = 60
"""Topics that are listed as not watched; of further ones, only the number is given."""
_MOST_FIELDS = 12
"""Numbers of one topic that are listed with their ranges, and that are listed without bounds."""
_COLUMN = 36
"""Column of the comments."""


def thresholds_text(heading: Iterable[str], others: JsonObject, proposed: Proposed) -> str:
    """Returns the file: `heading` as a comment at its head, `others` as further keys of alert_system, and signals."""
    lines = [*(f"# {line}" for line in heading), "alert_system:", "  ros__parameters:"]
    lines += [f"    {key}: {yaml_text(value)}" for key, value in others.items()]
    watched = [signal for signal in proposed.signals if not signal.is_shown_only]
    lines.append("    signals:" if watched else "    signals: {}")
    fields = _fields(proposed)
    for topic, signals in groupby(proposed.signals, key=lambda signal: signal.topic):
        comments: list[str] = []
        for signal in signals:
            if signal.is_shown_only:
                comments.append(_shown_only(signal))
            else:
                lines += _signal(signal)
        lines += _at_most(comments, topic, "more of them")
        lines += fields.pop(topic, [])
    lines += chain.from_iterable(each for _, each in sorted(fields.items())[:MOST_NOT_WATCHED])
    if proposed.not_watched:
        lines.append("    # Not watched:")
        topics = sorted(proposed.not_watched.items())
        lines += [f"    #   {topic}: {reason}" for topic, reason in topics[:MOST_NOT_WATCHED]]
        if len(topics) > MOST_NOT_WATCHED:
            lines.append(f"    #   and {count_text(len(topics) - MOST_NOT_WATCHED, 'other topic')}")
    return "".join(f"{printable(line)}\n" for line in lines)


def _fields(proposed: Proposed) -> dict[str, list[str]]:
    """Returns the lines of the fields of each topic that are not watched, those with the same reason together."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for (topic, field), reason in proposed.fields.items():
        reasons.setdefault((topic, reason), []).append(field)
    lines: dict[str, list[str]] = {}
    for (topic, reason), fields in reasons.items():
        lines.setdefault(topic, []).append(f"      # {topic}, {list_text(fields, _MOST_FIELDS)}: {reason}")
    return {topic: _at_most(each, topic, "more without bounds") for topic, each in lines.items()}


def _signal(signal: Signal) -> list[str]:
    settings, measured = signal.given, signal.measured
    lines = [f"      {signal.name}:"]
    if measured.samples or not signal.note:
        invalid = f", {measured.bad_samples:,} of them invalid" if measured.bad_samples else ""
        samples = f"{count_text(measured.samples, 'sample')} in {duration_text(measured.duration_s)}{invalid}"
        lines.append(f"        # {samples}")
    if signal.note:
        lines.append(f"        # {signal.note}")
    for key in dict.fromkeys([*settings, *ORDER]):
        comments = [signal.alerts.get(key, "")]
        name, value = key, settings.get(key)
        if key in settings:
            if key in signal.seen:
                comments.append(f"suggested: {yaml_text(signal.seen[key].value)}; {signal.seen[key].evidence}")
            if any(comments):
                comments.insert(0, "given")
        elif key in signal.proposed:
            value, why = signal.proposed[key]
            comments.append(why)
        elif key in signal.seen:
            name, (value, why) = f"# {key}", signal.seen[key]
            comments.append(why)
        else:
            continue
        line = f"        {name}: {yaml_text(value)}"
        if any(comments):
            unit = "s" if key.endswith("_s") else "" if key == "depends_on" else _unit(settings)
            line = f"{line} ".ljust(_COLUMN) + "# " + "; ".join(filter(None, [unit, *comments]))
        lines.append(line)
    if not signal.settings:
        lines.insert(1, "        {}")
    return lines + [f"        # {reason}" for reason in signal.left_out]


def _shown_only(signal: Signal) -> str:
    """Returns a signal whose range was not seen for long enough, as one comment that can be made a line."""
    keys = {**signal.given, **{key: setting.value for key, setting in signal.seen.items()}}
    values, unit = signal.measured.values, _unit(signal.given)
    seen = f"seen {number_text(values.min)} to {number_text(values.max)}{f' {unit}' if unit else ''}"
    return f"      # {signal.name}: {yaml_text(keys)}  # {seen} in {duration_text(signal.measured.duration_s)}"


def _at_most(lines: list[str], topic: str, what: str) -> list[str]:
    more = len(lines) - _MOST_FIELDS
    return lines if more <= 0 else [*lines[:_MOST_FIELDS], f"      # {topic}: {more} {what}"]


def _unit(settings: JsonObject) -> str:
    return {"frequency_hz": "Hz", "largest_gap_s": "s"}.get(
        settings.get("statistic", ""), str(settings.get("unit", ""))
    )


def yaml_text(value: Any) -> str:
    """Returns a value as YAML on one line."""
    import yaml  # here, so that --help does not need PyYAML

    class Dumper(yaml.SafeDumper):
        """Writes values for the parsers of both versions of ROS."""

    Dumper.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"[yYnN]\Z"), list("yYnN"))  # as in YAML 1.1
    text: str = yaml.dump([value], Dumper=Dumper, default_flow_style=True, sort_keys=False, width=math.inf)
    return text[1:-2]
