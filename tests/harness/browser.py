"""A real browser for pages that need no server: Chromium without a window."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

_QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--virtual-time-budget=5000",
)
_NAMES = ("chromium", "chromium-browser", "google-chrome")


class Shown(NamedTuple):
    """A page as the browser shows it."""

    dom: str
    """Its elements after the scripts have run."""
    console: str
    """What the page wrote to the console, errors and violations of its policy included."""


def show(page: Path, width: int = 1280) -> Shown:
    """Opens a page; skips the test where no browser is installed."""
    browser = next(filter(None, map(shutil.which, _NAMES)), None)
    if browser is None:
        pytest.skip("no browser: as root, apt-get install chromium")
    profile = page.parent / "browser"
    options = [f"--user-data-dir={profile}", f"--window-size={width},900", "--dump-dom", page.as_uri()]
    ended = subprocess.run([browser, *_QUIET, *options], capture_output=True, text=True, timeout=600)
    assert ended.returncode == 0, ended.stderr
    return Shown(ended.stdout, "\n".join(line for line in ended.stderr.splitlines() if ":CONSOLE" in line))
