"""The README says what the code does: its example runs, and its tables name every parameter."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Iterator, Tuple

import pytest

from robot_health_monitor.core.config import CONDITION_PARAMETERS, MONITOR_PARAMETERS, SIGNAL_PARAMETERS
from robot_health_monitor.core.nodes.aggregator import AGGREGATOR_PARAMETERS
from robot_health_monitor.core.nodes.battery_sensor import SENSOR_PARAMETERS
from robot_health_monitor.core.parameters import Parameter
from robot_health_monitor.core.sensors import configuration as sensing

README = Path(__file__).resolve().parents[2] / "README.md"
ROW = re.compile(r"^\| `([\w.]+)` \| ([^|]*?) ?\| ([^|]*) \|$", re.MULTILINE)


def every_parameter() -> Iterator[Tuple[str, Parameter]]:
    tables = (MONITOR_PARAMETERS, SIGNAL_PARAMETERS, CONDITION_PARAMETERS, AGGREGATOR_PARAMETERS)
    for parameters in (*tables, SENSOR_PARAMETERS):
        for parameter in parameters:
            yield parameter.name, parameter
    for section, parameters in sensing.SECTIONS.items():
        for parameter in parameters:
            yield f"{section}.{parameter.name}", parameter


def default_text(default: Any) -> str:
    if default is None or default in ("", ()):
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


@pytest.mark.parametrize(("name", "parameter"), [pytest.param(*pair, id=pair[0]) for pair in every_parameter()])
def test_a_table_of_the_readme_lists_the_parameter_with_its_default_and_meaning(
    name: str, parameter: Parameter
) -> None:
    rows = {(found, default, meaning) for found, default, meaning in ROW.findall(README.read_text(encoding="utf-8"))}
    assert (name, default_text(parameter.default), parameter.description) in rows


def test_the_example_of_library_use_runs_and_prints_its_one_transition(capsys: pytest.CaptureFixture[str]) -> None:
    example = re.search(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert example is not None
    exec(compile(example[1], "README.md", "exec"), {})
    assert capsys.readouterr().out == "4.000 battery_level WARN: 18 is below 20 (was OK for 4 s)\n"
