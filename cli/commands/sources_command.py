"""`robot-health sources`: the metrics of this machine that battery_sensor can publish."""

from __future__ import annotations

import argparse
import json
import sys
import time
from functools import partial
from typing import Any, Callable, TextIO

from ...core.proposal.thresholds_file import yaml_text
from ...core.sensors.catalogue import HOST_SOURCES
from ...core.sensors.computer import Computer
from ...core.sensors.source import SensorError, Source
from ...core.values import number_text, printable, with_unit
from ...runtime.interrupts import Interrupts
from ...runtime.threads import DetachedCalls
from ..arguments import Parser, add
from ..output.lines import readable

_BETWEEN_READS_S = 0.5
"""Loads and rates are measured between two reads."""
_PATIENCE_S = 1.0
"""What has not answered by then hangs."""


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Lists every source for the section `host` of battery_sensor: its configuration, its present "
        "value, or why it is not available."
    )
    add(parser, "--json", "one JSON object per source")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Lists the sources."""
    show_sources(arguments.json)


def show_sources(as_json: bool, stream: TextIO | None = None, computer: Computer | None = None) -> None:
    """Lists every source of this machine, on a line each, or as JSON.

    Takes half a second, and one more for each thing that does not answer.
    """
    stream = stream or sys.stdout
    computer = computer or Computer(background=DetachedCalls("sources", 200, _PATIENCE_S))
    made: list[tuple[dict[str, Any], str, Source]] = []
    for kind, source in HOST_SOURCES.items():
        # A driver may be asked for the list of names, too, and hang.
        listed = _answer(partial(computer.ask, every_s=0.0, subject=kind, function=source.names), 0.0)
        names = [] if isinstance(listed, SensorError) else listed
        # Without any available here, the example, whose error gives the reason.
        for options in [{source.options[0].name: name} for name in names] or [dict(source.example)]:
            shown = {name: value for name, value in options.items() if value not in (None, "")}
            made.append(({"source": kind, **shown}, source.unit, source.make(computer, **options)))
    begin_s = time.monotonic()
    for _, _, each in made:
        _answer(each.read, begin_s)
    time.sleep(_BETWEEN_READS_S)
    now_s = time.monotonic()
    for configuration, unit, each in made:
        answer = _answer(each.read, now_s)
        record = {**configuration, "value": answer, "unit": unit, "problem": None}
        if isinstance(answer, SensorError):
            text = str(answer).partition("; ")[0]  # without the advice for battery_sensor
            record.update(value=None, problem=text)
        else:
            text = readable(with_unit(number_text(answer), unit), stream)
        line = json.dumps(record) if as_json else f"{yaml_text(configuration)}: {text}"
        stream.write(f"{printable(line)}\n")
    stream.flush()


def _answer(ask: Callable[[float], Any], now_s: float) -> Any:
    """Returns what a function answers, or its SensorError."""
    try:
        return ask(now_s)
    except SensorError as error:
        return error
