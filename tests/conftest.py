"""Checks that the packages that the tests need are here; sets up hypothesis; chooses and names tests."""

from __future__ import annotations

import os
import re
import sys
from importlib import metadata
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))  # pytest before 7 does not read `pythonpath`

from harness.requirements import test_requirements
from harness.seeds import examples


def pytest_configure() -> None:
    """Ends the run with one line if a package is missing or too old; sets up hypothesis."""
    unmet = [problem for requirement in test_requirements() for problem in check(requirement)]
    if unmet:
        raise pytest.UsageError(f"the tests need {', '.join(unmet)}: pip install '.[test]', or make test")
    from hypothesis import HealthCheck, settings

    # Neither a busy machine nor chance fails a test: the same examples in every run, however long they take.
    # New input at random is for `make fuzz`.
    every_check = list(HealthCheck)
    settings.register_profile(
        "tests", max_examples=examples(100), derandomize=True, deadline=None, suppress_health_check=every_check
    )
    settings.load_profile("tests")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skips what another session runs: noxfile.py names it."""
    session = os.environ.get("NEWEST_PYTHON_SESSION")
    if session:
        skip = pytest.mark.skip(reason=f"does not depend on the version of Python: runs in {session}")
        for item in items:
            if item.get_closest_marker("newest_python"):
                item.add_marker(skip)


def pytest_make_parametrize_id(val: object) -> str | None:
    """Shortens long texts, which pytest would print in full."""
    return f"{val[:40]!a}..." if isinstance(val, (bytes, str)) and len(val) > 100 else None


def check(requirement: str) -> list[str]:
    """Returns what is wrong with the package of a requirement such as `pytest>=7.2`; empty if it is met."""
    name, _, needed = requirement.partition(">=")
    try:
        installed = metadata.version(name)
    except metadata.PackageNotFoundError:
        return [f"{requirement} (not installed)"]
    return [] if numbers(installed) >= numbers(needed) else [f"{requirement} (installed: {installed})"]


def numbers(version: str) -> tuple[int, ...]:
    """Returns the leading numbers of a version: `7.2.0rc1` gives 7, 2, 0."""
    return tuple(int(number) for number in re.findall(r"\d+", re.match(r"[\d.]*", version).group()))
