"""Libraries that only some functions need: all that are missing are named at once, with how to install them."""

from __future__ import annotations

import contextlib
import importlib
from typing import Iterator, List

from robot_health_monitor.core.errors import ServiceError

__all__ = ["RECORDINGS", "ROSBRIDGE", "MissingLibraryError", "libraries", "missing_libraries", "missing_text"]

ROSBRIDGE = ("aiohttp", "cbor2")
"""What rosbridge needs, as a server and as a client."""
RECORDINGS = ("lz4", "mcap", "numpy", "rosbags", "zstandard")
"""What reading every kind of recording needs: the extra `[recordings]`."""

_PACKAGES = {"yaml": "PyYAML"}
"""Packages whose modules have other names."""


class MissingLibraryError(ServiceError):
    """A library is not installed. `str()` is one line: all that are missing, and the command that installs them."""


@contextlib.contextmanager
def libraries(*names: str) -> Iterator[None]:
    """Turns a failed import in the block into a `MissingLibraryError` that names every one of these that is missing."""
    try:
        yield
    except ImportError as error:
        missing = missing_libraries(error, *names)
        if not missing:
            raise
        raise MissingLibraryError(missing_text(missing)) from None


def missing_libraries(error: ImportError, *names: str) -> List[str]:
    """Returns the packages that are missing: of the import that failed, and of the modules that are needed with it."""
    missing = {name for name in names if not _can_be_imported(name)}
    if isinstance(error, ModuleNotFoundError) and error.name:
        missing.add(error.name.partition(".")[0])
    return [_PACKAGES.get(name, name) for name in sorted(missing)]


def missing_text(packages: List[str]) -> str:
    """Returns one line: what is missing, and the command that installs it."""
    verb = "is" if len(packages) == 1 else "are"
    return f"{', '.join(packages)} {verb} not installed: pip install {' '.join(packages)}"


def _can_be_imported(name: str) -> bool:
    try:
        importlib.import_module(name)
    except ImportError:
        return False
    return True
