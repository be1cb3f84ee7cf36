"""`robot-health replay`: the alerts that recordings would have raised."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from typing import Callable, Counter, Sequence, TextIO, Tuple

from ...core.config import Section, SignalConfig, YamlFile, read_yaml
from ...core.judge import SavedMonitor, is_source
from ...core.nodes.outlets import json_line
from ...core.port import LogLine, Severity
from ...core.values import ConfigError, Level, ServiceError, Transition, count_text, duration_text, list_text, printable
from ...ops.report.plotted_signal import PlottedSignal
from ...ops.report.report import MOST_ALERTS, Report, ReportedAlert, buckets_of, render
from ...ops.report.summaries import SHARES, SummaryRow, range_cells, table
from ...recordings.judging import Differences, Judge, JudgedEvent, JudgedSample, SignalSummary
from ...recordings.middleware import Player
from ...recordings.reading import Recordings
from ...runtime.interrupts import Interrupts
from ..arguments import INTERRUPTED, Parser, add, add_recordings, checked, find_installed
from ..embedded import sections_of_nodes
from ..exit_codes import ExitCode
from ..output.events import Entry
from ..output.lines import ProgressLine, plain_line, plain_table, readable
from ..report_file import ReportFile
from ..testing.past_alert import attached

_NUMBERS = ("samples", "bad", *SHARES, "alerts", "min", "mean", "max", "longest gap")


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Judges recordings as the live monitor would have done: .bag files, .mcap files, and folders of "
        "rosbag2. Several recordings are read together, in the order of their log times."
    )
    add_recordings(parser)
    add(parser, "--thresholds FILE", "configuration (default: the installed one)")
    add(parser, "--against FILE", "show only the alerts in which this second configuration differs")
    add(parser, "--report FILE", "write a page with plots, one HTML file")
    add(parser, "--force", "let --report replace any file, except those that are read")
    add(parser, "--json", "one JSON object per alert on stdout, the table on stderr")
    add(
        parser,
        "--fail-on",
        "end with code 1 if there was an alert of this level or worse (OK < WARN < STALE < ERROR); with --against: if "
        "the alerts differ, unless never (default: warn)",
        choices=("warn", "error", "never"),
        default="warn",
    )
    add(parser, "--allow-missing", "do not end with code 1 because a signal is not recorded")
    offset = checked("a number of seconds, 0 or more", float, lambda number: 0.0 <= number < 1e9)
    add(parser, "--from SECONDS", "begin this long after the start", type=offset, dest="from_s", default=0.0)
    add(parser, "--to SECONDS", "end this long after the start", type=offset, dest="to_s", default=math.inf)
    add(parser, "--use-sim-time", "take the time from the recorded topic /clock")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Judges recordings, and shows the alerts; returns the exit code.

    It is `ALERTS` if there were alerts to fail on (with `--against`: if the alerts differ), or a signal was not judged.

    Raises:
        ConfigError: a configuration or an argument cannot be used, or none of its signals is recorded.
        RecordingError: a recording cannot be read.
        OutputError: the report cannot be written.
    """
    try:
        with Recordings(arguments.recordings) as recordings:
            file, saved = (None, None) if arguments.thresholds else attached(recordings)
            configurations = _configurations(arguments, file)
            report = None
            if arguments.report:
                inputs = [*arguments.recordings, *(each.file for _, each, _ in configurations)]
                report = ReportFile(arguments.report, inputs, arguments.force)
            # What is saved are the states at the beginning.
            states = saved if arguments.from_s == 0.0 else None
            has_failed = _Replay(arguments, configurations, recordings, report, states).run()
    except KeyboardInterrupt:  # half a result must not look like success
        raise ServiceError(INTERRUPTED) from None
    return ExitCode.ALERTS if has_failed else ExitCode.SUCCESS


_Configuration = Tuple[str, YamlFile, Section]
"""The name of a thresholds file, its content, and its section of alert_system."""


