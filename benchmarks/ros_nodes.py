"""The nodes on ROS: CPU per message beside bare subscribers, memory and CPU at rest, and what reading the graph costs.

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
from typing import Any, Iterator, Mapping, NamedTuple

from benchmarks.processes import Process, Target, alert_system, write_yaml
from benchmarks.ros_peers import BARE, GRAPH, STATUSES, WATCHED, topics_below
from benchmarks.table import ROOT, Row, beside, within

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
    signals: Mapping[str, Any] | None
    """None: those of the default configuration."""
    required: Mapping[str, Mapping[str, float]]
    """By middleware: the largest ratio to each bare peer."""
    topics: int = 1
    rate_hz: float = 1000.0
    """Messages per second over all topics."""
    remap: str = ""
    recorded: bool = False
    """Whether the node keeps the bytes of the topics in a black box."""
    publisher: str = "publisher"


def _on_both(peer: str, required: float) -> Mapping[str, Mapping[str, float]]:
    return {"ros1": {peer: required}, "ros2": {peer: required}}


_FLOAT32 = {"type": "std_msgs/Float32"}
_MESSAGES = _Question(
    "one message at 1 kHz",
    None,
    {
        "ros1": {"subscriber": 1.35, "without sources": 1.03},
        "ros2": {"subscriber": 0.35, "events_subscriber": 1.15, "without sources": 1.03},
    },
    remap=f"battery_level:={WATCHED}",
)
_FREQUENCY = _Question(
    "frequency of one topic at 1 kHz",
    {"arrivals": {"topic": WATCHED, **_FLOAT32, "field": "", "statistic": "frequency_hz", "warn_below": 100.0}},
    {"ros1": {"rostopic hz" if shutil.which("rostopic") else "subscriber": 1.0}, "ros2": {"subscriber": 1.2}},
)
_MANY_TOPICS = _Question(
    "100 topics at 10 Hz each",
    {
        f"level_{number}": {"topic": topic, **_FLOAT32, "warn_below": 20.0, "error_below": 10.0}
        for number, topic in enumerate(topics_below(WATCHED, 100))
    },
    _on_both("subscriber", 1.3),
    topics=100,
)
_STATUSES = _Question(
    f"{STATUSES} statuses at 10 Hz",
    {"drivers": {"topic": WATCHED, "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'}},
    _on_both("diagnostics_subscriber", 1.5),
    rate_hz=10.0,
    publisher="diagnostics_publisher",
)
_BLACK_BOX = _Question(
    "black box of 10 topics at 100 Hz each",
    {"other": {"topic": "other", **_FLOAT32, "stale_after_s": 0.0}},
    _on_both("raw_subscriber", 1.3),
    topics=10,
    recorded=True,
)
QUESTIONS = {
    "messages": [_MESSAGES], "signals": [_FREQUENCY, _MANY_TOPICS], "statuses": [_STATUSES], "black_box": [_BLACK_BOX],
}  # fmt: skip
"""By part of the page."""


def compare(target: Target, part: str, rounds: int = 20) -> Iterator[Row]:
    """Yields the CPU time per message beside each bare peer of the questions of a part."""
    for question in QUESTIONS[part]:
        for peer, required in question.required[target.package].items():
            cost_us = _measure(target, question, peer, rounds)
            figures = {NAMES[peer]: cost_us[BARE], "alert_system": cost_us[WATCHED]}
            yield from beside(f"{target.name}, {question.what}", figures, "us", required, ", per message")


def _measure(
    target: Target, question: _Question, peer: str, rounds: int, slice_s: float = 3.0
) -> dict[str, list[float]]:
    """Returns the CPU time per message in each slice but the first, which fills the windows; in us."""
    cost_us: dict[str, list[float]] = {BARE: [], WATCHED: []}
    with contextlib.ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
        file = ROOT / "config" / "thresholds.yaml"
        if question.signals is not None:
            file = folder / "thresholds.yaml"
            recorded = {"folder": str(folder), "topics": topics_below(WATCHED, question.topics)}
            ops = str(folder / "ops.yaml") if question.recorded else ""
            write_yaml(folder, thresholds=alert_system(question.signals, ops=ops), ops={"black_box": recorded})
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
        feeding.ask(f"{question.rate_hz} {slice_s}")
        for _ in range(rounds):
            begin_s = {name: process.cpu_s() for name, process in contestants.items()}
            sent = int(feeding.ask(f"{question.rate_hz} {slice_s}"))
            time.sleep(SETTLE_S)
            for name, process in contestants.items():
                cost_us[name].append((process.cpu_s() - begin_s[name]) / sent * 1e6)
    return cost_us


EMPTY, COMPOSED = "empty node", "health_monitor (composed)"


def footprint(target: Target, part: str = "", measure_s: float = 40.0) -> Iterator[Row]:
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
        percent = _percent(processes, measure_s)
        memory_mb = {name: process.own_mb() for name, process in processes.items()}
    for name, megabytes in memory_mb.items():
        ratio, required = megabytes / memory_mb[EMPTY], 1.25 if name == COMPOSED else None
        yield Row(f"{target.name}, private memory", name, f"{megabytes:.1f} MB", ratio, required, "to the empty node")
    for name, used in percent.items():
        row = within(f"{target.name}, CPU", name, used, 1.0, "% of a core", digits=2)
        yield row if name == COMPOSED else row._replace(required=None)


def _percent(processes: Mapping[str, Process], seconds: float) -> dict[str, float]:
    """Returns the CPU time per second of each process during the next seconds, in %."""
    begin_s, used_s = time.monotonic(), {name: process.cpu_s() for name, process in processes.items()}
    time.sleep(seconds)
    took_s = time.monotonic() - begin_s
    return {name: 100.0 * (process.cpu_s() - used_s[name]) / took_s for name, process in processes.items()}


def graph(target: Target, part: str = "", rounds: int = 5) -> Iterator[Row]:
    """CPU time of reading the graph on a robot with 100 nodes and 300 topics.

    Two alert_systems run side by side: one watches ten nodes, ten topics' publishers and a pattern of subscribers, the
    other a topic. What the first takes more is the graph's.
    """
    signals: dict[str, Any] = {f"node_{at}": {"node": f"/robot/node_{at}"} for at in range(10)}
    signals.update((f"topic_{at}", {"publishers": f"/robot/topic_{at}_0"}) for at in range(10))
    signals["heard"] = {"subscribers": "/robot/topic_1*_1", "error_below": 0}
    level = {"topic": "/level", "stale_after_s": 0.0}
    with contextlib.ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
        write_yaml(folder, graph=alert_system(signals), without=alert_system({"level": level}))
        robot = running.enter_context(target.peer("robot"))
        processes = {
            name: running.enter_context(target.node("alert_system", name, parameters=folder / f"{name}.yaml"))
            for name in ("without", "graph")
        }
        time.sleep(15.0)
        slices = [_percent(processes, 10.0) for _ in range(rounds)]
        robot.require_running()
    more_ms = statistics.median(10.0 * (each["graph"] - each["without"]) for each in slices)
    nodes, topics = GRAPH
    what = f"{target.name}, a second of reading a graph of {nodes} nodes and {nodes * topics} topics"
    yield within(what, "alert_system", more_ms, 5.0, "ms", "CPU time", digits=1)
