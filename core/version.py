"""The version number of the package, which is kept in package.xml only."""

from __future__ import annotations

import functools
from pathlib import Path
from xml.etree import ElementTree

_NAME = "robot_health_monitor"


@functools.lru_cache(maxsize=None)
def package_version() -> str:
    """Returns the version, `unknown` where it is not installed with the package."""
    # The source tree has package.xml beside core/; pip, colcon and catkin install it in <prefix>/share.
    here = Path(__file__).resolve()
    places = [here.parents[1], *(above / "share" / _NAME for above in here.parents)]
    for place in places:
        try:
            found = ElementTree.parse(place / "package.xml").findtext("version")
        except (OSError, ElementTree.ParseError):
            continue
        if found:
            return found.strip()
    from importlib import metadata  # takes 0.7 MB, and package.xml is installed nearly everywhere

    try:
        return metadata.version(_NAME)
    except metadata.PackageNotFoundError:
        return "unknown"
