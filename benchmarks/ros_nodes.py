"""The nodes on ROS: CPU per message beside bare subscribers, memory and CPU at rest.

CPU per message: a bare subscriber receives the same messages at the same time, so that other load affects both alike.
Neither ever pauses: after a second of idleness, caches (on a virtual machine even the host's memory) no longer hold a
process, and reloading it would count as its cost. The alert node is the executable as launched; the bare subscribers
count. On ROS 2, `subscriber` is on the SingleThreadedExecutor, which most nodes use, and all others are on the
EventsExecutor, which the alert node chooses where it works. `rostopic hz` is there for ROS 1 only: no package index has
`ros2 topic hz`.
"""

from __future__ import annotations

import contextlib
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, NamedTuple

from benchmarks.processes import Process, Target
from benchmarks.ros_peers import BARE, STATUSES, WATCHED, topics_below
from benchmarks.table import ROOT, Row, median_ratio

ROUNDS = 20
SLICE_S = 3.0
SETTLE_S = 0.2
"""Time for messages in flight at the end of a slice."""
_NO_SOURCES = (
    "from robot_health_monitor.core.judge.monitor import Monitor; Monitor.expect_sources = lambda self, names: None; "
)
"""Code that makes an alert node take each signal by itself: the topics of its signals are not watched."""
NAMES = {
    "without sources": "alert_system without sources",
    "subscriber": "bare subscriber",
    "events_subscriber": "bare subscriber, EventsExecutor",
    "rostopic hz": "rostopic hz",
    "raw_subscriber": "bare subscriber of bytes",
    "diagnostics_subscriber": "bare subscriber of statuses",
}


class _Question(NamedTuple):
    """What is compared with what."""

    what: str
    thresholds: str
    """`{folder}` is one that the node may write into, with the ops.yaml."""
    required: Mapping[str, Mapping[str, float]]
    """By middleware: the largest ratio to each bare peer."""
    topics: int = 1
    rate_hz: float = 1000.0
    """Messages per second over all topics."""
    remap: str = ""
    ops: str = ""
    publisher: str = "publisher"


def _on_both(peer: str, required: float) -> Mapping[str, Mapping[str, float]]:
    return {"ros1": {peer: required}, "ros2": {peer: required}}


def _signals(*lines: str, ops: str = "''") -> str:
    parameters = ["alert_system:", "  ros__parameters:", f"    ops: {ops}", "    signals:"]
    return "\n".join([*parameters, *(f"      {line}" for line in lines), ""])


def messages(target: Target) -> Iterator[Row]:
    """One topic, with the default configuration."""
    thresholds = (ROOT / "config" / "thresholds.yaml").read_text("utf-8")
    required = {
        "ros1": {"subscriber": 1.35, "without sources": 1.03},
        "ros2": {"subscriber": 0.35, "events_subscriber": 1.15, "without sources": 1.03},
    }
    question = _Question("one message at 1 kHz", thresholds, required, remap=f"battery_level:={WATCHED}")
    yield from _answers(target, question)


def signals(target: Target) -> Iterator[Row]:
    """The frequency of one topic, and many topics."""
    arrivals = f"{{topic: {WATCHED}, type: std_msgs/Float32, field: '', statistic: frequency_hz, warn_below: 100}}"
    required = {"ros1": {"rostopic hz": 1.0}, "ros2": {"subscriber": 1.2}}
    yield from _answers(
        target, _Question("frequency of one topic at 1 kHz", _signals(f"arrivals: {arrivals}"), required)
    )
    levels = [
        f"level_{number}: {{topic: {topic}, type: std_msgs/Float32, warn_below: 20.0, error_below: 10.0}}"
        for number, topic in enumerate(topics_below(WATCHED, 100))
    ]
    question = _Question("100 topics at 10 Hz each", _signals(*levels), _on_both("subscriber", 1.3), topics=100)
    yield from _answers(target, question)


def statuses(target: Target) -> Iterator[Row]:
    """The statuses of many drivers in one message."""
    drivers = f"{{topic: {WATCHED}, type: diagnostic_msgs/DiagnosticArray, field: 'status[\"*\"]'}}"
    question = _Question(
        f"{STATUSES} statuses at 10 Hz",
        _signals(f"drivers: {drivers}"),
        _on_both("diagnostics_subscriber", 1.5),
        rate_hz=10.0,
        publisher="diagnostics_publisher",
    )
    yield from _answers(target, question)


