"""Libraries that only some functions need: all that are missing are named at once, with how to install them."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from typing import Iterator

from ..core.values import ServiceError

ROSBRIDGE = ("aiohttp",)
"""What rosbridge needs, as a server and as a client; cbor2 is optional."""
RECORDINGS = ("lz4", "mcap", "rosbags", "zstandard")
"""What reading every kind of recording needs: the extra `[recordings]`."""

_PACKAGES = {"yaml": "PyYAML"}
"""Packages whose modules have other names."""
_NOT_IN_DEBIAN = {"mcap", "rosbags"}
_PROGRAMS = {"apprise"}
"""Packages of the same name in Debian."""


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


def missing_libraries(error: ImportError, *names: str) -> list[str]:
    """Returns the packages that are missing: of the import that failed, and of the modules that are needed with it."""
    missing = {name for name in names if not _can_be_imported(name)}
    if isinstance(error, ModuleNotFoundError) and error.name:
        missing.add(error.name.partition(".")[0])
    return [_PACKAGES.get(name, name) for name in sorted(missing)]


def missing_text(packages: list[str]) -> str:
    """Returns one line: what is missing, and the command that installs it."""
    verb = "is" if len(packages) == 1 else "are"
    return f"{', '.join(packages)} {verb} not installed: {install_command(packages)}"


def install_command(packages: list[str]) -> str:
    """Returns what installs packages of PyPI to where this program was installed: with pipx, apt or pip."""
    if os.path.exists(os.path.join(sys.prefix, "pipx_metadata.json")):
        return f"pipx inject {os.path.basename(sys.prefix)} {' '.join(packages)}"
    if not _is_system_python():
        return f"pip install {' '.join(packages)}"
    if not _NOT_IN_DEBIAN.intersection(packages):
        return f"apt install {' '.join(map(debian_package, packages))}"
    return "apt does not have them all; install robot-health with pipx (docs/install.md)"


def debian_package(package: str) -> str:
    """Returns the name in Debian and Ubuntu, and the rosdep key, of a package of PyPI."""
    return package if package in _PROGRAMS else f"python3-{package.lower().replace('_', '-').replace('pyyaml', 'yaml')}"


def _is_system_python() -> bool:
    """Returns True for the Python of Debian and Ubuntu, for which apt has the libraries."""
    return sys.prefix == sys.base_prefix == "/usr" and os.path.exists("/usr/bin/apt")


def _can_be_imported(name: str) -> bool:
    try:
        importlib.import_module(name)
    except ImportError:
        return False
    return True
