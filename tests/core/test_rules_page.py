"""docs/rules.md quotes what the monitor does, and lists every key of a status."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.values.elements import Elements

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "rules.md").read_text(encoding="utf-8")


def drawing() -> Any:
    spec = importlib.util.spec_from_file_location("draw_rules", DOCS / "draw_rules.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_quotes_the_lines_of_the_worked_example() -> None:
    lines = drawing().lines()
    assert len(lines) == 8
    assert "\n".join(lines) in PAGE


def test_the_page_quotes_the_lines_of_the_node_that_dies() -> None:
    lines = drawing().node_lines()
    assert len(lines) == 2
    assert "\n".join(lines) in PAGE


def test_the_page_lists_every_key_of_a_status() -> None:
    signal = {
        "unit": "%", "warn_below": 20.0, "warn_above": 80.0, "error_below": 10.0, "error_above": 90.0,
        "valid_min": 0.0, "valid_max": 100.0, "scale": 2.0, "statistic": "mean", "flap_detection": True,
        "only_if": {"signal": "charging", "is": 0.0}, "latch_release_if": {"signal": "charging", "is": 1.0},
    }  # fmt: skip
    soon = {"statistic": "forecast", "window_s": 20.0, "forecast_s": 60.0, "warn_below": 20.0}
    scan_gap = {"statistic": "largest_gap_s"}
    cells = {"field": "cells[*]"}
    signals = {
        "battery_level": signal, "charging": {}, "soon": soon, "scan_gap": scan_gap, "errors": {"statistic": "count"},
        "weakest": {**cells, "reduce": "min"}, "spread": {**cells, "reduce": "spread"},
        "driver": {"error_above": 0.5, "what_to_do": "restart it"},
        "wheel": {"warn_below": 0.5, "depends_on": ["driver"]},
    }  # fmt: skip
    monitor = Monitor(load_config({"signals": signals}))
    for name in ("weakest", "spread"):
        monitor.observe(Sample(name, Elements([("0", 3.5), ("1", 3.75)]), 0.0))
    for now_s in range(40):
        of_known = {"soon": 80.0 - now_s, "scan_gap": 1.0, "driver": 1.0, "wheel": 0.0}
        for name, value in {"battery_level": 25.0 + now_s % 2, **of_known}.items():
            monitor.observe(Sample(name, value, float(now_s)))
    keys = {key for status in monitor.report(40.0).statuses.values() for key in status.values}
    table = PAGE[PAGE.index("## Keys of a status") :]
    listed = {key for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for key in re.findall(r"`(\w+)`", row)}
    assert keys == listed
