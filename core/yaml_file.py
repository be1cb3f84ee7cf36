"""Reads a YAML file and remembers the line of every key, so that an error can point at it."""

from __future__ import annotations

import os
from typing import Any, Dict, Mapping, NamedTuple, Set, Union

from .errors import ConfigError, Path
from .parameters import require_mapping

PathLike = Union[str, "os.PathLike[str]"]


_MOST_CHARACTERS = 1_000_000


class YamlFile(NamedTuple):
    """What a file holds and where."""

    tree: Mapping[str, Any]
    """The file's mapping."""
    lines: Mapping[Path, int]
    """Line of each key, counted from 1."""
    file: str
    """The file's name, as it was given."""

    def locate(self, error: ConfigError) -> ConfigError:
        """Returns `error` and its `others`, by line, each with this file and the line of its key.

        For a key that is not in the file, the line is that of the nearest key above it.
        """
        located = []
        for each in error.all:
            path = each.path
            while path and path not in self.lines:
                path = path[:-1]
            located.append(ConfigError(each.problem, each.path, self.file, self.lines.get(path)))
        first, *others = sorted(located, key=lambda each: each.line or 0)
        first.others = tuple(others)
        return first


def read_yaml(file: PathLike) -> YamlFile:
    """Reads a file that holds one mapping.

    Raises:
        ConfigError: it cannot be read, is not YAML in UTF-8, names a key twice, or holds something else.
    """
    import yaml  # here, so that configuration by mapping needs nothing installed

    name = os.fspath(file)
    try:
        with open(name, encoding="utf-8") as stream:
            text = stream.read(_MOST_CHARACTERS + 1)
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=name) from None
    except UnicodeDecodeError as error:
        found = f"byte {error.start} is 0x{error.object[error.start]:02x}"
        raise ConfigError(f"is not a text in UTF-8: {found}", file=name) from None
    except ValueError as error:  # a name with a null byte
        raise ConfigError(f"cannot be read: {error}", file=repr(name)) from None

    if len(text) > _MOST_CHARACTERS:
        raise ConfigError(f"is too large, allowed are {_MOST_CHARACTERS} characters", file=name)

    lines: Dict[Path, int] = {}
    loader = yaml.SafeLoader("")
    try:
        loader = yaml.SafeLoader(text)
        root = loader.get_single_node()
        if root is None:
            raise ConfigError("is empty, allowed is a mapping of node names to ros__parameters", file=name)
        _note_lines(root, (), lines, name, set(), set())
        tree = loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else None
        raise ConfigError(f"is not valid YAML: {error.problem}", file=name, line=line) from None
    except yaml.YAMLError as error:
        raise ConfigError(f"is not valid YAML: {str(error).splitlines()[0]}", file=name) from None
    except RecursionError:
        raise ConfigError("is nested too deeply", file=name) from None
    except ValueError as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"is not valid YAML: {error}", file=name) from None
    finally:
        loader.dispose()
    result = YamlFile(tree, lines, name)
    try:
        require_mapping(tree)
    except ConfigError as error:
        raise result.locate(error) from None
    return result


def _note_lines(node: Any, path: Path, lines: Dict[Path, int], file: str, above: Set[int], noted: Set[int]) -> None:
    if node.id != "mapping":
        return
    if id(node) in above:
        raise ConfigError("contains itself", path, file, lines.get(path))
    if id(node) in noted:  # aliases of aliases could name one mapping more often than there is time for
        return
    noted.add(id(node))
    for key, value in node.value:
        key_path = (*path, str(key.value))
        line = key.start_mark.line + 1
        if key_path in lines and key.value != "<<":
            raise ConfigError(f"is given twice, first in line {lines[key_path]}", key_path, file, line)
        lines[key_path] = line
        _note_lines(value, key_path, lines, file, above | {id(node)}, noted)
