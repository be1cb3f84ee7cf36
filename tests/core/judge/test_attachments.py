"""The configuration and the saved states that a black box attaches to a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from robot_health_monitor.core import load_config
from robot_health_monitor.core.judge.attachments import SavedMonitor, read_saved_monitor, thresholds_tree
from robot_health_monitor.core.values.errors import MessageError

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted(ROOT.glob("config/**/*.yaml")) + sorted(ROOT.glob("tests/thresholds/*.yaml"))


def round_trip(config: Any) -> Any:
    tree = thresholds_tree(config, config.robot_name, {}, use_sim_time=False)
    return load_config(yaml.safe_load(yaml.safe_dump(tree, sort_keys=False)))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_every_shipped_configuration_reads_back_as_the_same_signals(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    if "signals:" not in text:
        pytest.skip("not a configuration of alert_system")
    config = load_config(file)
    assert dict(round_trip(config).signals) == dict(config.signals)


@pytest.mark.parametrize(
    "signal",
    [
        {"warn_below": 20.0, "statistic": "forecast", "forecast_s": 600.0, "window_s": 300.0},
        {"warn_below": 20.0, "error_below": 10.0, "for_s": 3.0, "error_for_s": 0.0, "keep_firing_for_s": 5.0},
        {"warn_above": 3.0, "statistic": "mean", "window_s": 60.0, "window_min_s": 1.0, "window_samples": 50},
        {"warn_above": 3.0, "only_if": {"signal": "other", "between": [1.0, 2.0]}, "latch": True},
        {"warn_above": 3.0, "latch": True, "latch_release_if": {"signal": "other", "is": 1.0}},
        {"field": "cell_voltage[*]", "type": "sensor_msgs/BatteryState", "warn_below": 3.2, "max_elements": 12},
        {"field": "cell_voltage[*]", "reduce": "spread", "warn_above": 0.1, "placeholders": [0.0, -1.0]},
        {"field": "", "where": 'level >= ERROR and name == "*a*"', "statistic": "count", "warn_above": 5.0},
        {"field": "", "statistic": "frequency_hz", "warn_below": 8.0, "stale_after_s": 0.5},
    ],
    ids=str,
)
def test_every_kind_of_key_reads_back(signal: dict[str, Any]) -> None:
    config = load_config({"signals": {"one": signal, "other": {}}})
    assert dict(round_trip(config).signals) == dict(config.signals)


def test_the_topics_are_the_absolute_names() -> None:
    config = load_config({"signals": {"battery": {"topic": "battery_level", "warn_below": 20.0}}})
    tree = thresholds_tree(config, "r1", {"battery_level": "/husky/battery_level"}, use_sim_time=True)
    assert tree == {
        "alert_system": {
            "ros__parameters": {
                "robot_name": "r1",
                "publish_rate": 1.0,
                "signals": {"battery": {"topic": "/husky/battery_level", "warn_below": 20.0}},
                "use_sim_time": True,
            }
        }
    }


def test_saved_states_move_to_another_clock() -> None:
    state = {"since": {"announced": 5.0}, "storm": [3.0, 4.0], "warn": {"state": "x"}}
    text = SavedMonitor("r1", 10.0, {"battery": state}).to_json(1000.0)
    assert read_saved_monitor(text) == SavedMonitor(
        "r1",
        1010.0,
        {
            "battery": {
                "since": {"announced": 1005.0},
                "storm": [1003.0, 1004.0],
                "warn": {"state": "x"},
            }
        },
    )
    assert json.loads(text)["robot"] == "r1"


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"robot": 1, "time_s": 1.0, "signals": {}}', "[" * 100_000])
def test_a_text_that_is_no_state_is_refused(text: str) -> None:
    with pytest.raises(MessageError, match=r"^state\.json: expected"):
        read_saved_monitor(text)


@pytest.mark.parametrize("time_s", ["Infinity", "-Infinity", "NaN", "1e300", "-1.0"])
def test_a_time_that_no_message_can_have_is_refused(time_s: str) -> None:
    with pytest.raises(MessageError, match=r"^state\.json: expected robot, time_s in seconds since 1970, and signals$"):
        read_saved_monitor(f'{{"robot": "r", "time_s": {time_s}, "signals": {{}}}}')
