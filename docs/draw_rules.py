"""Draws docs/rules.svg and docs/silence.svg from the real core.

The first is a value, its bounds and the resulting states over time, the second a node that dies and comes back.

    python docs/draw_rules.py            # needs matplotlib

It also prints the transitions, which docs/rules.md quotes.
"""

from __future__ import annotations

import itertools
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, Mapping, Sequence, Tuple

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from robot_health_monitor.core import Level, Monitor, Sample, Transition, load_config

SIGNAL = "battery_level"
SETTINGS: Mapping[str, Any] = {
    "unit": "%", "valid_min": 0.0, "valid_max": 100.0, "warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0,
    "for_s": 5.0, "stale_after_s": 5.0,
}  # fmt: skip
COLOURS = {Level.OK: "#7fbf7b", Level.WARN: "#fdc44f", Level.ERROR: "#e0584f", Level.STALE: "#9e9e9e"}
CORNERS = [
    (0, 30.0), (20, 24.0), (21, 17.5), (24, 17.5), (25, 23.5), (35, 19.5), (50, 12.0), (58, 8.0), (68, 8.0),
    (75, 13.0), (90, 21.0), (95, 21.0), (100, 23.0), (170, 37.0),
]  # fmt: skip
"""(s, %): a driving robot sags under load at 21 s, discharges, and is charged from 68 s on."""
SILENT = range(112, 125)
NOT_A_NUMBER = range(140, 146)
END_S = 160


Steps = Iterator[Tuple[int, Mapping[str, Level], Sequence[Transition]]]
"""Time, level of each signal after it, and transitions, second by second."""


@contextmanager
def _picture(name: str, height: float, levels: Iterable[Level], **legend: Any) -> Iterator[Any]:
    """Gives the axes to draw on; then adds the legend of the levels and writes the picture."""
    from matplotlib import rcParams
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    rcParams.update({"svg.hashsalt": name, "font.family": "DejaVu Sans", "font.size": 9})
    figure = Figure(figsize=(10, height), layout="constrained")
    axes = figure.subplots()
    yield axes
    handles = [Patch(color=COLOURS[level], alpha=0.5, label=level.name) for level in levels]
    axes.legend(handles=handles, loc="upper left", ncols=len(handles), frameon=False, **legend)
    figure.savefig(Path(__file__).with_name(f"{name}.svg"), metadata={"Date": None, "Creator": None})


def _steps(monitor: Monitor, end_s: int, observe: Callable[[int], Iterable[Transition]]) -> Steps:
    """Lets a monitor observe something and tick once per second."""
    for now_s in range(end_s + 1):
        transitions = [*observe(now_s), *monitor.tick(float(now_s))]
        statuses = monitor.report(float(now_s)).statuses
        yield now_s, {name: status.level for name, status in statuses.items()}, transitions


def value_at(now_s: int) -> float:
    """Returns the battery level at a time, in %; NaN without one."""
    if now_s in SILENT or now_s in NOT_A_NUMBER:
        return float("nan")
    (left_s, left), (right_s, right) = next(pair for pair in zip(CORNERS, CORNERS[1:]) if now_s <= pair[1][0])
    return left + (right - left) * (now_s - left_s) / (right_s - left_s)


def run() -> Steps:
    """Returns what becomes of the battery, with one sample per second."""
    monitor = Monitor(load_config({"signals": {SIGNAL: SETTINGS}}))

    def observe(now_s: int) -> Sequence[Transition]:
        return () if now_s in SILENT else monitor.observe(Sample(SIGNAL, value_at(now_s), float(now_s)))

    return _steps(monitor, END_S, observe)


def lines() -> list[str]:
    """Returns the numbered transitions."""
    transitions = [transition for _, _, of_step in run() for transition in of_step]
    return [f"{number:2} {each.now_s:6.1f} s  {each.text}" for number, each in enumerate(transitions, 1)]


