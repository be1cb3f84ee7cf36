"""Finds the files that are installed beside the package: package.xml and config/thresholds.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Optional

_PACKAGE = Path(__file__).resolve().parent
"""Resolved, because `--symlink-install` and a catkin devel space link to the source tree."""


def find_installed(name: str) -> Optional[Path]:
    """Returns where `config/thresholds.yaml` or `package.xml` is, None when it is nowhere.

    In a source tree they stand beside the package. pip, colcon and catkin put them into `share/robot_health_monitor` of
    the prefix below which they put the package.
    """
    places = [_PACKAGE.parent, *(above / "share" / _PACKAGE.name for above in _PACKAGE.parents)]
    return next((place / name for place in places if (place / name).is_file()), None)


def version() -> str:
    """Returns the one version number, which stands in package.xml."""
    manifest = find_installed("package.xml")
    if manifest is not None:
        from xml.etree import ElementTree

        found = ElementTree.parse(manifest).findtext("version")
        if found:
            return found.strip()
    from importlib import metadata

    try:
        return metadata.version(_PACKAGE.name)
    except metadata.PackageNotFoundError:
        return "unknown"
