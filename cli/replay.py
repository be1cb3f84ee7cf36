"""Judges recordings, and shows the alerts that they would have raised. `replay_command.py` calls it."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from contextlib import nullcontext
from typing import Any, Counter, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, TextIO, Tuple

from ..core.config.signal_config import SignalConfig
from ..core.config.yaml_file import YamlFile, read_yaml
from ..core.judge.attachments import SavedMonitor
from ..core.judge.sources import is_source
from ..core.nodes.outlets import json_line
from ..core.port.local import LogLine
from ..core.port.middleware import Severity
from ..core.values.errors import ConfigError, Path
from ..core.values.formatting import count_text, duration_text, list_text, printable
from ..core.values.model import Level, Transition
from ..ops.report.plotted_signal import PlottedSignal
from ..ops.report.report import MOST_ALERTS, Report, ReportedAlert, buckets_of, facts_of, render
from ..recordings.judging import Differences, Judge, JudgedEvent, JudgedSample, SignalSummary
from ..recordings.middleware import Player
from ..recordings.reading import Recordings
from .arguments import find_installed
from .embedded import sections_of_nodes
from .output.events import Entry
from .output.lines import (
    COLOURS,
    ProgressLine,
    badness,
    below_causes,
    coloured,
    folded_name,
    is_coloured,
    is_terminal,
    plain_line,
    plain_table,
    range_cells,
    readable,
    share_cells,
    summary_sentence,
)
from .report_file import ReportFile
from .testing.black_box_alert import attached_file, attached_states

_MOST_NAMES = 6  # signals that are named in a sentence
_NOT_RECORDED = "not recorded"
_GAP = 2  # blanks between columns
_NUMBERS = (
    "samples", "bad", *(level.name for level in Level), "unknown", "alerts", "min", "mean", "max", "longest gap"
)  # fmt: skip


def replay(arguments: argparse.Namespace) -> bool:
    """Judges recordings, and shows the alerts.

    Returns whether there were alerts to fail on (with `--against`: whether the alerts differ), or a signal was not
    judged. Raises ConfigError: a configuration or an argument cannot be used, or none of its signals is recorded.
    Raises RecordingError: a recording cannot be read. Raises OutputError: the report cannot be written.
    """
    configurations = _configurations(arguments)
    report = None
    if arguments.report:
        inputs = [*arguments.recordings, *(each.file.file for each in configurations if each.file is not None)]
        report = ReportFile(arguments.report, inputs, arguments.force)
    with Recordings(arguments.recordings) as recordings:
        saved = None
        attached = None if arguments.thresholds else attached_file(recordings)
        if attached is not None:
            configurations[0] = _attached(attached)
            saved = attached_states(recordings) if arguments.from_s == 0.0 else None  # they are those at the beginning
        return _Replay(arguments, configurations, recordings, report, saved).run()


class _Configuration(NamedTuple):
    """One thresholds file."""

    name: str
    file: Optional[YamlFile]
    path: Path
    parameters: Mapping[str, Any]


class _Replay:
    def __init__(
        self,
        arguments: argparse.Namespace,
        configurations: List[_Configuration],
        recordings: Recordings,
        report_file: Optional[ReportFile],
        saved: Optional[SavedMonitor],
    ) -> None:
        self._arguments = arguments
        self._report_file = report_file
        self._several = len(configurations) > 1
        self._configurations = configurations
        self._recordings = recordings
        self._check_span()
        self._output = ReplayOutput(arguments.json)
        self._player = Player(
            recordings,
            namespace=arguments.namespace,
            from_s=arguments.from_s,
            to_s=arguments.to_s,
            use_sim_time=arguments.use_sim_time or configurations[0].parameters.get("use_sim_time") is True,
            begin_ns=None if saved is None else round(saved.time_s * 1e9),
            on_log=self._on_log,
        )
        self._start_s = self._player.wall_s
        self._plots: Dict[Tuple[str, str], PlottedSignal] = {}  # by configuration and signal; only for a report
        self._shown: List[ReportedAlert] = []
        self._shown_levels: Counter[Level] = Counter()  # new levels of all transitions that were shown
        names = [configuration.name for configuration in configurations]
        self._differences = Differences(names, self._show) if self._several else None
        self._judge = Judge(self._player, self._on_event, self._plot if report_file else None)
        self._player.on_gap.append(self._on_gap)
        for configuration in configurations:
            file, path = configuration.file, configuration.path
            with nullcontext() if file is None else file.located(path):
                self._judge.add(configuration.name, configuration.parameters, saved)
        self._require_recorded()
        self._buckets = buckets_of(sum(summary.recorded for summary in self._judge.summaries))

    def run(self) -> bool:
        with self._output as output:
            self._judge.run(output.progress)
            if self._differences is not None:
                self._differences.flush()
        self._require_judged()
        summaries = self._summaries()
        missing = {summary.config.name: summary.missing for summary in summaries if summary.missing}
        problems = self._player.problems
        if missing:
            reasons = ", ".join(f"{name} ({reason})" for name, reason in missing.items())
            problems.append(f"not judged: {reasons}")
        for problem in problems:
            output.warn(f"WARN: {problem}")
        cells = ((effects, row(summary, self._several)) for summary, effects in folded(summaries))
        rows = [[folded_name(name, effects), *others] for effects, (name, *others) in cells]
        head = header(self._several)
        number, noun = sum(self._shown_levels.values()), "difference"
        if not self._several:  # else OK counts: an alert may end at another time
            number, noun = sum(summary.alerts for summary in summaries), "alert"
        verdict = count_text(number, noun) if number else f"no {noun}s"
        if missing:
            verdict += f"; {count_text(len(missing), 'signal')} not judged"
        output.table(head, rows, verdict)
        if self._report_file is not None:
            self._report_file.write(self._page(summaries, verdict, problems))
        if self._arguments.fail_on == "never":
            return False
        fail_on = Level[self._arguments.fail_on.upper()]
        if missing and not self._arguments.allow_missing:
            return True
        if self._several:
            return bool(self._shown_levels)
        return max((level.severity for level in self._shown_levels), default=0) >= fail_on.severity

    def _summaries(self) -> List[SignalSummary]:
        """Returns the summaries; those of one signal follow each other, so that configurations can be compared."""
        found = self._judge.summaries
        names = list(dict.fromkeys(summary.config.name for summary in found))
        return sorted(found, key=lambda summary: names.index(summary.config.name))

    def _check_span(self) -> None:
        span = self._recordings.span_ns
        length_s = 0.0 if span is None else (span[1] - span[0]) / 1e9
        if self._arguments.from_s > length_s:
            raise ConfigError(
                f"--from {self._arguments.from_s:g}: expected at most the length of the recordings ({length_s:.3f} s)"
            )
        if self._arguments.to_s < self._arguments.from_s:
            raise ConfigError(f"--to {self._arguments.to_s:g}: expected at least --from {self._arguments.from_s:g}")

    # While the recordings are played

    def _on_event(self, judged: JudgedEvent) -> None:
        event = judged.event
        if isinstance(event, Transition):
            plot = self._plot_of(judged.file, event.signal) if self._report_file else None
            if plot is not None:
                plot.add_level(judged.wall_s, event.to_level.name)
            (self._differences.add if self._differences else self._show)(judged)
        elif judged.file == self._configurations[0].name:
            self._output.log(judged.wall_s, LogLine(event.now_s, "alert_system", event.severity, event.text))

    def _show(self, judged: JudgedEvent) -> None:
        transition = judged.event
        assert isinstance(transition, Transition)
        file = judged.file if self._several else ""
        self._shown_levels[transition.to_level] += 1
        if self._report_file and len(self._shown) < MOST_ALERTS:
            self._shown.append(ReportedAlert(judged.wall_s, file, transition, effects=judged.effects))
        self._output.transition(judged.wall_s, transition, file)

    def _on_log(self, line: LogLine) -> None:
        if line.severity >= Severity.WARN:
            self._output.log(self._player.wall_s, line)

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

    def _plot_of(self, file: str, signal: str) -> Optional[PlottedSignal]:
        """Returns the plot of a signal, which begins here; None if it is not of the configuration."""
        config = self._judge.config_of(file, signal)
        if (file, signal) not in self._plots and config is not None:
            shown_file, span_s = file if self._several else "", self._player.end_s - self._start_s
            self._plots[file, signal] = PlottedSignal(config, shown_file, self._start_s, span_s, self._buckets)
        return self._plots.get((file, signal))

    def _page(self, summaries: List[SignalSummary], verdict: str, problems: List[str]) -> str:
        end_s = self._player.wall_s
        with_effects = folded(worst_first(summaries))
        summaries = [summary for summary, _ in with_effects]
        plots = [self._plots.get((summary.file, summary.config.name)) for summary in summaries]
        names = list_text([os.path.basename(os.path.abspath(name)) for name in self._arguments.recordings])
        judged_by = f"judged by {' and '.join(each.name for each in self._configurations)}; "
        return render(
            Report(
                title=f"Replay of {names}",
                facts=facts_of(self._start_s, end_s, judged_by),
                summary=sentence(summaries, end_s - self._start_s),
                verdict=verdict,
                problems=problems,
                start_s=self._start_s,
                end_s=end_s,
                utc_offset_s=float(time.localtime(self._start_s).tm_gmtoff),
                header=header(self._several),
                rows=[row(summary, self._several) for summary in summaries],
                signals=[plot for plot in plots if plot is not None],
                alerts=self._shown,
                all_alerts=sum(self._shown_levels.values()),
                effects=[effects for _, effects in with_effects],
            )
        )

    # Whether there was something to judge

    def _require_recorded(self) -> None:
        """Raises ConfigError if no signal of a configuration is recorded."""
        topics = {channel.topic for channel in self._recordings.channels}
        for summaries in self._by_configuration():
            if any(summary.recorded for summary in summaries):
                continue
            wanted = list_text(list(dict.fromkeys(summary.topic for summary in summaries)))
            if not topics:
                reason = "the recordings have no topics with ROS messages"
            elif topics.isdisjoint(summary.topic for summary in summaries):
                reason = f"expected one of {wanted}, got {list_text(sorted(topics))}; is a --namespace missing?"
            else:
                reason = list_text([summary.missing for summary in summaries])
            raise ConfigError(f"no signal is recorded: {reason}")

    def _require_judged(self) -> None:
        """Raises ConfigError if no signal of a configuration had a sample."""
        for summaries in self._by_configuration():
            if all(summary.missing for summary in summaries):
                reasons = list_text([f"{summary.config.name} ({summary.missing})" for summary in summaries])
                raise ConfigError(f"no signal was judged: {reasons}")

    def _by_configuration(self) -> List[List[SignalSummary]]:
        found = [each for each in self._judge.summaries if not is_source(each.config.name)]
        return [[each for each in found if each.file == configuration.name] for configuration in self._configurations]


def _configurations(arguments: argparse.Namespace) -> List[_Configuration]:
    first = arguments.thresholds or find_installed("config/thresholds.yaml")
    found = [_read(arguments, None if first is None else os.fspath(first))]
    if arguments.against:
        second = _read(arguments, arguments.against)
        found.append(second._replace(name=f"{second.name} (2)") if second.name == found[0].name else second)
    return found


def _attached(file: YamlFile) -> _Configuration:
    """Returns the configuration that a black box has attached."""
    section = sections_of_nodes(file)["alert_system"]
    folder, name = os.path.split(file.file)
    return _Configuration(f"{name} in {os.path.basename(folder)}", file, section.path, section.tree)


def _read(arguments: argparse.Namespace, name: Optional[str]) -> _Configuration:
    file_name = os.path.basename(os.path.abspath(arguments.recordings[0]))
    robot = arguments.namespace.strip("/") or printable(file_name).strip() or "recorded"  # any bytes but / are a name
    if name is None:
        return _Configuration("the defaults", None, (), {"robot_name": robot})
    file = read_yaml(name)
    section = sections_of_nodes(file)["alert_system"]
    # The host that replays is not the robot.
    parameters = {**section.tree, "robot_name": section.tree.get("robot_name") or robot}
    return _Configuration(name, file, section.path, parameters)


class ReplayOutput:
    """Writes alerts to stdout and everything else about the replay to where it does not disturb them.

    What calls it must not raise: an error waits for the next `progress`, or for the end of its context.
    """

    def __init__(self, as_json: bool) -> None:
        """Prepares the output; `as_json`: one JSON object per transition on stdout, the rest on stderr."""
        self._as_json = as_json
        self._is_coloured = is_coloured(sys.stdout) and not as_json
        self._progress = ProgressLine()
        self._started_s = time.monotonic()
        self._error: Optional[OSError] = None

    def __enter__(self) -> ReplayOutput:
        """Returns itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Removes the progress."""
        self._progress.clear()
        self._raise_error()

    def progress(self, fraction: float) -> None:
        """Shows how much has been judged, 0 to 1, on a terminal."""
        self._raise_error()
        left_s = (time.monotonic() - self._started_s) * (1.0 - fraction) / max(fraction, 0.01)
        self._progress.show(f"judging: {fraction:.0%}, {left_s:.0f} s left")

    def transition(self, wall_s: float, transition: Transition, file: str) -> None:
        """Writes a transition at a time in s since 1970; `file` is its configuration, empty if there is only one."""
        if self._as_json:
            line = json_line(transition, **({"file": file} if file else {}))
        else:
            line = readable(plain_line(Entry(wall_s, transition), prefix=file), sys.stdout)
        self._write(line, COLOURS[transition.to_level])

    def log(self, wall_s: float, line: LogLine) -> None:
        """Writes a line of a node; INFO lines go where the alerts are, except with JSON."""
        text = plain_line(Entry(wall_s, line))
        if line.severity >= Severity.WARN or self._as_json:
            self.warn(text)
        else:
            self._write(text, "2")

    def warn(self, text: str) -> None:
        """Writes a line to stderr."""
        self._write(printable(text), stream=sys.stderr)

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], last_line: str) -> None:
        """Writes the table, on a terminal in parts that fit, with a line below it."""
        stream = sys.stderr if self._as_json else sys.stdout
        lines = [[printable(readable(cell, stream)) for cell in cells] for cells in (head, *rows)]
        widths = [_GAP + max(map(len, column)) for column in zip(*lines)]
        texts = len(head) - len(_NUMBERS)
        width = shutil.get_terminal_size().columns if is_terminal(stream) else sys.maxsize
        shown = []
        for numbers in _parts(widths[texts:], width - sum(widths[:texts])):
            part = ([*line[:texts], *line[texts:][numbers]] for line in lines if any(line[texts:][numbers]))
            shown += ["", *plain_table(list(part), texts)]
        for line in (*shown, printable(last_line)):
            self._write(line, stream=stream)
        self._raise_error()

    def _write(self, line: str, colour: str = "", stream: Optional[TextIO] = None) -> None:
        try:
            self._progress.clear()
            if stream is not None:
                sys.stdout.flush()
            print(coloured(line, colour) if self._is_coloured else line, file=stream, flush=stream is not None)
        except OSError as error:
            self._error = self._error or error

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error


def header(several_files: bool) -> List[str]:
    """Returns the heads of the columns; with `several_files` there is one for the configuration."""
    return ["signal", *(["file"] if several_files else []), *_NUMBERS]


def row(summary: SignalSummary, several_files: bool) -> List[str]:
    """Returns the cells of one signal, in the order of `header`."""
    names = [summary.config.name, *([summary.file] if several_files else [])]
    if not summary.recorded:
        return [*names, _NOT_RECORDED, *[""] * (len(_NUMBERS) - 1)]
    statistics = summary.statistics
    range_texts = range_cells(summary.config, statistics.min, statistics.mean, statistics.max)
    gap = "-" if statistics.longest_gap_s is None else duration_text(statistics.longest_gap_s)
    counts = ["-", "-"] if is_source(names[0]) else [str(statistics.samples), str(statistics.bad_samples)]
    return [
        *names, *counts, *share_cells(summary.shares, summary.unknown),
        str(summary.alerts), *range_texts, gap,
    ]  # fmt: skip


def folded(summaries: Sequence[SignalSummary]) -> List[Tuple[SignalSummary, int]]:
    """Returns the summaries with effects below their cause, and how many follow each: -1 for an effect."""
    return below_causes(summaries, lambda each: (each.file, each.config.name), lambda each: each.cause)


def worst_first(summaries: Sequence[SignalSummary]) -> List[SignalSummary]:
    """Returns the summaries in the order of badness; those of one signal stay together."""
    worst: Dict[str, Tuple[float, ...]] = {}
    for summary in summaries:
        name = summary.config.name
        # One that was not judged is worse than one that was OK.
        worst[name] = max(badness(summary.shares, summary.alerts, bool(summary.missing)), worst.get(name, ()))
    return sorted(summaries, key=lambda summary: worst[summary.config.name], reverse=True)


def sentence(summaries: Sequence[SignalSummary], duration_s: float) -> str:
    """Returns what was judged, for how long, and which signal was worst: the first of the summaries."""
    judged_ones = (summary.config.name for summary in summaries if not summary.missing)
    names = [name for name in dict.fromkeys(judged_ones) if not is_source(name)]
    several = f" ({len(names)} signals)" if len(names) > _MOST_NAMES else ""
    worst = summaries[0]
    what = f"{list_text(names, _MOST_NAMES)}{several}"
    return summary_sentence(what, len(names), "judged", duration_s, worst.config.name, worst.shares)


def _parts(widths: Sequence[int], room: int) -> Iterator[slice]:
    """Yields successive columns that fit into a width, at least one at a time."""
    start = used = 0
    for at, width in enumerate(widths):
        if used and used + width - _GAP > room:
            yield slice(start, at)
            start, used = at, 0
        used += width
    yield slice(start, len(widths))
