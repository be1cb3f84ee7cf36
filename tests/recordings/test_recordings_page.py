"""docs/recordings.md shows the test that its picture was made with, and the extra's commands."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_shows_the_test_of_its_picture() -> None:
    page = (ROOT / "docs" / "recordings.md").read_text()
    (shown,) = re.findall(r"```yaml\n(thresholds:.*?)```", page, re.S)
    assert yaml.safe_load(shown) == yaml.safe_load((ROOT / "docs" / "pictures" / "thresholds.test.yaml").read_text())
