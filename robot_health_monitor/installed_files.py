"""Finds files that are installed with the package, such as config/thresholds.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Optional

_PACKAGE = Path(__file__).resolve().parent
"""Resolved, because `--symlink-install` and a catkin devel space link to the source tree."""


def find_installed(name: str) -> Optional[Path]:
    """Returns the path of `config/thresholds.yaml` or another installed file; None: it is not installed.

    The source tree has it beside the package; pip, colcon and catkin install it in
    `<prefix>/share/robot_health_monitor`.
    """
    places = [_PACKAGE.parent, *(above / "share" / _PACKAGE.name for above in _PACKAGE.parents)]
    return next((place / name for place in places if (place / name).is_file()), None)