def black_box(target: Target) -> Iterator[Row]:
    """Ten topics of which the bytes are kept, while a signal of another topic is judged."""
    recorded = ", ".join(topics_below(WATCHED, 10))
    question = _Question(
        "black box of 10 topics at 100 Hz each",
        _signals("other: {topic: other, type: std_msgs/Float32, stale_after_s: 0.0}", ops="{folder}/ops.yaml"),
        _on_both("raw_subscriber", 1.3),
        topics=10,
        ops=f"black_box: {{folder: '{{folder}}', topics: [{recorded}]}}",
    )
    yield from _answers(target, question)


def _answers(target: Target, question: _Question, rounds: int = ROUNDS) -> Iterator[Row]:
    for peer, required in question.required[target.package].items():
        if peer == "rostopic hz" and not shutil.which("rostopic"):
            peer, required = "subscriber", 1.2
        cost_us = _compare(target, question, peer, rounds)
        what = f"{target.name}, {question.what}"
        of_bare, of_node = (f"{statistics.median(values):.0f} us" for values in cost_us.values())
        yield Row(what, NAMES[peer], of_bare)
        ratio = median_ratio(cost_us[WATCHED], cost_us[BARE])
        yield Row(what, "alert_system", of_node, ratio, required, f"to the {NAMES[peer]}, per message")


@contextlib.contextmanager
def _configured(thresholds: str, ops: str) -> Iterator[Path]:
    """Yields a folder with thresholds.yaml and ops.yaml."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in (("thresholds.yaml", thresholds), ("ops.yaml", ops)):
            Path(folder, name).write_text(text.replace("{folder}", folder))
        yield Path(folder)


def _compare(target: Target, question: _Question, peer: str, rounds: int) -> Dict[str, List[float]]:
    """Returns the CPU time per message in each slice but the first, which fills the windows; in us."""
    cost_us: Dict[str, List[float]] = {BARE: [], WATCHED: []}
    with contextlib.ExitStack() as running:
        folder = running.enter_context(_configured(question.thresholds, question.ops))
        file = folder / "thresholds.yaml"
        if peer == "without sources":
            bare = target.node("alert_system", "without_sources", f"battery_level:={BARE}", file, _NO_SOURCES)
        elif peer == "rostopic hz":
            bare = Process(["rostopic", "hz", BARE], target.variables)
        else:
            bare = target.peer(peer, question.topics)
        node = target.node("alert_system", f"watching_{question.topics}", question.remap, file)
        contestants = {BARE: bare, WATCHED: node}
        feeding = target.peer(question.publisher, question.topics)
        for process in (*contestants.values(), feeding):
            running.enter_context(process)
        feeding.ask(f"{question.rate_hz} {SLICE_S}")
        for _ in range(rounds):
            begin_s = {name: process.cpu_s() for name, process in contestants.items()}
            sent = int(feeding.ask(f"{question.rate_hz} {SLICE_S}"))
            time.sleep(SETTLE_S)
            for name, process in contestants.items():
                cost_us[name].append((process.cpu_s() - begin_s[name]) / sent * 1e6)
    return cost_us


EMPTY, COMPOSED = "empty node", "health_monitor (composed)"


def footprint(target: Target, measure_s: float = 40.0) -> Iterator[Row]:
    """Memory and CPU of the nodes at the default rates, compared with a node that does nothing.

    A bare node publishes and receives three numbers at the same rate, for comparison: on a virtual machine whose host
    reclaims idle memory, this alone can exceed the limit for health_monitor.
    """
    with contextlib.ExitStack() as running:
        processes = {
            EMPTY: running.enter_context(target.peer("empty")),
            "bare node, same topics": running.enter_context(target.peer("exercise")),
            COMPOSED: running.enter_context(target.node("health_monitor", "composed")),
        }
        for name in ("battery_sensor", "aggregator", "alert_system"):
            processes[name] = running.enter_context(target.node(name, "separate"))
        time.sleep(10.0)
        begin_s = time.monotonic()
        used_s = {name: process.cpu_s() for name, process in processes.items()}
        time.sleep(measure_s)
        used_s = {name: process.cpu_s() - used_s[name] for name, process in processes.items()}
        took_s = time.monotonic() - begin_s
        memories = {
            "resident memory": {name: process.resident_mb() for name, process in processes.items()},
            "private memory": {name: process.own_mb() for name, process in processes.items()},
        }
    for what, memory_mb in memories.items():
        for name, megabytes in memory_mb.items():
            required, remark = 1.25 if name == COMPOSED else None, "" if name == EMPTY else "to the empty node"
            ratio = megabytes / memory_mb[EMPTY]
            yield Row(f"{target.name}, {what}", name, f"{megabytes:.1f} MB", ratio, required, remark)
    for name, used in used_s.items():
        percent, required = 100.0 * used / took_s, 1.0 if name == COMPOSED else None
        yield Row(f"{target.name}, CPU", name, f"{percent:.2f} %", percent, required, "to 1 % of a core")
