"""`robot-health sources`: the metrics of this machine that battery_sensor can publish."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from functools import partial
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, TextIO

from ...core.sensors.catalogue import HOST_SOURCES, HostSource
from ...core.sensors.computer import Computer
from ...core.sensors.source import NotMeasuredYet, SensorError
from ...core.values.formatting import number_text, printable, with_unit
from ...runtime.interrupts import Interrupts
from ...runtime.threads import DetachedCalls
from ..arguments import Parser, add
from ..exit_codes import ExitCode
from ..output.lines import readable

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

    @property
    def value_text(self) -> str:
        """The value with its unit; a dash if it is not available."""
        return "-" if self.value is None else with_unit(number_text(self.value), HOST_SOURCES[self.kind].unit)


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Lists every source for the section `host` of battery_sensor: its configuration, its present "
        "value, or why it is not available. Shows a table on a terminal and plain lines in a pipe."
    )
    add(parser, "--json", "one JSON object per source")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Lists the sources; returns the exit code."""
    show_sources(arguments.json)
    return ExitCode.SUCCESS


def show_sources(as_json: bool, stream: Optional[TextIO] = None, computer: Optional[Computer] = None) -> None:
    """Lists every source of this machine: a table on a terminal, plain lines in a pipe, or JSON."""
    stream = stream or sys.stdout
    readings = read_sources(computer or Computer(background=DetachedCalls("sources", most_threads=200)))
    values = [readable(reading.value_text, stream) for reading in readings]
    if as_json:
        lines = [_json_line(reading) for reading in readings]
    elif stream.isatty():
        lines = _table(readings, values, shutil.get_terminal_size().columns)
    else:
        lines = [f"{reading.configuration}: {reading.problem or value}" for reading, value in zip(readings, values)]
    stream.write("".join(f"{printable(line)}\n" for line in lines))
    stream.flush()


def read_sources(computer: Computer) -> List[SourceReading]:
    """Reads every source of this machine; takes half a second, and at most four if something does not answer."""
    kinds = list(HOST_SOURCES.items())
    # A driver may be asked for the list of options, too, and hang.
    listed = _answers([partial(computer.ask, every_s=0.0, subject="", function=each.available) for _, each in kinds])
    made = [
        (kind, options, host_source.make(computer, **options))
        for (kind, host_source), found in zip(kinds, listed)
        for options in _options(host_source, found)
    ]
    answers = _answers([source.read for _, _, source in made])
    return [_reading(kind, options, answer) for (kind, options, _), answer in zip(made, answers)]


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


def _options(host_source: HostSource, found: Any) -> List[Dict[str, Any]]:
    """Returns the options available here; without any, the example, whose error gives the reason."""
    available = [] if isinstance(found, SensorError) else list(found)
    return available or [host_source.example]


def _reading(kind: str, options: Dict[str, Any], answer: Any) -> SourceReading:
    shown = {name: value for name, value in options.items() if value not in (None, "")}
    if isinstance(answer, SensorError):
        problem, _, _ = str(answer).partition("; ")  # without the advice for battery_sensor
        return SourceReading(kind, shown, None, problem)
    return SourceReading(kind, shown, answer, "")


def _table(readings: List[SourceReading], values: List[str], columns: int) -> List[str]:
    rows = [("configuration", "value", "description")]
    rows += [
        (reading.configuration, value, reading.problem or HOST_SOURCES[reading.kind].description)
        for reading, value in zip(readings, values)
    ]
    first, second = (max(len(row[column]) for row in rows) for column in (0, 1))
    return [f"{left:<{first}}  {middle:>{second}}  {right}"[: max(columns, 20)] for left, middle, right in rows]


def _json_line(reading: SourceReading) -> str:
    unit, problem = HOST_SOURCES[reading.kind].unit, reading.problem or None
    fields = {"source": reading.kind, **reading.options, "value": reading.value, "unit": unit, "problem": problem}
    return json.dumps(fields)


def _yaml(value: object) -> str:
    """Returns a value in JSON, which is YAML too; quoted texts are never read as numbers or flags."""
    text = json.dumps(value, ensure_ascii=False)
    return text if text.isprintable() else json.dumps(value)