class _Replay:
    def __init__(
        self,
        arguments: argparse.Namespace,
        configurations: list[_Configuration],
        recordings: Recordings,
        report_file: ReportFile | None,
        saved: SavedMonitor | None,
    ) -> None:
        self._arguments = arguments
        self._report_file = report_file
        self._several = len(configurations) > 1
        self._progress, self._started_s = ProgressLine(), time.monotonic()
        self._error: OSError | None = None
        """Waits for the next progress or the end: what is called while recordings are played must not raise."""
        self._player = Player(
            recordings,
            namespace=arguments.namespace,
            from_s=arguments.from_s,
            to_s=arguments.to_s,
            use_sim_time=arguments.use_sim_time or configurations[0][2].tree.get("use_sim_time") is True,
            begin_ns=None if saved is None else round(saved.time_s * 1e9),
            on_log=self._on_log,
        )
        self._start_s = self._player.wall_s
        self._plots: dict[tuple[str, str], PlottedSignal] = {}
        """By configuration, empty if there is only one, and signal; only for a report."""
        self._shown: list[ReportedAlert] = []
        self._shown_levels: Counter[Level] = Counter()  # new levels of all transitions that were shown
        self._names = [name for name, _, _ in configurations]
        self._differences = Differences(self._show) if self._several else None
        self._judge = Judge(self._player, self._on_event, self._plot if report_file else None)
        self._player.on_gap.append(self._on_gap)
        for name, file, section in configurations:
            with file.located(section.path):
                self._judge.add(name, section.tree, saved)
        topics = list_text(sorted({channel.topic for channel in recordings.channels})) or "no topic"
        hint = f"; the recordings have {topics}; is a --namespace missing?"
        self._require("is recorded", lambda summary: summary.recorded, hint)
        self._buckets = buckets_of(sum(summary.recorded for summary in self._judge.summaries))

    def run(self) -> bool:
        try:
            self._judge.run(self._show_progress)
            if self._differences is not None:
                self._differences.flush()
        finally:
            self._progress.clear()
        self._require("was judged", lambda summary: not summary.missing)
        summaries = self._judge.summaries
        missing = {summary.config.name: summary.missing for summary in summaries if summary.missing}
        problems = self._player.problems
        if missing:
            reasons = ", ".join(f"{name} ({reason})" for name, reason in missing.items())
            problems.append(f"not judged: {reasons}")
        for problem in problems:
            self._write(f"WARN: {problem}", sys.stderr)
        rows = [row(summary, self._several) for summary in summaries]
        heads = ["signal", *(["file"] if self._several else []), *_NUMBERS]
        number, noun = sum(self._shown_levels.values()), "difference"
        if not self._several:  # else OK counts: an alert may end at another time
            number, noun = sum(summary.alerts for summary in summaries), "alert"
        verdict = count_text(number, noun) if number else f"no {noun}s"
        if missing:
            verdict += f"; {count_text(len(missing), 'signal')} not judged"
        stream = sys.stderr if self._arguments.json else sys.stdout
        cells = [[readable(cell, stream) for cell in each] for each in table(heads, rows)]
        for line in ("", *plain_table(cells, len(heads) - len(_NUMBERS)), verdict):
            self._write(line, stream)
        self._raise_error()
        if self._report_file is not None:
            self._report_file.write(self._page(rows, verdict, problems))
        if self._arguments.fail_on == "never":
            return False
        fail_on = Level[self._arguments.fail_on.upper()]
        if missing and not self._arguments.allow_missing:
            return True
        if self._several:
            return bool(self._shown_levels)
        return max((level.severity for level in self._shown_levels), default=0) >= fail_on.severity

    # While the recordings are played

    def _on_event(self, judged: JudgedEvent) -> None:
        event = judged.event
        if isinstance(event, Transition):
            plot = self._plot_of(judged.file, event.signal) if self._report_file else None
            if plot is not None:
                plot.add_level(judged.wall_s, event.to_level.name)
            (self._differences.add if self._differences else self._show)(judged)
        elif judged.file == self._names[0]:
            self._log(judged.wall_s, LogLine(event.now_s, "alert_system", event.severity, event.text))

    def _show(self, judged: JudgedEvent) -> None:
        transition = judged.event
        assert isinstance(transition, Transition)
        file = judged.file if self._several else ""
        self._shown_levels[transition.to_level] += 1
        if self._report_file and len(self._shown) < MOST_ALERTS:
            self._shown.append(ReportedAlert(judged.wall_s, file, transition, effects=judged.effects))
        line = plain_line(Entry(judged.wall_s, transition), prefix=file)
        if self._arguments.json:
            line = json_line(transition, **({"file": file} if file else {}))
        self._write(line)

    def _on_log(self, line: LogLine) -> None:
        if line.severity >= Severity.WARN:
            self._log(self._player.wall_s, line)

    def _log(self, wall_s: float, line: LogLine) -> None:
        """Writes a line of a node; INFO lines go where the alerts are, except with JSON."""
        is_beside = line.severity >= Severity.WARN or self._arguments.json
        self._write(plain_line(Entry(wall_s, line)), sys.stderr if is_beside else None)

    def _show_progress(self, fraction: float) -> None:
        """Shows how much has been judged, 0 to 1, on a terminal."""
        self._raise_error()
        left_s = (time.monotonic() - self._started_s) * (1.0 - fraction) / max(fraction, 0.01)
        self._progress.show(f"judging: {fraction:.0%}, {left_s:.0f} s left")

    def _write(self, line: str, stream: TextIO | None = None) -> None:
        stream = stream or sys.stdout
        try:
            self._progress.clear()
            if stream is not sys.stdout:
                sys.stdout.flush()
            text = printable(line if self._arguments.json else readable(line, stream))
            print(text, file=stream, flush=stream is not sys.stdout)
        except OSError as error:
            self._error = self._error or error

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error

    # The report

    def _on_gap(self, begin_s: float, end_s: float) -> None:
        for plot in self._plots.values():
            plot.add_gap(begin_s, end_s)

    def _plot(self, file: str, config: SignalConfig, sample: JudgedSample) -> None:
        plot = self._plot_of(file, config.name)
        if plot is not None and sample.value is None:
            plot.add_bad(sample.wall_s)
        elif plot is not None:
            # A forecast is shown by its line, and by the values that it follows from.
            plot.add(sample.wall_s, sample.value if config.statistic == "forecast" else sample.judged)

    def _plot_of(self, file: str, signal: str) -> PlottedSignal | None:
        """Returns the plot of a signal, which begins here; None if it is not of the configuration."""
        summary = self._judge.find(file, signal)
        key = file if self._several else "", signal
        if key not in self._plots and summary is not None:
            span_s = self._player.end_s - self._start_s
            self._plots[key] = PlottedSignal(summary.config, key[0], self._start_s, span_s, self._buckets)
        return self._plots.get(key)

    def _page(self, rows: list[SummaryRow], verdict: str, problems: list[str]) -> str:
        names = list_text([os.path.basename(os.path.abspath(name)) for name in self._arguments.recordings])
        return render(
            Report(
                title=f"Replay of {names}",
                verdict=verdict,
                problems=problems,
                start_s=self._start_s,
                end_s=self._player.wall_s,
                columns=_NUMBERS,
                rows=worst_first(rows),
                plots=self._plots,
                alerts=self._shown,
                all_alerts=sum(self._shown_levels.values()),
                judged_by=" and ".join(self._names),
            )
        )

    def _require(self, done: str, is_done: Callable[[SignalSummary], bool], hint: str = "") -> None:
        """Raises ConfigError if no signal of a configuration is recorded, or was judged."""
        for name in self._names:
            summaries = [each for each in self._judge.summaries if each.file == name]
            signals = [each for each in summaries if not is_source(each.config.name)]
            if not any(map(is_done, signals)):
                reasons = list_text([f"{summary.config.name} ({summary.missing})" for summary in signals])
                raise ConfigError(f"no signal {done}: {reasons}{hint}")


