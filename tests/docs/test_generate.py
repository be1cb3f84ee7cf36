"""The generated parts of the pages are those that the code gives."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
SCRIPT: dict[str, Any] = runpy.run_path(str(DOCS / "generate.py"))
PAGES: dict[Path, str] = SCRIPT["pages"]()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_up_to_date(page: Path) -> None:
    assert page.read_text(encoding="utf-8") == PAGES[page], "run: python docs/generate.py"


def test_every_block_is_on_a_page() -> None:
    used = {name for page in PAGES.values() for name in re.findall(r"<!-- generated: (.+?) -->", page)}
    assert sorted(used) == sorted(SCRIPT["_blocks"]())


def test_every_command_is_described() -> None:
    listed = re.findall(r"^  ([a-z]+) +[a-z]", SCRIPT["_parser"]().format_help(), re.MULTILINE)
    assert sorted(listed) == sorted(SCRIPT["COMMANDS"])


def examples() -> list[Any]:
    page = (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
    return [json.loads(block) for block in re.findall(r"```json\n(.*?)```", page, re.DOTALL)]


def test_the_example_of_the_state_has_the_keys_that_are_sent() -> None:
    (state,) = (each for each in examples() if "version" in each)
    (robot,) = state["robots"].values()
    (signal,) = robot["signals"].values()
    shown = {"state": state, "monitor": state["monitor"], "robot": robot, "signal": signal}
    shown["silence"] = state["silences"][0]
    shown["alert"] = next(each["alerts"][0] for each in examples() if "alerts" in each)
    (shown["note"],) = shown["alert"]["notes"]
    for name, example in shown.items():
        assert sorted(example) == sorted(SCRIPT["fields_sent"](name)), name


def test_rows_read_as_expected() -> None:
    """Written by hand, so that an empty table is noticed."""
    text = "".join(PAGES.values())
    assert "| `hysteresis` | a number of at least 0 | `0` | distance from a bound at which its alert clears" in text
    assert "| `warn_below` | a number |  | WARN below this value, in the unit of the statistic |" in text
    assert "| `latch` | true or false | `false` | keep the worst level that fired until reset |" in text
    assert "| `battery_level.source` | one of simulated, host, none | `simulated` | " in text
    assert "| `--duration SECONDS` | end after this time, with code 1 if there were alerts |" in text
    assert "| 2 | usage or configuration error |" in text
    assert "| `robot_health_link_up{robot}` | gauge | " in text
    assert "| `robot_health_samples_total{robot,signal,quality}` | counter | " in text
    assert "| `keeps firing` | " in text
    assert "* `check this computer's settings: wrong token`\n" in text
    assert "* `connection refused: no server listens on this port`\n" in text
    assert "| `judged_unit` | " in text
    assert "| `rosbridge_port` | `0` | " in text
    assert "| `keep_days` | " in text
