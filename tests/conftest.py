"""Checks before the tests start that the packages they need are here, and in a version that is new enough."""

from __future__ import annotations

import re
import sys
from importlib import metadata
from pathlib import Path
from typing import List, Tuple

import pytest

sys.path.append(str(Path(__file__).parent))  # pytest before 7 does not read `pythonpath`

from harness.requirements import test_requirements


def pytest_configure() -> None:
    """Ends the run with one line if a package is missing or too old."""
    unmet = [problem for requirement in test_requirements() for problem in check(requirement)]
    if unmet:
        raise pytest.UsageError(f"the tests need {', '.join(unmet)}: pip install '.[test]', or make test")


def check(requirement: str) -> List[str]:
    """Returns what is wrong with the package of a requirement such as `pytest>=7.2`; empty if it is met."""
    name, _, needed = requirement.partition(">=")
    try:
        installed = metadata.version(name)
    except metadata.PackageNotFoundError:
        return [f"{requirement} (not installed)"]
    return [] if numbers(installed) >= numbers(needed) else [f"{requirement} (installed: {installed})"]


def numbers(version: str) -> Tuple[int, ...]:
    """Returns the leading numbers of a version: `7.2.0rc1` gives 7, 2, 0."""
    return tuple(int(number) for number in re.findall(r"\d+", re.match(r"[\d.]*", version).group()))
