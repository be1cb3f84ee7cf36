"""docs/reference/parameters.md lists every parameter as the code defines it."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from robot_health_monitor.core.config import MONITOR_PARAMETERS
from robot_health_monitor.core.signal_config import CONDITION_PARAMETERS, SIGNAL_PARAMETERS

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def page() -> str:
    return (DOCS / "reference" / "parameters.md").read_text(encoding="utf-8")


def test_the_page_is_the_one_that_the_script_writes(page: str) -> None:
    written = runpy.run_path(str(DOCS / "write_parameters.py"))["page"]()
    assert page == written, "run: python docs/write_parameters.py"


@pytest.mark.parametrize("name", [each.name for each in SIGNAL_PARAMETERS + CONDITION_PARAMETERS + MONITOR_PARAMETERS])
def test_a_row_describes_each_parameter(page: str, name: str) -> None:
    assert f"| `{name}` | " in page


def test_rows_read_as_expected(page: str) -> None:
    assert "| `hysteresis` | a number of at least 0 | `0` | distance from a bound at which its alert clears" in page
    assert "| `warn_below` | a number |  | WARN below this value, in the unit of the statistic |" in page
    assert "| `latch` | true or false | `false` | keep the worst level that fired until reset |" in page
    assert "| `battery_level.source` | one of simulated, host, none | `simulated` | " in page
