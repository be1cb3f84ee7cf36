"""The version number of the package, which is kept in package.xml only."""

from __future__ import annotations

import contextlib
import functools
import re
from pathlib import Path

_NAME = "robot_health_monitor"


@functools.lru_cache(maxsize=None)
def package_version() -> str:
    """Returns the version, `unknown` where it is not installed with the package."""
    # The source tree has package.xml beside core/, an sdist beside the root package; pip, colcon and catkin install it
    # in <prefix>/share.
    here = Path(__file__).resolve()
    places = [*list(here.parents)[2:4], *(above / "share" / _NAME for above in here.parents)]
    for place in places:
        # Not with an XML parser, which takes 0.5 MB of memory in every node.
        with contextlib.suppress(OSError, ValueError):
            found = re.search(r"<version>\s*(\S+)\s*</version>", (place / "package.xml").read_text("utf-8"))
            if found:
                return found.group(1)
    from importlib import metadata  # takes 0.7 MB, and package.xml is installed nearly everywhere

    try:
        return metadata.version(_NAME)
    except metadata.PackageNotFoundError:
        return "unknown"
