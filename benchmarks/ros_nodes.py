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
import json
import os
import statistics
import subprocess
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any, Iterator, Mapping, NamedTuple

from harness.reserved import free_port, ros2_domain

from benchmarks.processes import Process, alert_system, compile_source, cpu_s, pause, write_yaml
from benchmarks.ros_peers import BARE, GRAPH, STATUSES, WATCHED, topics_below
from benchmarks.table import ROOT, Row, beside, side_by_side, within

SLICE_S = 3.0
SUBSCRIBER, EVENTS = "bare subscriber", "bare subscriber, EventsExecutor"
OF_BYTES, OF_STATUSES = "bare subscriber of bytes", "bare subscriber of statuses"
ROSTOPIC, ALONE = "rostopic hz", "alert_system without sources"
_NO_SOURCES = (
    "from robot_health_monitor.core.judge.monitor import Monitor; Monitor.expect_sources = lambda self, names: None; "
)
"""Code that makes an alert node take each signal by itself: the topics of its signals are not watched."""


class _Target(NamedTuple):
    """One middleware, ready to run nodes."""

    name: str
    python: str
    variables: dict[str, str]
    package: str
    """`ros1` or `ros2`."""

    def node(
        self, executable: str, namespace: str, parameters: Path | None = None, *remap: str, first: str = ""
    ) -> Process:
        """Starts one of this project's executables, with the file of its configuration and `remap` (`old:=new`).

        `first` is code that runs before it.
        """
        module = f"robot_health_monitor.cli.{self.package}_executables"
        code = f"{first}import sys; from {module} import {executable} as main; sys.exit(main())"
        arguments = [f"__ns:=/{namespace}", *remap]
        if self.package == "ros2":
            arguments = ["--ros-args", *(word for argument in arguments for word in ("-r", argument))]
            if parameters is not None:
                arguments += ["--params-file", str(parameters)]
        elif parameters is not None:
            load = ["rosparam", "load", str(parameters), f"/{namespace}"]
            subprocess.run(load, env=self.variables, check=True, stdout=subprocess.DEVNULL)
        return Process([self.python, "-c", code, *arguments], self.variables)

    def peer(self, role: str, topics: int = 1) -> Process:
        """Starts one of the peers with a number of topics."""
        command = [self.python, "-m", "benchmarks.ros_peers", self.package, role, topics]
        return Process(command, self.variables, answers=True)


