"""CPU per message of the alert node, beside a bare subscriber that receives the same messages at the same time.

Other load on the machine affects both alike. Neither ever pauses: after a second of idleness, caches (on a virtual
machine even the host's memory) no longer hold a process, and reloading it would count as its cost.

The alert node is the executable as launched; the bare subscribers count. On ROS 2, `subscriber` is on the
SingleThreadedExecutor, which most nodes use, and all others are on the EventsExecutor, which the alert node chooses
where it works. `rostopic hz` is there for ROS 1 only: no package index has `ros2 topic hz`.
"""

from __future__ import annotations

import contextlib
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, NamedTuple, Tuple

from benchmarks.pacing import BARE, STATUSES, WATCHED, topics_below
from benchmarks.table import Row, median_ratio
from benchmarks.targets import ROOT, Process, Target

ROUNDS = 20
SLICE_S = 3.0
_NO_SOURCES = (
    "from robot_health_monitor.core.judge.monitor import Monitor; Monitor.expect_sources = lambda self, names: None; "
)
"""Code that makes an alert node take each signal by itself: the topics of its signals are not watched."""
SETTLE_S = 0.2
"""Time for messages in flight at the end of a slice."""

THRESHOLDS = (ROOT / "config" / "thresholds.yaml").read_text("utf-8")
BLACK_BOX_TOPICS = topics_below(WATCHED, 10)


def signals(*lines: str, ops: str = "") -> str:
    """Returns a thresholds.yaml with signals."""
    parameters = [f"    ops: {ops}"] if ops else []
    return "\n".join(
        ["alert_system:", "  ros__parameters:", *parameters, "    signals:", *(f"      {x}" for x in lines)]
    )


class Question(NamedTuple):
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


NAMES = {
    "without sources": "alert_system without sources",
    "subscriber": "bare subscriber",
    "events_subscriber": "bare subscriber, EventsExecutor",
    "rostopic hz": "rostopic hz",
    "raw_subscriber": "bare subscriber of bytes",
    "diagnostics_subscriber": "bare subscriber of statuses",
}
MESSAGE = Question(
    "one message at 1 kHz",
    THRESHOLDS,
    {
        "ros1": {"subscriber": 1.35, "without sources": 1.03},
        "ros2": {"subscriber": 0.35, "events_subscriber": 1.15, "without sources": 1.03},
    },
    remap=f"battery_level:={WATCHED}",
)
FREQUENCY = Question(
    "frequency of one topic at 1 kHz",
    signals(
        f'arrivals: {{topic: {WATCHED}, type: std_msgs/Float32, field: "", statistic: frequency_hz, warn_below: 100}}'
    ),
    {"ros1": {"rostopic hz": 1.0}, "ros2": {"subscriber": 1.2}},
)
HUNDRED = Question(
    "100 topics at 10 Hz each",
    signals(
        *(
            f"level_{number}: {{topic: {topic}, type: std_msgs/Float32, warn_below: 20.0, error_below: 10.0}}"
            for number, topic in enumerate(topics_below(WATCHED, 100))
        )
    ),
    {ros: {"subscriber": 1.3} for ros in ("ros1", "ros2")},
    topics=100,
)
DRIVERS = Question(
    f"{STATUSES} statuses at 10 Hz",
    signals(f"drivers: {{topic: {WATCHED}, type: diagnostic_msgs/DiagnosticArray, field: 'status[\"*\"]'}}"),
    {ros: {"diagnostics_subscriber": 1.5} for ros in ("ros1", "ros2")},
    rate_hz=10.0,
    publisher="diagnostics_publisher",
)
BLACK_BOX = Question(
    "black box of 10 topics at 100 Hz each",
    signals("other: {topic: other, type: std_msgs/Float32, stale_after_s: 0.0}", ops="{folder}/ops.yaml"),
    {ros: {"raw_subscriber": 1.3} for ros in ("ros1", "ros2")},
    topics=10,
    ops=f"black_box: {{folder: {{folder}}, topics: [{', '.join(BLACK_BOX_TOPICS)}]}}",
)


def rows(target: Target, *questions: Question, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    for question in questions:
        for peer, required in question.required[target.package].items():
            if peer == "rostopic hz" and not shutil.which("rostopic"):
                peer, required = "subscriber", 1.2
            of_bare, of_node, ratio = compare(target, question, peer, rounds)
            what = f"{target.name}, {question.what}"
            yield Row(what, NAMES[peer], of_bare)
            yield Row(what, "alert_system", of_node, ratio, required, f"to the {NAMES[peer]}, per message")


def compare(target: Target, question: Question, peer: str, rounds: int) -> Tuple[str, str, float]:
    """Feeds both slice after slice; the first slice warms up and fills the windows.

    Returns the median CPU time per message of the peer and of the node, as text, and the median of their ratios.
    """
    found: Dict[str, List[float]] = {BARE: [], WATCHED: []}
    with contextlib.ExitStack() as running:
        folder = running.enter_context(tempfile.TemporaryDirectory())
        thresholds = Path(folder, "thresholds.yaml")
        for file, text in ((thresholds, question.thresholds), (Path(folder, "ops.yaml"), question.ops)):
            file.write_text(text.replace("{folder}", folder))
        if peer == "without sources":
            bare = target.node("alert_system", "without_sources", f"battery_level:={BARE}", thresholds, _NO_SOURCES)
        elif peer == "rostopic hz":
            bare = target.tool("rostopic", "hz", BARE)
        else:
            bare = target.peer(peer, question.topics)
        contestants: Dict[str, Process] = {
            BARE: bare,
            WATCHED: target.node("alert_system", f"watching_{question.topics}", question.remap, thresholds),
        }
        feeding = target.peer(question.publisher, question.topics)
        for process in (*contestants.values(), feeding):
            running.callback(process.end)
        feeding.order(f"{question.rate_hz} {SLICE_S}")
        for _ in range(rounds):
            begin_s = {name: process.cpu_s() for name, process in contestants.items()}
            sent = feeding.order(f"{question.rate_hz} {SLICE_S}")
            time.sleep(SETTLE_S)
            for name, process in contestants.items():
                found[name].append((process.cpu_s() - begin_s[name]) / sent * 1e6)
    of_bare, of_node = (f"{statistics.median(values):.0f} us" for values in found.values())
    return of_bare, of_node, median_ratio(found[WATCHED], found[BARE])
