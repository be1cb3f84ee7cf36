"""docs/signals.md is up to date: its examples load, and its table lists every source of the host."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from robot_health_monitor.core.config.monitor_config import load_config
from robot_health_monitor.core.sensors import configuration as sensing
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.values.field_path import parse_field_path

yaml = pytest.importorskip("yaml")

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "signals.md").read_text(encoding="utf-8")
EXAMPLES: list[dict[str, Any]] = [
    yaml.safe_load(text) for text in re.findall(r"^```yaml\n(.*?)^```", PAGE, re.M | re.S)
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: ", ".join(example))
def test_an_example_is_a_configuration(example: dict[str, Any]) -> None:
    if "alert_system" in example:
        sensing.read_sources(example["battery_sensor"]["ros__parameters"])
        load_config(example)
    else:
        load_config({"signals": example})


@pytest.mark.parametrize("kind", HOST_SOURCES)
def test_the_table_lists_every_source_of_the_host(kind: str) -> None:
    source = HOST_SOURCES[kind]
    options = "; ".join(f"`{option.name}`: {option.description}" for option in source.options)
    cells = (f"`{kind}`", options, source.unit, source.description)
    assert f"| {' | '.join(cells)} |\n" in PAGE.replace(r"\*", "*")


def test_the_table_of_fields_shows_paths() -> None:
    paths = re.findall(r"^\| `([a-z][^`]*)` (?:\(left out\) )?\| [a-z]", PAGE, re.M)
    assert len([parse_field_path(path) for path in paths if "[" in path or "." in path]) == 9


def test_the_lines_about_several_elements_are_what_the_monitor_says() -> None:
    from robot_health_monitor.core import Monitor, Sample
    from robot_health_monitor.core.values.elements import Elements

    (example,) = (example for example in EXAMPLES if "weakest_cell" in example)
    monitor = Monitor(load_config({"signals": example}))
    said = [
        line.text
        for signal, name, values in (("weakest_cell", "7", (3.7, 3.12)), ("effort", "wheel_left", (2.0, 9.0)))
        for now_s, value in zip((0.0, 3.0), values)
        for line in monitor.observe(Sample(signal, Elements([(name, value)]), now_s))
    ]
    assert len(said) == 2
    for text in said:
        assert f"\n{text}\n" in PAGE


def test_the_line_about_the_charger_is_what_the_monitor_says() -> None:
    from robot_health_monitor.core import Monitor, Sample

    (example,) = (example for example in EXAMPLES if "battery" in example and "charging" in example)
    del example["battery"]["latch"], example["battery"]["latch_release_if"], example["battery"]["for_s"]
    monitor = Monitor(load_config({"signals": example}))
    monitor.observe(Sample("battery", 0.15, 0.0))
    (said,) = monitor.observe(Sample("charging", 1, 94.0))
    assert f"  {said.text}\n" in PAGE


def test_the_line_about_the_forecast_is_what_the_monitor_says() -> None:
    """From 90 %, 0.5 % less per minute: 35 % after 110 min, when 20 % are 30 min ahead, and for_s."""
    from robot_health_monitor.core import Monitor, Sample

    (example,) = (example for example in EXAMPLES if "battery_soon" in example)
    monitor = Monitor(load_config({"signals": example}))
    samples = (Sample("battery_soon", 0.9 - 0.005 * step / 30.0, 2.0 * step) for step in range(3500))
    (said,) = (transition for sample in samples for transition in monitor.observe(sample))
    assert f"\n{said.text}\n" in PAGE
