"""`robot-health sources`: what this machine offers to battery_sensor, with the values it has now."""

from __future__ import annotations

import json
import shutil
import sys
import time
from typing import Any, Dict, List, NamedTuple, Optional, TextIO

from robot_health_monitor.core.formatting import number_text, with_unit
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES, HostSource
from robot_health_monitor.core.sensors.source import NotYet, SensorError, Source

_BETWEEN_READS_S = 0.5
"""Loads and rates are measured from one read to the next."""


class Offer(NamedTuple):
    """One source of this machine."""

    kind: str
    """What `source` is in the configuration."""
    options: Dict[str, Any]
    """The other keys of the configuration."""
    value: Optional[float]
    """What it reads now, in the unit; None: nothing."""
    problem: str
    """Why it reads nothing, empty when it reads something."""

    @property
    def configuration(self) -> str:
        """What to write below `host`, after the name of the metric."""
        # JSON's texts are YAML's, and never read as numbers or flags
        options = [f"{name}: {json.dumps(value, ensure_ascii=False)}" for name, value in self.options.items()]
        return "{" + ", ".join([f"source: {self.kind}", *options]) + "}"

    @property
    def value_text(self) -> str:
        """The value with its unit, or a dash."""
        return "-" if self.value is None else with_unit(number_text(self.value), HOST_SOURCES[self.kind].unit)


def show_sources(as_json: bool, stream: Optional[TextIO] = None) -> None:
    """Writes every source of this machine: a table on a terminal, plain lines in a pipe, or JSON.

    Args:
        as_json: one JSON object per source and line.
        stream: where to; None: stdout.
    """
    stream = stream or sys.stdout
    offers = read_offers()
    if as_json:
        lines = [_json_line(offer) for offer in offers]
    elif stream.isatty():
        lines = _table(offers, shutil.get_terminal_size().columns)
    else:
        lines = [f"{offer.configuration}: {offer.problem or offer.value_text}" for offer in offers]
    stream.write("\n".join(lines) + "\n")
    stream.flush()


def read_offers() -> List[Offer]:
    """Reads everything that this machine offers; takes half a second."""
    made = [
        (kind, options, host_source.make(**options))
        for kind, host_source in HOST_SOURCES.items()
        for options in _options(host_source)
    ]
    if [kind for kind, _, source in made if _is_not_yet(source)]:  # every one of them is read
        time.sleep(_BETWEEN_READS_S)
    return [_read(kind, options, source) for kind, options, source in made]


def _options(host_source: HostSource) -> List[Dict[str, Any]]:
    """Returns the options to show: those of this machine; where there are none, the default, which says why."""
    option = host_source.option
    if option is None:
        return [{}]
    try:
        offered = list(host_source.offered())
    except SensorError:
        offered = []
    return [{option.name: value} for value in offered or [option.default]]


def _is_not_yet(source: Source) -> bool:
    try:
        source.read(time.monotonic())
    except NotYet:
        return True
    except SensorError:
        pass  # the next read will say so
    return False


def _read(kind: str, options: Dict[str, Any], source: Source) -> Offer:
    shown = {name: value for name, value in options.items() if value not in (None, "")}
    try:
        return Offer(kind, shown, source.read(time.monotonic()), "")
    except SensorError as error:
        problem, _, _ = str(error).partition("; ")  # without what would help battery_sensor
        return Offer(kind, shown, None, problem)


def _table(offers: List[Offer], columns: int) -> List[str]:
    rows = [("below `host: <name>:`", "now", "what it is")]
    rows += [
        (offer.configuration, offer.value_text, offer.problem or HOST_SOURCES[offer.kind].description)
        for offer in offers
    ]
    first, second = (max(len(row[column]) for row in rows) for column in (0, 1))
    return [f"{left:<{first}}  {middle:>{second}}  {right}"[: max(columns, 20)] for left, middle, right in rows]


def _json_line(offer: Offer) -> str:
    unit = HOST_SOURCES[offer.kind].unit
    return json.dumps(
        {"source": offer.kind, **offer.options, "value": offer.value, "unit": unit, "problem": offer.problem or None}
    )
