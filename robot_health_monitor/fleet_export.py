"""`robot-health export fleet`: which robots have which thresholds, and where the files are written."""

from __future__ import annotations

import os
from typing import Dict, List, Optional, Tuple

from robot_health_monitor.core.config import load_config
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.export.fleet import MADE
from robot_health_monitor.ops.export.fleet_rules import Judged

from .fleet_configuration import read_entries

_GROUP = "robot_health"


def read_fleet(thresholds: str, fleet_file: str = "") -> Tuple[List[Judged], Optional[List[str]]]:
    """Returns the robots by their thresholds, and those that must report; without fleet.yaml all robots, and None.

    ConfigError: a mistake in one of the files.
    """
    config = load_config(thresholds)
    if not fleet_file:
        return [Judged(_GROUP, config, ())], None
    robots: Dict[str, List[str]] = {}
    entries = read_entries(read_yaml(fleet_file), needs_url=False)
    for entry in entries:
        file = entry.thresholds or thresholds
        robots.setdefault(os.path.realpath(file), []).append(entry.name)
    if len(robots) == 1:
        (file,) = robots
        config = config if file == os.path.realpath(thresholds) else load_config(file)
        return [Judged(_GROUP, config, ())], [entry.name for entry in entries]
    judged = [
        Judged(f"{_GROUP} {number}", load_config(file), names) for number, (file, names) in enumerate(robots.items(), 1)
    ]
    return judged, [entry.name for entry in entries]


def write_files(folder: str, files: Dict[str, str]) -> None:
    """Writes files, each at once; ConfigError: one cannot be written, or the folder has another README.md."""
    readme = os.path.join(folder, "README.md")
    if not folder or (os.path.lexists(readme) and not _is_exported(readme)):
        problem = "is not from an earlier export; expected another folder" if folder else "expected a folder, got ''"
        raise ConfigError(problem, file=readme if folder else "")
    for name, text in files.items():
        path = os.path.join(folder, name)
        try:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(f"{path}.new", "w", encoding="utf-8") as stream:
                stream.write(text)
            os.replace(f"{path}.new", path)
        except OSError as error:
            raise ConfigError(f"cannot be written: {error.strerror or error}", file=path) from None


def _is_exported(readme: str) -> bool:
    try:
        with open(readme, encoding="utf-8", errors="replace") as stream:
            return stream.read(len(MADE)) == MADE
    except OSError:
        return False
