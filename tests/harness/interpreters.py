"""Finds the Python interpreters of this machine."""

from __future__ import annotations

import shutil
import subprocess


def find_pythons() -> dict[str, str]:
    """Returns the released CPython interpreters on the PATH by minor version ("3.8"), oldest first."""
    found = {}
    for minor in range(8, 30):
        path = shutil.which(f"python3.{minor}")
        if path and _is_released(path):
            found[f"3.{minor}"] = path
    return found


def _is_released(python: str) -> bool:
    """Returns whether an interpreter starts (a shim of pyenv may not) and is no alpha, beta or candidate."""
    check = "import sys; sys.exit(sys.version_info.releaselevel != 'final')"
    return subprocess.run([python, "-c", check], stdin=subprocess.DEVNULL, capture_output=True).returncode == 0
