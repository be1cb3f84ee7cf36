"""The soak test itself: what it calls flat, and a run of a few seconds, so that it still works when it is needed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from soak.figures import flat

pytestmark = pytest.mark.newest_python  # as `make soak` itself

SOAK = Path(__file__).parent


def run_soak(*options: str) -> subprocess.CompletedProcess[str]:
    """Runs the parts of the soak test for which there is an option."""
    off = {"--minutes": "0", "--samples": "0", "--kills": "0", "--storm-minutes": "0", "--days": "0"}
    off.update({"--black-boxes": "0", "--black-box-kills": "0"})
    command = [sys.executable, str(SOAK), *(word for pair in off.items() for word in pair), *options]
    return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=600)


@pytest.mark.parametrize(
    ("series", "growth"),
    [
        ([(float(second), 40.0 + second % 3) for second in range(100)], 0.0),
        ([(float(second), 40.0 + 0.1 * second) for second in range(100)], 9.9),
        ([(float(second), min(60.0, 40.0 + second)) for second in range(100)], 0.0),  # warm-up
        ([(float(second), 40.0 if second != 80 else 90.0) for second in range(100)], 0.0),  # one outlier
    ],
)
def test_growth_is_that_of_the_second_half(series: list, growth: float) -> None:
    assert flat("memory", series, 3.0, "MB").growth == pytest.approx(growth)


def test_a_short_run_is_flat() -> None:
    run = run_soak("--minutes", "0.05", "--samples", "4000", "--seed", "1")
    assert run.returncode == 0, run.stdout
    assert "file descriptors" in run.stdout


def test_kill_9_loses_and_repeats_nothing() -> None:
    run = run_soak("--kills", "100")
    assert run.returncode == 0, run.stdout
    assert run.stdout.count("rounds: 100") == 2


def test_a_storm_of_alerts_does_not_fill_the_disk() -> None:
    run = run_soak("--storm-minutes", "0.1", "--storm-mb", "5")
    assert run.returncode == 0, run.stdout
    assert "file and log" in run.stdout


def test_stored_samples_equal_the_raw_ones_before_and_after_they_are_merged() -> None:
    run = run_soak("--days", "2.2", "--sample-period", "60", "--seed", "22")
    assert run.returncode == 0, run.stdout
    assert "hours of signals in the history" in run.stdout
