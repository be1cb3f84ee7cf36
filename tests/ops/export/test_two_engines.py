"""Prometheus, and vmalert over VictoriaMetrics, evaluate the same file over the same levels: the same alerts."""

from __future__ import annotations

import json
import time
import urllib.parse
from pathlib import Path
from typing import Sequence

import pytest
from harness.alertmanager import needs_alertmanager
from harness.prometheus_server import needs_prometheus
from harness.pushing_fleet import PushingFleet, Scraped, get, pushing_fleet, until
from harness.reserved import free_port
from harness.victoria_metrics import needs_victoria_metrics

from robot_health_monitor.core import load_config

pytestmark = [needs_prometheus, needs_alertmanager, needs_victoria_metrics, pytest.mark.newest_python]
STEP_S = 8.0
"""Length of each level: longer than what the engines differ by."""
TIMELINES: dict[str, Sequence[int]] = {
    "battery": (0, 1, 2, 0, 0),
    "link": (0, 2, 2, 2, 0),
    "scan": (0, 3, 0, 3, 0),
}
EXPECTED = {
    ("battery", "WARN"): [(1, 2)],
    ("battery", "ERROR"): [(2, 3)],
    ("link", "ERROR"): [(1, 4)],
    ("scan", "STALE"): [(1, 2), (3, 4)],
}
"""When alerts begin and end, in steps."""


def exposition(step: int) -> bytes:
    """Returns the metrics of a monitor, as /metrics?profile=fleet words them."""
    lines = [
        f'robot_health_{metric}{{robot="r1",signal="{signal}"}} {levels[min(step, len(levels) - 1)]}'
        for signal, levels in TIMELINES.items()
        for metric in ("alert_level", "value")
    ]
    lines.append(f'robot_health_last_tick_timestamp_seconds{{robot="r1"}} {time.time()}')
    return "\n".join(lines).encode() + b"\n"


def episodes(fleet: PushingFleet, begin_s: float, end_s: float) -> dict[tuple[str, str], list[tuple[float, float]]]:
    """Returns when each alert fired, in s after the begin."""
    query = {"query": 'ALERTS{alertstate="firing"}', "start": begin_s, "end": end_s, "step": 1, "nocache": 1}
    answer = json.loads(get(f"http://127.0.0.1:{fleet.port}/api/v1/query_range?{urllib.parse.urlencode(query)}"))
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for series in answer["data"]["result"]:
        key = (series["metric"]["signal"], series["metric"]["level"])
        times = [time_s - begin_s for time_s, _ in series["values"]]
        for time_s in times:
            last: tuple[float, float] | None = found[key][-1] if found.get(key) else None
            if last is not None and time_s - last[1] <= 5.0:
                found[key][-1] = (last[0], time_s)
            else:
                found.setdefault(key, []).append((time_s, time_s))
    return found


def test_prometheus_and_vmalert_raise_the_same_alerts_and_none_too_early(tmp_path: Path) -> None:
    config = load_config({"signals": {"battery": {"warn_below": 20.0}}})
    began_s: list[float] = []
    robot = Scraped(lambda: exposition(int((time.monotonic() - began_s[0]) / STEP_S) if began_s else 0))
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
    with pushing_fleet(tmp_path / "one", config, free_port) as one, pushing_fleet(
        tmp_path / "other", config, free_port
    ) as other:
        for fleet, units, agent in (
            (one, ["prometheus"], "agent"),
            (other, ["victoria-metrics", "vmalert"], "vmagent"),
        ):
            for unit in ("alertmanager", *units):
                fleet.start(unit)
            fleet.start_agent("agent", [robot.address], unit=agent)
        for fleet in (one, other):
            until(lambda fleet=fleet: fleet.by_label("robot_health_value", "signal"))  # type: ignore[misc]
        began_s.append(time.monotonic())
        wall_s = time.time()
        until(lambda: time.monotonic() - began_s[0] > 5 * STEP_S, limit_s=6 * STEP_S)
        found = {fleet: episodes(fleet, wall_s, wall_s + 5 * STEP_S - 1.0) for fleet in (one, other)}
    robot.end()

    for fleet, seen in found.items():
        name = "Prometheus" if fleet is one else "VictoriaMetrics"
        assert set(seen) == set(EXPECTED), (name, seen)
        for key, expected in EXPECTED.items():
            assert len(seen[key]) == len(expected), (name, key, seen[key])
            for (begin, end), (begin_s, end_s) in zip(expected, seen[key]):
                # How much later depends on the machine.
                assert begin * STEP_S - 1.0 <= begin_s, (name, key, seen[key])
                assert end * STEP_S - 3.0 <= end_s, (name, key, seen[key])
