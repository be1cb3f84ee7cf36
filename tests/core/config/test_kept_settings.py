"""Settings that a history keeps: what is stored reads as the same signals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Mapping

import pytest

from robot_health_monitor.core import load_config
from robot_health_monitor.core.config.kept_settings import read_kept, settings_of
from robot_health_monitor.core.config.monitor_config import MonitorConfig
from robot_health_monitor.core.config.signal_config import LINK, LINK_CONFIG
from robot_health_monitor.core.judge.continuity import Continuity
from robot_health_monitor.core.judge.monitor import Monitor
from robot_health_monitor.core.values.errors import ConfigError

ROOT = Path(__file__).resolve().parents[3]

SIGNALS: Mapping[str, Mapping[str, Any]] = {
    "battery": {"warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0, "unit": "%", "valid_max": 100.0},
    "soon": {"topic": "battery", "warn_below": 20.0, "statistic": "forecast", "forecast_s": 1800.0, "for_s": 60.0},
    "rate": {"topic": "/scan", "field": "", "statistic": "frequency_hz", "warn_below": 8.0, "window_s": 5.0},
    "odd": {"placeholders": [-1.0, 255.0], "scale": 0.1, "latch": True, "error_above": 3.0, "error_for_s": 2.0},
    "cells": {"type": "sensor_msgs/BatteryState", "field": "cell_voltage[*]", "warn_below": 3.2, "max_elements": 5},
    "spread": {"type": "sensor_msgs/BatteryState", "field": "cell_voltage[*]", "reduce": "spread", "warn_above": 0.1},
    "drivers": {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'},
    "a": {"warn_above": 1.0, "only_if": {"signal": "battery", "above": 30.25}},
    "b": {"warn_above": 1.0, "only_if": {"signal": "battery", "between": [-1.5, 1e-7]}},
    "c": {"warn_above": 1.0, "only_if": {"signal": "battery", "is": 3.0}, "latch": True,
          "latch_release_if": {"signal": "cells[7]", "is_not": 4.0}},
}  # fmt: skip


def stored(config: MonitorConfig) -> Any:
    """Returns what a history has of a configuration."""
    kept = []

    class Keeps:
        def record_configuration(self, configuration: Mapping[str, Mapping[str, Any]]) -> None:
            kept.append(json.loads(json.dumps(configuration)))

    Continuity(Monitor(config), Keeps()).record_configuration(config)  # type: ignore[arg-type]
    return kept[0]


def test_what_is_stored_reads_as_the_same_signals() -> None:
    config = load_config({"signals": SIGNALS})
    assert read_kept(stored(config)) == {**config.signals, LINK: LINK_CONFIG}


@pytest.mark.parametrize("file", sorted((ROOT / "config").glob("*.yaml")), ids=lambda file: file.name)
def test_every_shipped_configuration_is_kept(file: Path) -> None:
    try:
        config = load_config(file)
    except ConfigError:
        pytest.skip("no thresholds")
    assert read_kept(stored(config)) == {**config.signals, LINK: LINK_CONFIG}


def test_the_settings_are_those_that_were_given() -> None:
    config = load_config({"signals": SIGNALS})
    for name, given in SIGNALS.items():
        assert settings_of(config.signals[name]) == given, name


@pytest.mark.parametrize(
    "kept",
    [
        {"a": 5},
        {"a": {"warn_below": "low"}},
        {"a": {"warn_below": 1.0, "only_if": {"signal": "b", "is": "strange"}}},
        {"a": {"warn_below": 1.0, "only_if": 3}},
        {"a": {"statistic": "forecast"}},
    ],
)
def test_what_another_program_has_changed_is_refused(kept: Mapping[str, Any]) -> None:
    with pytest.raises(ConfigError):
        read_kept(kept)
