"""Files given with `--params-file`: read before rcl reads them, so that a mistake is named with file and line.

A section headed `alert_system:` is, to ROS 2, that of `/alert_system` only; in a namespace nobody would read it, and
the node would go on with its defaults. Here it is that of alert_system in any namespace, as it is in ROS 1.
"""

from __future__ import annotations

import os
import re
from typing import Any, List, Mapping, Sequence

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
    """The files that the arguments of a process name."""

    def __init__(self, arguments: Sequence[str]) -> None:
        """Reads them.

        Args:
            arguments: the command line.

        Raises:
            ConfigError: one cannot be read, is not YAML, or holds an empty mapping.
        """
        self._arguments = list(arguments)
        self._places = [place + 1 for place, option in enumerate(arguments[:-1]) if option == _OPTION]
        self._files = {place: read_yaml(arguments[place]) for place in self._places}
        for file in self._files.values():
            _refuse_empty_mappings(file, file.tree, ())

    def arguments_for_any_namespace(self, folder: str) -> List[str]:
        """Returns the arguments with copies of the files in which a node's name holds in any namespace.

        Args:
            folder: where the copies go; they are needed until rclpy has read its arguments.
        """
        arguments = list(self._arguments)
        for place, file in self._files.items():
            with open(file.file, encoding="utf-8") as stream:
                lines = stream.readlines()
            for name in file.tree:
                if re.match(r"\w+\Z", name):
                    number = file.lines[(name,)] - 1
                    lines[number] = re.sub(rf"^(['\"]?){name}\1(?=\s*:)", f'"/**/{name}"', lines[number])
            arguments[place] = os.path.join(folder, f"{place}.yaml")
            with open(arguments[place], "w", encoding="utf-8") as stream:
                stream.writelines(lines)
        return arguments

    def located(self, error: ConfigError, node: str) -> ConfigError:
        """Returns an error of the node with this name with file and line, where its key is in one of the files."""
        for place in reversed(self._places):
            file = self._files[place]
            for name, section in sections(file.tree).items():
                path = (*section.path, *error.path)
                if name in (node.rpartition("/")[2], "*", "**") and path in file.lines:
                    return file.locate(ConfigError(error.problem, path))
        return error

    def explained(self, problem: str) -> ConfigError:
        """Returns what rcl says of the arguments as an error with file and line, where it is about a file."""
        for place in self._places:
            try:
                load_config(self._arguments[place])
            except ConfigError as error:
                if error.line is not None:
                    return error
        match = _RCL_ERROR.match(problem)
        if match is None:
            return ConfigError(" ".join(problem.split()))
        place = int(os.path.basename(match["file"]).partition(".")[0])
        line = int(match["line"]) if match["line"] else None
        return ConfigError(f"rcl says: {match['why']}", file=self._arguments[place], line=line)


def _refuse_empty_mappings(file: YamlFile, tree: Mapping[str, Any], path: Path) -> None:
    """ROS 2 has only leaves: an empty mapping would become a parameter without a value, which rclpy chokes on."""
    for key, value in tree.items():
        below = (*path, str(key))
        if isinstance(value, Mapping):
            _refuse_empty_mappings(file, value, below)
            if not value and "ros__parameters" in path:
                problem = "found {}, allowed on ROS 2 is a mapping with at least one key, for instance topic"
                raise file.locate(ConfigError(problem, below))
