"""A monitor on the local middleware that judges a million samples in virtual time."""

from __future__ import annotations

import gc
import random
import tracemalloc
from typing import Any

from soak.figures import Figure, count, flat

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus

FLOAT32 = "std_msgs/Float32"
PERIOD_S = 0.05
POINTS = 40
ALLOWED_KB = 100.0
LEAST_TRANSITIONS_PER_SAMPLE = 0.01

SIGNALS: dict[str, dict[str, Any]] = {
    "battery": {"warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0, "valid_min": 0.0, "stale_after_s": 1.0,
                "window_s": 5.0},
    "mean": {"topic": "battery", "statistic": "mean", "warn_below": 49.0, "window_s": 2.0, "window_min_s": 0.5},
    "rate": {"topic": "battery", "statistic": "rate", "warn_above": 5.0, "window_s": 1.0, "latch": True},
    "flapping": {"topic": "battery", "warn_above": 50.0, "flap_detection": True, "repeat_s": 5.0, "window_s": 5.0},
    "frequency": {"topic": "battery", "statistic": "frequency_hz", "warn_below": 15.0, "window_s": 5.0},
}  # fmt: skip
"""Every step of the rules is at work, and alerts are frequent.

The memory of a window is a sawtooth: once per `window_s`, it drops the old half and computes its aggregates. Windows
are so short that even a run of 4,000 samples has many teeth, small ones: with 60 s, one of them looked like growth.
"""


def run(samples: int, seed: int) -> list[Figure]:
    """Publishes the samples and returns the figures; the memory is that which Python has allocated."""
    chance = random.Random(seed)
    counts = {"alerts": 0, "reports": 0, "log": 0}
    bus = LocalBus(on_log=lambda line: _add(counts, "log"))
    alert_system = AlertSystem(bus.node("alert_system", parameters={"signals": SIGNALS, "robot_name": "atlas"}))
    robot = bus.node("robot")
    robot.advertise("battery", FLOAT32)
    robot.subscribe("alerts", "diagnostic_msgs/DiagnosticStatus", lambda message, now_s: _add(counts, "alerts"))
    robot.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray", lambda message, now_s: _add(counts, "reports"))
    series: list[tuple[float, float]] = []
    between = max(1, samples // POINTS)
    value, now_s = 50.0, 0.0
    tracemalloc.start()
    try:
        for number in range(samples):
            value = min(100.0, max(-5.0, value + chance.gauss(0.0, 8.0)))
            robot.publish("battery", {"data": value if chance.random() < 0.995 else float("nan")})
            now_s += PERIOD_S if chance.random() < 0.999 else 3.0  # a gap now and then: STALE
            bus.run_until(now_s)
            if number % 10_000 == 9_999:
                bus.call_service("/alert_system/reset")
            if number % between == between - 1:
                gc.collect()
                series.append((number + 1.0, tracemalloc.get_traced_memory()[0] / 1024.0))
    finally:
        tracemalloc.stop()
    alert_system.close()
    return [
        count("samples in virtual time", samples, samples),
        count("  transitions", counts["alerts"], samples * LEAST_TRANSITIONS_PER_SAMPLE),
        count("  reports on /diagnostics", counts["reports"], now_s - 1.0),
        flat("  allocated by Python", series, ALLOWED_KB, "KB"),
    ]


def _add(counts: dict[str, int], name: str) -> None:
    counts[name] += 1