@contextlib.contextmanager
def _prepared(package: str, python: str, variables: dict[str, str]) -> Iterator[_Target]:
    """Prepares ROS 1 with a master on a free port, or ROS 2 in a free domain, on this machine only."""
    compile_source(python)
    path = os.pathsep.join(filter(None, [str(ROOT), variables.get("PYTHONPATH", "")]))
    variables = {**variables, "PYTHONPATH": path}
    if package == "ros2":
        variables.update(ROS_DOMAIN_ID=str(ros2_domain("")), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        yield _Target("ROS 2", python, variables, package)
        return
    port = free_port()
    variables.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1")
    with Process(["roscore", "-p", port], variables) as core:
        core.wait_for_port(port)
        yield _Target("ROS 1", python, variables, package)


def rows(part: str) -> Iterator[Row]:
    """Yields the rows of a part for ROS 1 and for ROS 2, or a row with the reason why there are none.

    The variable BENCHMARK_TARGETS, which noxfile.py sets, holds the interpreter and the variables of each.
    """
    measure = {"footprint": _footprint, "graph": _graph}.get(part)
    for package, available in json.loads(os.environ["BENCHMARK_TARGETS"]).items():
        try:
            with _prepared(package, **available) as target:
                yield from measure(target) if measure else _compare(target, part)
        except (OSError, RuntimeError) as problem:
            yield Row(f"{package}, {part}", "", remark=str(problem))


class _Question(NamedTuple):
    """What is compared with what."""

    part: str
    """Of the page."""
    what: str
    signals: Mapping[str, Any]
    """Empty: those of the default configuration."""
    ros1: Mapping[str, float]
    """The largest ratio to each bare peer."""
    ros2: Mapping[str, float]
    topics: int = 1
    rate_hz: float = 1000.0
    """Messages per second over all topics."""


_FLOAT32 = {"type": "std_msgs/Float32"}
_ARRIVALS = {"topic": WATCHED, **_FLOAT32, "field": "", "statistic": "frequency_hz", "warn_below": 100.0}
_LEVELS = {
    f"level_{number}": {"topic": topic, **_FLOAT32, "warn_below": 20.0, "error_below": 10.0}
    for number, topic in enumerate(topics_below(WATCHED, 100))
}
_DRIVERS = {"topic": WATCHED, "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'}
_OTHER = {"topic": "other", **_FLOAT32, "stale_after_s": 0.0}
_ROS1 = {SUBSCRIBER: 1.35, ALONE: 1.03}
_ROS2 = {SUBSCRIBER: 0.35, EVENTS: 1.15, ALONE: 1.03}
_MANY, _STATUSES, _BYTES = {SUBSCRIBER: 1.3}, {OF_STATUSES: 1.5}, {OF_BYTES: 1.3}
_HZ1, _HZ2 = {ROSTOPIC: 1.0}, {SUBSCRIBER: 1.2}
QUESTIONS = (
    _Question("messages", "one message at 1 kHz", {}, _ROS1, _ROS2),
    _Question("signals", "frequency of one topic at 1 kHz", {"arrivals": _ARRIVALS}, _HZ1, _HZ2),
    _Question("signals", "100 topics at 10 Hz each", _LEVELS, _MANY, _MANY, 100),
    _Question("statuses", f"{STATUSES} statuses at 10 Hz", {"drivers": _DRIVERS}, _STATUSES, _STATUSES, rate_hz=10.0),
    _Question("black_box", "black box of 10 topics at 100 Hz each", {"other": _OTHER}, _BYTES, _BYTES, 10),
)


def _compare(target: _Target, part: str, rounds: int = 20) -> Iterator[Row]:
    """Yields the CPU time per message beside each bare peer of the questions of a part."""
    for question in QUESTIONS:
        if question.part != part:
            continue
        for peer, required in getattr(question, target.package).items():
            with contextlib.ExitStack() as running:
                folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
                processes = {
                    peer: running.enter_context(_bare(target, question, peer)),
                    "alert_system": running.enter_context(_node(target, question, folder)),
                }
                publishing = "publisher of statuses" if part == "statuses" else "publisher"
                publisher = running.enter_context(target.peer(publishing, question.topics))
                send = partial(publisher.send, f"{question.rate_hz} {SLICE_S}")
                used_s = side_by_side(partial(cpu_s, processes, send), rounds)
            yield from beside(f"{target.name}, {question.what}", used_s, "us", required, ", per message")


def _bare(target: _Target, question: _Question, peer: str) -> Process:
    """Starts what the alert node is compared with."""
    if peer == ROSTOPIC:
        return Process(["rostopic", "hz", BARE], target.variables)
    if peer == ALONE:
        return target.node("alert_system", "alone", None, f"battery_level:={BARE}", first=_NO_SOURCES)
    return target.peer(peer, question.topics)


def _node(target: _Target, question: _Question, folder: Path) -> Process:
    """Starts the alert node; that of the black box keeps the bytes of all topics."""
    file = folder / "thresholds.yaml" if question.signals else None
    recorded = {"folder": str(folder), "topics": topics_below(WATCHED, question.topics)}
    ops = str(folder / "ops.yaml") if question.part == "black_box" else ""
    write_yaml(folder, thresholds=alert_system(question.signals, ops=ops), ops={"black_box": recorded})
    return target.node("alert_system", f"watching_{question.topics}", file, f"battery_level:={WATCHED}")


EMPTY, COMPOSED = "empty node", "health_monitor (composed)"


def _footprint(target: _Target, rounds: int = 4) -> Iterator[Row]:
    """Memory and CPU of the nodes at the default rates, compared with a node that does nothing."""
    with contextlib.ExitStack() as running:
        processes = {EMPTY: running.enter_context(target.peer(EMPTY))}
        processes[COMPOSED] = running.enter_context(target.node("health_monitor", "composed"))
        for name in ("battery_sensor", "aggregator", "alert_system"):
            processes[name] = running.enter_context(target.node(name, "separate"))
        used = side_by_side(partial(cpu_s, processes, partial(pause, 10.0)), rounds)
        own = {name: [process.own_bytes()] for name, process in processes.items()}
    yield from beside(f"{target.name}, private memory", own, "MB", {COMPOSED: 1.25})
    for name, shares in used.items():
        row = within(f"{target.name}, CPU", name, statistics.fmean(shares), 1.0, "% of a core")
        yield row if name == COMPOSED else row._replace(required=None)


def _graph(target: _Target, rounds: int = 5) -> Iterator[Row]:
    """CPU time of reading the graph on a robot with 100 nodes and 300 topics.

    Two alert_systems run side by side: one watches ten nodes, ten topics' publishers and a pattern of subscribers, the
    other a topic. What the first takes more is the graph's.
    """
    signals: dict[str, Any] = {f"node_{at}": {"node": f"/robot/node_{at}"} for at in range(10)}
    signals.update((f"topic_{at}", {"publishers": f"/robot/topic_{at}_0"}) for at in range(10))
    signals["heard"] = {"subscribers": "/robot/topic_1*_1", "error_below": 0}
    watched = {"without": {"level": {"topic": "/level", "stale_after_s": 0.0}}, "graph": signals}
    with contextlib.ExitStack() as running:
        folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
        write_yaml(folder, **{name: alert_system(each) for name, each in watched.items()})
        robot = running.enter_context(target.peer("robot"))
        processes = {
            name: running.enter_context(target.node("alert_system", name, folder / f"{name}.yaml")) for name in watched
        }
        time.sleep(5.0)
        used = side_by_side(partial(cpu_s, processes, partial(pause, 10.0)), rounds)
        robot.require_running()
    more_s = statistics.median(graph - without for without, graph in zip(*used.values()))
    what = f"{target.name}, a second of reading a graph of {GRAPH[0]} nodes and {GRAPH[0] * GRAPH[1]} topics"
    yield within(what, "alert_system", more_s, 5.0, "ms", "CPU time")
