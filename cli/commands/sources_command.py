"""`robot-health sources`: the metrics of this machine that battery_sensor can publish."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from functools import partial
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, TextIO

from ...core.sensors.catalogue import HOST_SOURCES
from ...core.sensors.computer import Computer
from ...core.sensors.source import NotMeasuredYet, SensorError
from ...core.values.formatting import number_text, printable, with_unit
from ...runtime.interrupts import Interrupts
from ...runtime.threads import DetachedCalls
from ..arguments import Parser, add
from ..output.lines import plain_table, readable

_BETWEEN_READS_S = 0.5
"""Loads and rates are measured between two reads."""
_MOST_READS = 5
"""What has not answered by the last one does not answer."""


class SourceReading(NamedTuple):
    """One source of this machine, and its present value."""

    kind: str
    """Its name in the configuration, as `source`."""
    options: Dict[str, Any]
    """The other keys of its configuration."""
    value: Optional[float]
    """The value, in the unit of the source; None if it is not available."""
    problem: str
    """Why the value is not available; empty if it is."""

    @property
    def configuration(self) -> str:
        """The value of a key in the section `host`, in YAML."""
        options = [f"{name}: {_yaml(value)}" for name, value in self.options.items()]
        return "{" + ", ".join([f"source: {self.kind}", *options]) + "}"


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Lists every source for the section `host` of battery_sensor: its configuration, its present "
        "value, or why it is not available. Shows a table on a terminal and plain lines in a pipe."
    )
    add(parser, "--json", "one JSON object per source")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Lists the sources."""
    show_sources(arguments.json)


def show_sources(as_json: bool, stream: Optional[TextIO] = None, computer: Optional[Computer] = None) -> None:
    """Lists every source of this machine: a table on a terminal, plain lines in a pipe, or JSON."""
    stream = stream or sys.stdout
    rows = []
    lines = []
    for reading in read_sources(computer or Computer(background=DetachedCalls("sources", most_threads=200))):
        kind, options, value, problem = reading
        source = HOST_SOURCES[kind]
        shown = "-" if value is None else readable(with_unit(number_text(value), source.unit), stream)
        rows.append((reading.configuration, shown, problem or source.description))
        record = {"source": kind, **options, "value": value, "unit": source.unit, "problem": problem or None}
        lines.append(json.dumps(record) if as_json else f"{reading.configuration}: {problem or shown}")
    if stream.isatty() and not as_json:
        columns = max(shutil.get_terminal_size().columns, 20)
        lines = [line[:columns] for line in plain_table([("configuration", "value", "description"), *rows], 3)]
    stream.write("".join(f"{printable(line)}\n" for line in lines))
    stream.flush()


def read_sources(computer: Computer) -> List[SourceReading]:
    """Reads every source of this machine; takes half a second, and at most four if something does not answer."""
    # A driver may be asked for the list of options, too, and hang.
    every = HOST_SOURCES.values()
    listed = _answers([partial(computer.ask, every_s=0.0, subject="", function=each.available) for each in every])
    made = []
    for (kind, source), found in zip(HOST_SOURCES.items(), listed):
        # Without any available here, the example, whose error gives the reason.
        for options in ([] if isinstance(found, SensorError) else list(found)) or [source.example]:
            made.append((kind, options, source.make(computer, **options)))
    readings = []
    for (kind, options, _), answer in zip(made, _answers([source.read for _, _, source in made])):
        shown = {name: value for name, value in options.items() if value not in (None, "")}
        is_missing = isinstance(answer, SensorError)
        problem = str(answer).partition("; ")[0] if is_missing else ""  # without the advice for battery_sensor
        readings.append(SourceReading(kind, shown, None if is_missing else answer, problem))
    return readings


def _answers(asks: Sequence[Callable[[float], Any]]) -> List[Any]:
    """Calls each function with the time until it has an answer, which may be a SensorError."""
    answers: List[Any] = [NotMeasuredYet()] * len(asks)
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


def _yaml(value: object) -> str:
    """Returns a value in JSON, which is YAML too; quoted texts are never read as numbers or flags."""
    text = json.dumps(value, ensure_ascii=False)
    return text if text.isprintable() else json.dumps(value)
