"""VictoriaMetrics, vmagent and vmalert of Debian's package victoria-metrics."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

NAMES = ("victoria-metrics", "vmagent", "vmalert")

needs_victoria_metrics = pytest.mark.skipif(
    any(shutil.which(name) is None for name in NAMES),
    reason="no VictoriaMetrics: as root, apt-get install victoria-metrics",
)


def vmalert_problem(rules: Path) -> str:
    """Returns why vmalert refuses a file of rules; empty: it accepts them."""
    command = ["vmalert", "-dryRun", f"-rule={rules}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    return "" if done.returncode == 0 else done.stdout + done.stderr