def _configurations(arguments: argparse.Namespace, attached: YamlFile | None) -> list[_Configuration]:
    """Returns what is to be judged by: the file that was given, the one that a black box has, or the installed one."""
    if attached is not None:
        folder, name = os.path.split(attached.file)
        section = sections_of_nodes(attached)["alert_system"]
        configurations = [(f"{name} in {os.path.basename(folder)}", attached, section)]
    else:
        first = arguments.thresholds or find_installed("config/thresholds.yaml")
        if first is None:
            raise ConfigError("no thresholds.yaml is installed; expected --thresholds FILE")
        configurations = [_read(arguments, os.fspath(first))]
    if arguments.against:
        name, file, section = _read(arguments, arguments.against)
        configurations.append((f"{name} (2)" if name == configurations[0][0] else name, file, section))
    return configurations


def _read(arguments: argparse.Namespace, name: str) -> _Configuration:
    file_name = os.path.basename(os.path.abspath(arguments.recordings[0]))
    robot = arguments.namespace.strip("/") or printable(file_name).strip() or "recorded"  # any bytes but / are a name
    file = read_yaml(name)
    section = sections_of_nodes(file)["alert_system"]
    # The host that replays is not the robot.
    tree = {**section.tree, "robot_name": section.tree.get("robot_name") or robot}
    return name, file, section._replace(tree=tree)


def row(summary: SignalSummary, several_files: bool) -> SummaryRow:
    """Returns what the table and the report show of one signal; with `several_files`, also its configuration."""
    samples, name = summary.samples, summary.config.name
    figures = {**dict.fromkeys(_NUMBERS, ""), "samples": "not recorded"}
    if summary.recorded:
        number, bad = (["-"] * 2) if is_source(name) else map(str, (samples.good + samples.bad, samples.bad))
        gap_s = summary.longest_gap_s
        figures = {
            "samples": number,
            "bad": bad,
            **range_cells(summary.config, samples.least, samples.mean, samples.most),
            "longest gap": "-" if gap_s is None else duration_text(gap_s),
        }
    file = summary.file if several_files else ""
    return SummaryRow(name, file, summary.cause, summary.shares, summary.unknown, summary.alerts, figures)


def worst_first(rows: Sequence[SummaryRow]) -> list[SummaryRow]:
    """Returns the rows in the order of badness; those of one signal, which follow each other, stay together."""
    worst: dict[str, tuple[float, ...]] = {}
    for each in rows:
        worst[each.signal] = max(each.badness, worst.get(each.signal, ()))
    return sorted(rows, key=lambda each: worst[each.signal], reverse=True)
