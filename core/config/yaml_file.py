"""Reads a YAML file and remembers the line of every key, so that an error can point at it."""

from __future__ import annotations

import contextlib
import os
from typing import Iterator, Mapping, NamedTuple, Union

from ..values import ConfigError, JsonObject, Path, Problems, printable
from .schema import require_mapping

PathLike = Union[str, "os.PathLike[str]"]

MOST_BYTES = 200_000
"""Largest file, so that every file is read within a second."""


class YamlFile(NamedTuple):
    """The contents of a file, with the lines of its keys."""

    tree: JsonObject
    lines: Mapping[Path, int]
    """Line of each key, counted from 1."""
    file: str
    """The file's name, as given."""

    def locate(self, error: ConfigError) -> ConfigError:
        """Returns `error` and its `others`, by line, each with this file and the line of its key.

        For a key that is not in the file, the line is that of the nearest key above it.
        """
        located = []
        for each in error.all:
            path = each.path
            while path and path not in self.lines:
                path = path[:-1]
            line = each.line if each.line is not None else self.lines.get(path)
            # An error of another file, which this one refers to, keeps its place.
            located.append(each if each.file else each.at(each.path, self.file, line))
        return ConfigError.joined(sorted(located, key=lambda each: each.line or 0))

    @contextlib.contextmanager
    def located(self, path: Path = ()) -> Iterator[None]:
        """Gives errors of what is below `path` this file and the line of their key; see `locate`."""
        try:
            yield
        except ConfigError as error:
            raise self.locate(error.below(path)) from None


def read_yaml(file: PathLike, problems: Problems | None = None) -> YamlFile:
    """Reads a regular file that contains one mapping.

    `problems` receives mistakes after which the file can still be used, which are keys given twice; None raises them.
    Raises ConfigError if it cannot be read, is not YAML in UTF-8, is too large, or contains something else.
    """
    name = os.fspath(file)
    return parse_yaml(_read_text(name), name, problems)


def parse_yaml(text: str, name: str, problems: Problems | None = None) -> YamlFile:
    """Reads the text of a file, whose `name` is that in errors; as `read_yaml`."""
    from .yaml_loader import load  # here, so that configuration by mapping does not need PyYAML

    lines: dict[Path, int] = {}
    result, twice = YamlFile({}, lines, name), Problems()
    with result.located():
        tree = load(text, lines, twice)
        require_mapping(tree)
        if problems is None:
            twice.raise_if_any()
    if problems is not None and twice.errors:
        problems.add(result.locate(ConfigError.joined(twice.errors)))
    return result._replace(tree=tree)


def _read_text(name: str) -> str:
    # Opening a named pipe would wait for a writer, and a device has no end.
    if os.path.exists(name) and not os.path.isfile(name):
        raise ConfigError("cannot be read: expected a file, got a directory, a device or a pipe", file=name)
    try:
        with open(name, "rb") as stream:
            data = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a null byte
        raise ConfigError(f"cannot be read: {getattr(error, 'strerror', error)}", file=printable(name)) from None
    if len(data) > MOST_BYTES:
        raise ConfigError(f"is too large; expected at most {MOST_BYTES} bytes", file=name)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        problem = f"byte {error.start} is 0x{data[error.start]:02x}"
        raise ConfigError(f"is not UTF-8 text: {problem}", file=name) from None
