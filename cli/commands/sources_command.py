"""`robot-health sources`: the metrics of this machine that battery_sensor can publish."""

from __future__ import annotations

import argparse
import json
import sys
import time
from functools import partial
from typing import Any, Callable, Sequence, TextIO

from ...core.proposal.thresholds_file import yaml_text
from ...core.sensors.catalogue import HOST_SOURCES
from ...core.sensors.computer import Computer
from ...core.sensors.source import NotMeasuredYet, SensorError
from ...core.values import number_text, printable, with_unit
from ...runtime.interrupts import Interrupts
from ...runtime.threads import DetachedCalls
from ..arguments import Parser, add
from ..output.lines import readable

_BETWEEN_READS_S = 0.5
"""Loads and rates are measured between two reads."""
_MOST_READS = 5
"""What has not answered by the last one does not answer."""


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
    """Lists every source of this machine, on a line each, or as JSON."""
    stream = stream or sys.stdout
    for kind, options, answer in _read_sources(computer or Computer(background=DetachedCalls("sources", 200))):
        unit = HOST_SOURCES[kind].unit
        configuration, shown, problem = {"source": kind, **options}, "", None
        if isinstance(answer, SensorError):
            shown = problem = str(answer).partition("; ")[0]  # without the advice for battery_sensor
            answer = None
        else:
            shown = readable(with_unit(number_text(answer), unit), stream)
        record = {**configuration, "value": answer, "unit": unit, "problem": problem}
        line = json.dumps(record) if as_json else f"{yaml_text(configuration)}: {shown}"
        stream.write(f"{printable(line)}\n")
    stream.flush()


def _read_sources(computer: Computer) -> list[tuple[str, dict[str, Any], Any]]:
    """Returns kind, options and value of every source of this machine; the value may be a SensorError.

    Takes half a second, and at most four if something does not answer.
    """
    # A driver may be asked for the list of options, too, and hang.
    asks = [
        partial(computer.ask, every_s=0.0, subject=kind, function=each.available) for kind, each in HOST_SOURCES.items()
    ]
    made = []
    for (kind, source), listed in zip(HOST_SOURCES.items(), _answers(asks)):
        # Without any available here, the example, whose error gives the reason.
        for options in ([] if isinstance(listed, SensorError) else list(listed)) or [source.example]:
            shown = {name: value for name, value in options.items() if value not in (None, "")}
            made.append((kind, shown, source.make(computer, **options)))
    answers = _answers([source.read for _, _, source in made])
    return [(kind, options, answer) for (kind, options, _), answer in zip(made, answers)]


def _answers(asks: Sequence[Callable[[float], Any]]) -> list[Any]:
    """Calls each function with the time until it has an answer, which may be a SensorError."""
    answers: list[Any] = [NotMeasuredYet()] * len(asks)
    for number in range(_MOST_READS):
        time.sleep(_BETWEEN_READS_S if number else 0.0)
        now_s = time.monotonic()
        for at, ask in enumerate(asks):
            if isinstance(answers[at], NotMeasuredYet):
                try:
                    answers[at] = ask(now_s)
                except SensorError as error:
                    answers[at] = error
        if not any(isinstance(answer, NotMeasuredYet) for answer in answers):
            break
    return answers