def draw() -> None:
    """Writes docs/rules.svg."""
    steps = list(run())
    with _picture("rules", 4.6, COLOURS, bbox_to_anchor=(0.0, 0.97)) as axes:
        for now_s, levels, _ in steps[:-1]:
            axes.axvspan(now_s, now_s + 1, color=COLOURS[levels[SIGNAL]], alpha=0.35, linewidth=0)
        axes.plot(range(END_S + 1), [value_at(now_s) for now_s in range(END_S + 1)], color="#1f2933", linewidth=1.6)
        for name, colour in (("warn_below", "#b07d00"), ("error_below", "#a32018")):
            bound, clears = SETTINGS[name], SETTINGS[name] + SETTINGS["hysteresis"]
            axes.axhline(bound, color=colour, linewidth=1.0)
            axes.axhline(clears, color=colour, linewidth=0.8, linestyle=(0, (4, 3)))
            axes.text(END_S - 0.5, bound - 1.2, f"{name}: {bound:g} %", color=colour, ha="right", va="center")
            axes.text(END_S - 0.5, clears + 1.0, "clears (hysteresis 2 %)", color=colour, ha="right", va="center")
        line = {"arrowstyle": "-", "lw": 0.7}
        axes.annotate("sag: 4 s,\nless than for_s", (22.5, 17.5), (10.0, 15.0), arrowprops=line, ha="center")
        axes.text(SILENT[0] + 6.5, 33.5, "no samples", ha="center")
        axes.text(NOT_A_NUMBER[0] + 3, 37.5, "NaN", ha="center")
        changes_s = [now_s for now_s, _, transitions in steps for _ in transitions]
        for number, now_s in enumerate(changes_s, 1):
            axes.axvline(now_s, color="#1f2933", linewidth=0.6, linestyle=":")
            axes.text(now_s, 41.2, str(number), ha="center", va="bottom", fontweight="bold")
        axes.set(xlim=(0, END_S), ylim=(5, 41), xlabel="time in s", ylabel="battery_level in %")


NODE = {
    "joint_left": "/joint_states", "joint_right": "/joint_states", "joint_lift": "/joint_states", "scan": "/scan",
    "imu": "/imu", "odom": "/odom",
}  # fmt: skip
"""The signals of the node that dies, with their topics."""
DEAD = range(101, 130)
NODE_END_S = 150


def run_node() -> Steps:
    """Returns what becomes of the node, with one message of each topic per second."""
    monitor = Monitor(load_config({"signals": {name: {"topic": topic} for name, topic in NODE.items()}}))
    monitor.expect_sources()

    def observe(now_s: int) -> Iterator[Transition]:
        for topic in () if now_s in DEAD else dict.fromkeys(NODE.values()):
            yield from monitor.observe_source(topic, float(now_s))
            for name in (name for name, read in NODE.items() if read == topic):
                yield from monitor.observe(Sample(name, 1.0, float(now_s)))

    return _steps(monitor, NODE_END_S, observe)


def node_lines() -> list[str]:
    """Returns the transitions of the node."""
    return [f"{each.now_s:7.3f} {each.text}" for _, _, of_step in run_node() for each in of_step]


def draw_node() -> None:
    """Writes docs/silence.svg."""
    first_s, names = 90, list(NODE)
    with _picture("silence", 3.2, (Level.OK, Level.STALE)) as axes:
        for now_s, levels, transitions in itertools.islice(run_node(), first_s, NODE_END_S):
            for row, name in enumerate(names):
                axes.barh(row, 1, 0.8, now_s, align="center", color=COLOURS[levels[name]], alpha=0.5, linewidth=0)
            for transition in transitions:
                axes.axvline(now_s, color="#1f2933", linewidth=1.0)
                text = transition.text.partition(":")[0]
                axes.text(now_s + 0.4, -0.75, text, ha="left", va="bottom", fontweight="bold")
        axes.axvspan(DEAD.start, DEAD.stop, ymax=0.04, color="#a32018", linewidth=0)
        axes.text((DEAD.start + DEAD.stop) / 2, 5.85, "the node is dead", ha="center", color="#a32018")
        axes.set(xlim=(first_s, NODE_END_S), ylim=(6.25, -1.4), xlabel="time in s")
        axes.set_yticks(range(len(names)), [f"{name}  ({NODE[name]})" for name in names])


if __name__ == "__main__":
    draw()
    draw_node()
    print("\n".join([*lines(), *node_lines()]))
