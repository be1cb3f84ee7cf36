"""An hour of real monitors that push to a centre: is a sample lost, and is every alert sent once?

    python3 -m benchmarks.pushing_hour [ROBOTS [MINUTES]]

Runs `robot-health run` 50 times. A tenth of the robots have agents of their own, whose network is cut for a sixth of
the time; a tenth have clocks that are 90 s ahead or behind; the rest share an agent. The centre is killed twice. Every
robot is hot once, for a tenth of the hour, at a time that follows from the seed. In the end, PromQL counts the samples
of each metric and robot: they must be those that the agents were given.

An agent's own clock cannot be set wrong (Go asks the kernel): what it scrapes has the stamps that it would give. The
monitors themselves have the wrong clock, by libfaketime.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Callable, Dict, List, NamedTuple, Tuple

from benchmarks.pushing_cost import free_port
from benchmarks.pushing_fleet import PushingFleet, Scraped, get, pushing_fleet, until
from robot_health_monitor.core.config import load_config

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests"))

from harness.tcp_proxy import TcpProxy  # noqa: E402  # found through the line above

SEED = 23
INTERVAL_S = 15.0
CLOCK_OFF_S = 90.0
ORDINARY_DEGC, ALERTING_DEGC = 50.0, 90.0
"""Means of the temperature, whose bound is 75 degrees C."""
LAST_TICK = "robot_health_last_tick_timestamp_seconds"


SIGNALS = {"battery_level": {"unit": "%"}, "temperature": {"unit": "degC", "warn_above": 75.0}}


def configuration(mean_degc: float) -> str:
    """Returns a thresholds.yaml with the mean of the simulated temperature."""
    sensor = {"temperature": {"mean": mean_degc, "spike": 0.0}}
    nodes = {"alert_system": {"signals": SIGNALS}, "battery_sensor": sensor}
    return json.dumps({node: {"ros__parameters": parameters} for node, parameters in nodes.items()})


class Robot:
    """A process of the monitor, and what is scraped of it."""

    def __init__(self, folder: Path, name: str, clock_off_s: float) -> None:
        """Starts it."""
        self.name = name
        self._thresholds = folder / f"{name}.yaml"
        self._thresholds.write_text(configuration(ORDINARY_DEGC))
        port = free_port()
        command = [sys.executable, "-m", "robot_health_monitor", "run", "--source", "simulated", "--robot", name]
        command += ["--thresholds", str(self._thresholds), "--port", str(port)]
        clock = ["faketime", "-f", f"{clock_off_s:+.0f}s"] if clock_off_s else []
        self._process = subprocess.Popen(
            [*clock, *command], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        self._address = f"http://127.0.0.1:{port}/metrics?profile=fleet"
        self._clock_off_s = clock_off_s
        self.agent_since_s = 0.0
        """When its agent began, in s since 1970. An agent sends nothing that is older."""
        self.scraped = Scraped(self._exposition)

    def _exposition(self) -> bytes:
        if time.time() + self._clock_off_s < self.agent_since_s:
            raise OSError("older than the agent")
        return stamped(get(self._address), self._clock_off_s)

    def set_temperature(self, mean_degc: float) -> None:
        """Lets it read another mean, as `systemctl reload` does."""
        self._thresholds.write_text(configuration(mean_degc))
        os.killpg(self._process.pid, signal.SIGHUP)

    def serves(self) -> bool:
        """Returns whether it has started."""
        try:
            return b"robot_health_value" in self.scraped.exposition()
        except OSError:
            return False

    def end(self) -> None:
        """Ends it."""
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self.scraped.end()


def stamped(body: bytes, clock_off_s: float) -> bytes:
    """Returns an exposition whose samples have the time of a clock that is so much ahead; 0: without times."""
    if not clock_off_s:
        return body
    stamp = f" {round((time.time() + clock_off_s) * 1000)}".encode()
    lines = [line if not line or line.startswith(b"#") else line + stamp for line in body.split(b"\n")]
    return b"\n".join(lines)


class Step(NamedTuple):
    """Something that happens."""

    at_s: float
    """Since the beginning."""
    action: Callable[[], object]


def measure(folder: Path, number: int, length_s: float) -> Dict[str, object]:
    """Runs the fleet; returns the figures."""
    chance = random.Random(SEED)
    tenth = max(1, number // 10)
    offs = {f"r{index}": CLOCK_OFF_S * (-1 if index % 2 else 1) for index in range(tenth, 2 * tenth)}
    robots = [Robot(folder, f"r{index}", offs.get(f"r{index}", 0.0)) for index in range(number)]
    cut, wrong, others = robots[:tenth], robots[tenth : 2 * tenth], robots[2 * tenth :]
    try:
        until(lambda: all(robot.serves() for robot in robots), limit_s=300.0)
        config = load_config({"signals": SIGNALS})
        with pushing_fleet(folder, config, free_port, interval_s=INTERVAL_S) as fleet:
            for unit in ("alertmanager", "prometheus"):
                fleet.start(unit)
            until(lambda: fleet.by_label("vector(1)"))
            proxies = {robot.name: TcpProxy(fleet.port) for robot in cut}
            fleet.start_agent("shared", [robot.scraped.address for robot in others])
            for robot in wrong:
                fleet.start_agent(robot.name, [robot.scraped.address])
                robot.agent_since_s = time.time() + 1.0
            for robot in cut:
                fleet.start_agent(robot.name, [robot.scraped.address], port=proxies[robot.name].port)
            steps = schedule(fleet, robots, [*proxies.values()], chance, length_s)
            run(steps, length_s)
            for robot in robots:
                robot.scraped.stop()
            wrong_counts, stored = settled(fleet, robots)
            fired, resolved = notified(fleet, "firing"), notified(fleet, "resolved")
            for proxy in proxies.values():
                proxy.end()
    finally:
        for robot in robots:
            robot.end()
    return {
        "robots": number,
        "minutes": round(length_s / 60.0, 1),
        "samples": stored,
        "lost_or_doubled": wrong_counts,
        "alerts_sent": Counter(fired[robot.name, "temperature"] for robot in robots),
        "ends_sent": Counter(resolved[robot.name, "temperature"] for robot in robots),
        "others_sent": sorted({f"{name} {label}" for name, label in fired if label != "temperature"}),
    }


def schedule(
    fleet: PushingFleet, robots: List[Robot], proxies: List[TcpProxy], chance: random.Random, length_s: float
) -> List[Step]:
    """Returns what happens: a network that is gone, a centre that is killed, alerts."""
    cut_s, back_s = length_s * 0.4, length_s * (0.4 + 1.0 / 6.0)

    def cut(refusing: bool) -> None:
        for proxy in proxies:
            proxy.refusing = refusing
            proxy.cut()

    steps = [Step(cut_s, lambda: cut(True)), Step(back_s, lambda: cut(False))]
    for share in (0.25, 0.7):
        down_s = length_s * share
        steps.append(Step(down_s, lambda: fleet.kill("centre prometheus")))
        steps.append(Step(down_s + 30.0, lambda: fleet.start("prometheus")))
    lasts_s = length_s / 10.0
    for number, robot in enumerate(robots):
        # An alert must come and go while its robot is connected, or it would not be sent: before the cut, or after it.
        free = [(0.02, 0.25), (0.6, 0.8)] if number < len(proxies) else [(0.02, 0.8)]
        begin_s = length_s * chance.uniform(*chance.choice(free))
        steps.append(Step(begin_s, lambda robot=robot: robot.set_temperature(ALERTING_DEGC)))
        steps.append(Step(begin_s + lasts_s, lambda robot=robot: robot.set_temperature(ORDINARY_DEGC)))
    return sorted(steps, key=lambda step: step.at_s)


def run(steps: List[Step], length_s: float) -> None:
    """Lets everything happen at its time."""
    began_s = time.monotonic()
    for step in [*steps, Step(length_s, lambda: None)]:
        time.sleep(max(0.0, began_s + step.at_s - time.monotonic()))
        step.action()


def settled(fleet: PushingFleet, robots: List[Robot]) -> Tuple[Dict[str, int], int]:
    """Waits until the centre has what the agents were given; returns what differs, and its samples.

    Clocks that are ahead are waited for.
    """
    expected = {(robot.name, name): count for robot in robots for name, count in robot.scraped.series.items()}
    names = {name for _, name in expected}
    end_s = time.monotonic() + CLOCK_OFF_S + 120.0
    while True:
        stored: Dict[Tuple[str, str], float] = {}
        for name in names:
            for (robot,), count in fleet.by_label(f"sum by (robot) (count_over_time({name}[3h]))", "robot").items():
                stored[robot, name] = count
        differences = {key: stored.get(key, 0.0) - count for key, count in expected.items()}
        wrong = {f"{robot} {name}": round(each) for (robot, name), each in differences.items() if each}
        if not wrong or time.monotonic() > end_s:
            return wrong, round(sum(stored.values()))
        time.sleep(5.0)


def notified(fleet: PushingFleet, status: str) -> Counter[Tuple[str, str]]:
    """Returns how often each alert was sent with a status, by robot and signal (or name of the alert)."""
    found: Counter[Tuple[str, str]] = Counter()
    for sent in fleet.pager.sent:
        for alert in sent["alerts"]:
            labels = alert["labels"]
            if alert["status"] == status:
                found[labels.get("robot", ""), labels.get("signal", labels["alertname"])] += 1
    return found


if __name__ == "__main__":
    given = [*sys.argv[1:], *("50", "60")[len(sys.argv) - 1 :]]
    with tempfile.TemporaryDirectory() as place:
        print(json.dumps(measure(Path(place), int(given[0]), float(given[1]) * 60.0)))
