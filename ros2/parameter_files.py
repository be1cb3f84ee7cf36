"""Files given with `--params-file`: checked before rcl reads them, so that errors name file and line.

For ROS 2, a section `alert_system:` applies to `/alert_system` only: in a namespace it would silently be ignored. Here
it applies to alert_system in any namespace, as in ROS 1.
"""

from __future__ import annotations

import contextlib
import os
import re
from typing import Any, Dict, Iterator, List, Mapping, Sequence

from robot_health_monitor.core.config import load_config, sections
from robot_health_monitor.core.errors import ConfigError, Path
from robot_health_monitor.core.yaml_file import YamlFile, read_yaml

_OPTION = "--params-file"
_RCL_ERROR = re.compile(
    rf".*Couldn't parse params file: '{_OPTION} (?P<file>.+?)'\. Error: (?P<why>.+?)"
    r"(?: (?:at|near) line(?:_num)? (?P<line>\d+))?\s*, at ",
    re.DOTALL,
)


class ParameterFiles:
    """The parameter files of a command line."""

    def __init__(self, arguments: Sequence[str]) -> None:
        """Reads them.

        Args:
            arguments: the command line.

        Raises:
            ConfigError: a file cannot be read, is not YAML, or contains an empty mapping.
        """
        self._arguments = list(arguments)
        self._places = [place + 1 for place, option in enumerate(arguments[:-1]) if option == _OPTION]
        self._files = {place: read_yaml(arguments[place]) for place in self._places}
        self._copies: Dict[str, int] = {}
        for file in self._files.values():
            _refuse_empty_mappings(file, file.tree, ())

    @contextlib.contextmanager
    def arguments_for_any_namespace(self) -> Iterator[List[str]]:
        """Returns the arguments with copies of the files in which a node's name applies to any namespace.

        The copies are in memory, as no folder need be writable; they exist while the context is entered, for rclpy to
        read.
        """
        arguments = list(self._arguments)
        try:
            for place, file in self._files.items():
                with open(file.file, encoding="utf-8") as stream:
                    lines = stream.readlines()
                for name in file.tree:
                    if re.match(r"\w+\Z", name):
                        number = file.lines[(name,)] - 1
                        lines[number] = re.sub(rf"^(['\"]?){name}\1(?=\s*:)", f'"/**/{name}"', lines[number])
                copy = os.memfd_create("parameters")
                arguments[place] = f"/proc/self/fd/{copy}"
                self._copies[arguments[place]] = place
                with open(copy, "w", encoding="utf-8", closefd=False) as stream:
                    stream.writelines(lines)
            yield arguments
        finally:
            for path in self._copies:
                os.close(int(os.path.basename(path)))

    def located(self, error: ConfigError, node: str) -> ConfigError:
        """Returns an error of a node with file and line if its key is in one of the files."""
        for place in reversed(self._places):
            file = self._files[place]
            for name, section in sections(file.tree).items():
                path = (*section.path, *error.path)
                if name in (node.rpartition("/")[2], "*", "**") and path in file.lines:
                    return file.locate(ConfigError(error.problem, path))
        return error

    def explained(self, problem: str) -> ConfigError:
        """Returns an error message of rcl as a ConfigError, with file and line if it concerns a file."""
        for place in self._places:
            try:
                load_config(self._arguments[place])
            except ConfigError as error:
                if error.line is not None:
                    return error
        match = _RCL_ERROR.match(problem)
        if match is None:
            return ConfigError(" ".join(problem.split()))
        place = self._copies[match["file"]]
        line = int(match["line"]) if match["line"] else None
        return ConfigError(f"rejected by rcl: {match['why']}", file=self._arguments[place], line=line)


def _refuse_empty_mappings(file: YamlFile, tree: Mapping[str, Any], path: Path) -> None:
    """ROS 2 has only leaves: an empty mapping would become a parameter without a value, which rclpy cannot handle."""
    for key, value in tree.items():
        below = (*path, str(key))
        if isinstance(value, Mapping):
            _refuse_empty_mappings(file, value, below)
            if not value and "ros__parameters" in path:
                problem = "expected a mapping with at least one key on ROS 2, for instance topic, got {}"
                raise file.locate(ConfigError(problem, below))
