"""The configurations in config/ do what their tests in tests/thresholds/ say."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import pytest
from harness.line_process import LineProcess

from robot_health_monitor.cli.testing.threshold_cases import read_tests
from robot_health_monitor.core import load_config
from robot_health_monitor.core.config.signal_config import template_name

ROOT = Path(__file__).resolve().parents[2]
TESTS = sorted((ROOT / "tests" / "thresholds").glob("*.test.yaml"))


def test_each_configuration_has_tests() -> None:
    assert {file.name.replace(".test.yaml", ".yaml") for file in TESTS} == {
        file.name for file in (ROOT / "config").glob("*.yaml")
    }


@pytest.mark.newest_python
@pytest.mark.parametrize("file", TESTS, ids=lambda file: file.name)
def test_its_tests_pass(robot_health_here: Callable[..., LineProcess], file: Path) -> None:
    process = robot_health_here("test", file)
    assert process.wait() == 0, process.text


@pytest.mark.parametrize("file", TESTS, ids=lambda file: file.name)
def test_each_of_its_signals_is_in_a_test(file: Path) -> None:
    config = load_config(ROOT / "config" / file.name.replace(".test.yaml", ".yaml"))
    tested: set[str] = set()
    for test in read_tests(str(file))[1]:
        tested.update(map(template_name, test.input))
    assert set(config.signals) <= tested


def test_the_forecast_in_the_default_thresholds_works_once_its_comment_marks_are_removed(tmp_path: Path) -> None:
    lines = (ROOT / "config" / "thresholds.yaml").read_text().splitlines()
    start = next(number for number, line in enumerate(lines) if line.strip() == "# battery_soon:")
    end = next(number for number, line in enumerate(lines) if number > start and not line.strip().startswith("#"))
    lines[start:end] = [line.replace("# ", "", 1) for line in lines[start:end]]
    file = tmp_path / "thresholds.yaml"
    file.write_text("\n".join(lines))
    soon = load_config(file).signals["battery_soon"]
    assert (soon.topic, soon.statistic, soon.forecast_s, soon.for_s) == ("battery_level", "forecast", 1800.0, 300.0)
