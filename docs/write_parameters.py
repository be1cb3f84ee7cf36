"""Writes docs/reference/parameters.md from the tables of parameters in the code.

    python docs/write_parameters.py

Run it after a change of a table; a test compares the page with the tables.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Iterable, Iterator

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from robot_health_monitor.core.config import MONITOR_PARAMETERS, NODE_PARAMETERS
from robot_health_monitor.core.nodes.aggregator import AGGREGATOR_PARAMETERS
from robot_health_monitor.core.nodes.battery_sensor import SENSOR_PARAMETERS
from robot_health_monitor.core.parameters import Parameter
from robot_health_monitor.core.sensors import configuration as sensing
from robot_health_monitor.core.signal_config import CONDITION_PARAMETERS, SIGNAL_PARAMETERS

PAGE = Path(__file__).resolve().parent / "reference" / "parameters.md"

INTRODUCTION = """# Parameters

All parameters of the three nodes, for `thresholds.yaml` on every middleware, for `rosparam` and for `ros2 param`.
Values in the column *default* apply to keys that are left out; an empty default means that the feature is disabled or
the text is empty. `robot-health check FILE` reports every mistake in a file. The files in [config](../../config) are
complete examples.

This page is made by `python docs/write_parameters.py`.
"""


def page() -> str:
    """Returns the text of the page."""
    return "\n".join((INTRODUCTION, *_sections()))


def _sections() -> Iterator[str]:
    yield from _section(
        "## Signals of alert_system",
        "Under `alert_system: ros__parameters: signals: NAME:`. A name consists of letters, digits and `_`; `link` and"
        " `monitor` are reserved.\n[signals.md](../signals.md) explains how to watch any signal,"
        " [rules.md](../rules.md) how levels are determined.",
        SIGNAL_PARAMETERS,
    )
    yield from _section(
        "### Conditions on another signal",
        "Under `only_if` and `latch_release_if` of a signal: `signal` and one comparison. The signal may be `link`.",
        CONDITION_PARAMETERS,
    )
    yield from _section("## All nodes", "Under `NODE: ros__parameters:`.", NODE_PARAMETERS)
    yield from _section("## alert_system", "", _own(MONITOR_PARAMETERS))
    yield from _section("## aggregator", "", _own(AGGREGATOR_PARAMETERS))
    metrics = [
        replace(parameter, name=f"{metric}.{parameter.name}")
        for metric, parameters in sensing.METRIC_PARAMETERS.items()
        for parameter in parameters
    ]
    yield from _section("## battery_sensor", "", [*_own(SENSOR_PARAMETERS), *metrics])
    yield "Its section `host` adds metrics of the computer (memory, disks, cores): [signals.md](../signals.md).\n"


def _own(parameters: Iterable[Parameter]) -> Iterator[Parameter]:
    return (parameter for parameter in parameters if parameter not in NODE_PARAMETERS)


def _section(heading: str, text: str, parameters: Iterable[Parameter]) -> Iterator[str]:
    yield f"{heading}\n"
    if text:
        yield f"{text}\n"
    yield "| key | value | default | meaning |\n|---|---|---|---|"
    for parameter in parameters:
        yield f"| `{parameter.name}` | {parameter.allowed} | {_default(parameter.default)} | {parameter.description} |"
    yield ""


def _default(default: Any) -> str:
    if default is None or default in ("", ()):
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, tuple):
        return f"`[{', '.join(map(str, default))}]`"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
