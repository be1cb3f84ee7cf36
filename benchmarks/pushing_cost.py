"""What a centre and an agent cost with 100 to 10,000 simulated robots that push, and whether a sample is lost.

    python3 -m benchmarks.pushing_cost ROBOTS [SCRAPES [prometheus|victoria-metrics]]

Ten signals per robot, scraped every 15 s. A target serves 100 robots in the text of /metrics?profile=fleet, and one
agent scrapes all targets: what it costs is what the agents of all robots cost together, without their processes.
After the last scrape, PromQL counts the samples of each metric: `lost` must be 0.
"""

from __future__ import annotations

import json
import re
import socket
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict, List, Sequence

import psutil
from harness.pushing_fleet import PushingFleet, Scraped, get, pushing_fleet, until

from robot_health_monitor.core.config.monitor_config import load_config

SIGNALS = 10
PER_TARGET = 100
INTERVAL_S = 15.0


def free_port() -> int:
    """Returns a free TCP port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def exposition(first: int, count: int) -> bytes:
    """Returns the metrics of robots; one in a thousand has a battery below its bound."""
    now_s = time.time()
    lines: List[str] = []
    for robot in range(first, first + count):
        for signal in range(SIGNALS):
            value = 5.0 if robot % 1000 == 7 and signal == 0 else 60.0 + (int(now_s) + robot + signal) % 7
            labels = f'{{robot="r{robot}",signal="signal_{signal}"'
            lines.append(f"robot_health_level{labels}}} 0")
            lines.append(f"robot_health_value{labels}}} {value}")
            lines.append(f"robot_health_alert_level{labels}}} {1 if value < 20.0 else 0}")
            lines.append(f"robot_health_data_valid{labels}}} 1")
            lines.append(f'robot_health_samples_total{labels},quality="good"}} {now_s:.0f}')
            lines.append(f'robot_health_samples_total{labels},quality="bad"}} 0')
        lines.append(f'robot_health_last_tick_timestamp_seconds{{robot="r{robot}"}} {now_s}')
    return "\n".join(lines).encode() + b"\n"


def measure(robots: int, scrapes: int, engine: str) -> Dict[str, object]:
    """Runs a fleet until each target was scraped so often; returns the figures."""
    config = load_config({"signals": {f"signal_{number}": {"warn_below": 20.0} for number in range(SIGNALS)}})
    targets = [
        Scraped(lambda first=first: exposition(first, min(PER_TARGET, robots - first)))
        for first in range(0, robots, PER_TARGET)
    ]
    units, agent = (["prometheus"], "agent") if engine == "prometheus" else (["victoria-metrics", "vmalert"], "vmagent")
    with tempfile.TemporaryDirectory() as folder, pushing_fleet(
        Path(folder), config, free_port, interval_s=INTERVAL_S
    ) as fleet:
        for unit in ("alertmanager", *units):
            fleet.start(unit)
        until(lambda: fleet.by_label("vector(1)"))
        fleet.start_agent("robots", [target.address for target in targets], unit=agent)
        processes = {name: psutil.Process(process.pid) for name, process in fleet.processes.items()}
        ticks = "robot_health_last_tick_timestamp_seconds"
        per_target = [min(PER_TARGET, robots - first) for first in range(0, robots, PER_TARGET)]

        def scraped(times: int) -> bool:
            return all(target.series.get(ticks, 0) >= times * count for target, count in zip(targets, per_target))

        until(lambda: scraped(1), limit_s=120.0)
        began_s = time.monotonic()
        cpu_s = {name: sum(process.cpu_times()[:2]) for name, process in processes.items()}
        until(lambda: scraped(scrapes), limit_s=INTERVAL_S * scrapes * 4.0)
        lasted_s = time.monotonic() - began_s
        used = {name: (sum(each.cpu_times()[:2]) - cpu_s[name]) / lasted_s for name, each in processes.items()}
        memory = {name: process.memory_info().rss / 1e6 for name, process in processes.items()}
        rules = rule_figures(fleet, engine)
        for target in targets:
            target.stop()
        end_s = time.monotonic() + 120.0
        while fleet.counts(served(targets)) != served(targets) and time.monotonic() < end_s:
            time.sleep(2.0)
        expected = served(targets)
        stored = fleet.counts(expected)
        paged = {alert["labels"]["robot"] for sent in fleet.pager.sent for alert in sent["alerts"]}
    for target in targets:
        target.end()
    return {
        "engine": engine,
        "robots": robots,
        "seconds": round(lasted_s),
        "samples": sum(expected.values()),
        "lost": sum(expected.values()) - sum(stored.values()),
        "cpu_cores": {name: round(value, 3) for name, value in used.items()},
        "memory_mb": {name: round(value) for name, value in memory.items()},
        **rules,
        "paged": len(paged),
        "robots_to_page": len([robot for robot in range(robots) if robot % 1000 == 7]),
    }


def served(targets: Sequence[Scraped]) -> Dict[str, float]:
    """Returns how many samples of each metric the agents were given."""
    total: Dict[str, float] = {}
    for target in targets:
        for name, count in target.series.items():
            total[name] = total.get(name, 0.0) + count
    return total


def rule_figures(fleet: PushingFleet, engine: str) -> Dict[str, float]:
    """Returns how long the slowest group of rules took, all of them together, and how many evaluations were skipped."""
    if engine == "prometheus":
        address, took, skipped = (
            f"127.0.0.1:{fleet.port}",
            r"prometheus_rule_group_last_duration_seconds\{.*\}",
            ("prometheus_rule_group_iterations_missed_total"),
        )
    else:
        command = fleet.processes["centre vmalert"].args
        address = next(word for word in command if word.startswith("-httpListenAddr=")).partition("=")[2]
        took, skipped = r'vmalert_iteration_duration_seconds\{.*quantile="1"\}', "vmalert_iteration_missed_total"
    text = get(f"http://{address}/metrics").decode()
    seconds = [float(each) for each in re.findall(rf"^{took} (\S+)$", text, re.MULTILINE)]
    missed = [float(each) for each in re.findall(rf"^{skipped}(?:\{{.*\}})? (\S+)$", text, re.MULTILINE)]
    return {"slowest_group_s": max(seconds), "all_groups_s": sum(seconds), "skipped": sum(missed)}


if __name__ == "__main__":
    robots, scrapes, engine = [*sys.argv[1:], *("1000", "6", "prometheus")[len(sys.argv) - 1 :]]
    print(json.dumps(measure(int(robots), int(scrapes), engine)))
